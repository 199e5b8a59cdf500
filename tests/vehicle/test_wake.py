"""The wake of a drone on those below."""

import itertools

import numpy as np
import pytest
from bench import MULTIROTORS
from scipy.spatial.transform import Rotation
from swarms import PLACES, place_points

from bulletuav import load_airframe
from bulletuav.compiled.lanes import WIDTH
from bulletuav.vehicle.parameters import parameter_rows
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wake import downwash
from bulletuav.vehicle.wakes import LIST_SKIN, Wakes, sum_wakes

G = 9.80665
NAMES = MULTIROTORS


def row_of(name, effects=None):
    return parameter_rows([load_airframe(name)], *([] if effects is None else [effects]))[0]


def swarm_of(airframes, position):
    swarm = Swarm.zeros(1, len(airframes), 8)
    swarm.position[0] = position
    for i, airframe in enumerate(airframes):
        swarm.rotor_speed[0, i, : len(airframe.rotors)] = airframe.hover_speed()
    return swarm


def wakes_of(swarm, alive, parameters):
    wakes = Wakes.of(*alive.shape)
    wakes.felt[:] = np.nan
    sum_wakes(swarm, alive, parameters, 0, 1, False, 0.0, wakes)
    return wakes.felt[0]


def all_alive(count):
    return np.ones((1, count), dtype=bool)


def test_figures_by_hand():
    """A 27 g Crazyflie (0.2648 N), r = 46 mm: at 0.4 m s = sqrt(0.046^2 + 0.04^2) = 0.0610 m."""
    row = row_of("cf2x")
    push, tip = downwash(0.0, 0.4, 0.2648, row)
    assert push == pytest.approx(0.32 * 0.2648 * 0.75467, rel=2e-4)
    assert tip == pytest.approx(push / 0.0610**2, rel=2e-3)
    aside, _ = downwash(0.061**2, 0.4, 0.2648, row)
    assert aside == pytest.approx(push * np.exp(-0.5), rel=1e-3)
    far, _ = downwash(0.0, 10.0, 0.2648, row)
    assert far == pytest.approx(0.32 * 0.2648 * 0.046, rel=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_no_singularity_and_never_more_than_its_share(name):
    row = row_of(name)
    for drop in (1e-300, 1e-3, 0.6875, 0.69, 10.0, 1e6):
        for aside in (0.0, 0.5, 5.0, 1e6):
            push, tip = downwash(aside**2, drop, 2.0, row)
            assert 0 <= push <= 0.64 * (1 + 1e-12)
            assert 0 <= tip <= 0.64 / row["wake_radius"] ** 2 * (1 + 1e-12)
    assert downwash(0.0, 0.0, 2.0, row) == downwash(0.0, -1.0, 2.0, row) == (0, 0)
    assert downwash(0.0, 0.5, 2.0, row_of(name, ())) == (0, 0)
    assert downwash(0.0, 0.5, 0.0, row) == (0, 0)


def test_pushes_add_up_over_living_drones_above_that_fly():
    cf2x = load_airframe("cf2x")
    row = row_of("cf2x")
    weight = cf2x.mass * G
    parameters = np.array([[row] * 4])
    swarm = swarm_of([cf2x] * 4, [(0, 0, 1), (0, 0, 2), (0.1, 0, 3), (0, 0, 0)])
    near, far = downwash(0.0, 1.0, weight, row)[0], downwash(0.01, 2.0, weight, row)[0]
    alive = all_alive(4)
    assert wakes_of(swarm, alive, parameters)[0, 0] == pytest.approx(near + far, rel=1e-12)
    assert (wakes_of(swarm, alive, parameters)[2] == 0).all()
    alive[0, 1] = False
    assert wakes_of(swarm, alive, parameters)[0, 0] == pytest.approx(far, rel=1e-12)
    swarm.rotor_speed[0, 2] = 0
    assert (wakes_of(swarm, alive, parameters)[0] == 0).all()


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.5])
def test_the_side_under_the_other_drone_is_tipped_down(yaw):
    """To the east of the lower drone: its eastern side goes down, a torque about north."""
    cf2x = load_airframe("cf2x")
    swarm = swarm_of([cf2x] * 2, [(0, 0, 1), (0.07, 0, 1.35)])
    turned = Rotation.from_euler("xyz", (0.1, -0.2, yaw))
    swarm.quaternion[0, 0] = turned.as_quat()
    parameters = parameter_rows([cf2x] * 2)[None]
    wake = wakes_of(swarm, all_alive(2), parameters)
    push, tip = downwash(0.07**2, 0.35, cf2x.mass * G, parameters[0, 0])
    torque = turned.apply(wake[0, 1:])
    np.testing.assert_allclose(torque, (0, cf2x.arm**2 * tip * 0.07, 0), atol=1e-15)
    assert wake[0, 0] == pytest.approx(push, rel=1e-12)
    assert (wake[1] == 0).all()


def test_a_wake_is_the_same_all_around():
    cf2x = load_airframe("cf2x")
    parameters = parameter_rows([cf2x] * 2)[None]
    sizes = []
    for angle in np.linspace(0, 2 * np.pi, 7):
        place = (0.06 * np.cos(angle), 0.06 * np.sin(angle), 1.5)
        wake = wakes_of(swarm_of([cf2x] * 2, [(0, 0, 1), place]), all_alive(2), parameters)[0]
        sizes.append((wake[0], np.hypot(wake[1], wake[2]), wake[3]))
    np.testing.assert_allclose(sizes, [sizes[0]] * 7, rtol=1e-9, atol=1e-18)


def test_the_edge_of_wakes_leaves_nothing_out():
    """Against every pair of a mixed swarm by the formula, without an edge."""
    rng = np.random.default_rng(0)
    for height in (0.5, 5.0, 60.0):
        airframes = [load_airframe(name) for name in rng.choice(NAMES, 40)]
        position = rng.uniform(0, 1, (40, 3)) * (4, 4, height)
        expected = np.zeros((40, 4))
        for lower, upper in itertools.permutations(range(40), 2):
            dx, dy, drop = position[upper] - position[lower]
            if drop > 0:
                above = airframes[upper]
                square = above.arm**2 + (0.1 * drop) ** 2
                push = 0.32 * above.mass * G * above.arm / np.sqrt(square)
                push *= np.exp(-0.5 * (dx**2 + dy**2) / square)
                tip = airframes[lower].arm ** 2 * push / square
                expected[lower] += push, -tip * dy, tip * dx, 0
        swarm = swarm_of(airframes, position)
        got = wakes_of(swarm, all_alive(40), parameter_rows(airframes)[None])
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-14)
        assert (got[:, 0] > 1e-3).sum() > 3


@pytest.mark.parametrize("shape", [(1, 2), (1, 40), (3, 10), (5, 1)])
@pytest.mark.parametrize("way", ["a little", "as far as the skin", "far", "somewhere"])
def test_a_list_of_pairs_holds_until_a_drone_moves_too_far(shape, way):
    """Against pairs that are listed anew, to the bit."""
    rng = np.random.default_rng(sum(shape))
    airframes = [load_airframe(name) for name in rng.choice(NAMES, shape[1])]
    swarm = Swarm.zeros(*shape, 8)
    swarm.rotor_speed[:] = rng.uniform(0, 1000, swarm.rotor_speed.shape)
    swarm.quaternion[:] = rng.normal(size=swarm.quaternion.shape)
    parameters = np.array([parameter_rows(airframes)] * shape[0])
    alive = rng.random(shape) < 0.8
    listed, felt = Wakes.of(*shape), 0
    for drawn in range(20):
        # Many are near the edge of wakes, where the skin matters
        swarm.position[:] = rng.uniform(0, 1, (*shape, 3)) * (3 + drawn / 4, 3, 1 + drawn)
        sum_wakes(swarm, alive, parameters, 0, shape[0], False, LIST_SKIN, listed)
        pairs = listed.pairs[: listed.listed[0]].copy()
        step = {"a little": 0.3, "as far as the skin": 1.0, "far": 3.0, "somewhere": 30.0}[way]
        sides = rng.choice([-1.0, 1.0], swarm.position.shape)
        swarm.position[:] += LIST_SKIN * (1 - 1e-12) * step * sides
        sum_wakes(swarm, alive, parameters, 0, shape[0], True, LIST_SKIN, listed)
        kept = np.array_equal(listed.pairs[: listed.listed[0]], pairs)
        assert kept or step > 1.0
        anew = Wakes.of(*shape)
        sum_wakes(swarm, alive, parameters, 0, shape[0], False, 0.0, anew)
        np.testing.assert_array_equal(listed.felt, anew.felt)
        felt += np.count_nonzero(anew.felt[..., 0])
        assert listed.listed[0] >= anew.listed[0]
    assert felt > 10 or shape[1] < 10


def test_worlds_of_a_group_do_not_feel_each_other():
    """The same as each world by itself, to the bit; more pairs than are computed at once."""
    rng = np.random.default_rng(3)
    airframes = [load_airframe("cf2x")] * 9
    swarm = Swarm.zeros(4, 9, 4)
    swarm.rotor_speed[:] = 1700.0
    swarm.quaternion[..., 3] = 1.0
    swarm.position[:] = rng.uniform(0, 1, (4, 9, 3))
    parameters, alive = np.array([parameter_rows(airframes)] * 4), np.ones((4, 9), dtype=bool)
    group = Wakes.of(3, 9)
    sum_wakes(swarm, alive, parameters, 1, 4, False, 0.0, group)
    assert group.listed[0] > 5 * WIDTH
    for w in range(1, 4):
        alone = Swarm(*(array[w : w + 1] for array in swarm))
        felt = wakes_of(alone, alive[w : w + 1], parameters[w : w + 1])
        np.testing.assert_array_equal(group.felt[w - 1], felt)


def test_drones_that_are_nowhere_feel_and_blow_nothing():
    cf2x = load_airframe("cf2x")
    swarm = swarm_of([cf2x] * 3, [(0, 0, 1), (0, 0, 1.4), (np.nan, 0, 2)])
    parameters = parameter_rows([cf2x] * 3)[None]
    felt = wakes_of(swarm, all_alive(3), parameters)
    assert felt[0, 0] > 0.01
    assert (felt[1:] == 0).all()


def test_airframes_without_a_wake_are_not_listed():
    cf2x = load_airframe("cf2x")
    swarm = swarm_of([cf2x] * 2, [(0, 0, 1), (0, 0, 1.4)])
    parameters = parameter_rows([cf2x] * 2, ())[None]
    wakes = Wakes.of(1, 2)
    sum_wakes(swarm, all_alive(2), parameters, 0, 1, False, LIST_SKIN, wakes)
    assert wakes.listed[0] == 0
    assert (wakes.felt == 0).all()


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("count", [199, 200, 300, 900])
def test_wakes_of_many_drones_have_the_bits_of_all_pairs(kind, count):
    """A drone at a position that is not finite has no grid, and no effect."""
    rng = np.random.default_rng(count)
    airframes = [load_airframe(name) for name in rng.choice(NAMES, count + 1)]
    swarm = Swarm.zeros(1, count + 1, 8)
    swarm.rotor_speed[:] = rng.uniform(0, 1000, swarm.rotor_speed.shape)
    swarm.quaternion[:] = rng.normal(size=swarm.quaternion.shape)
    swarm.position[0] = place_points(rng, kind, count + 1)
    swarm.position[0, -1] = np.nan
    parameters, alive = parameter_rows(airframes)[None], rng.random((1, count + 1)) < 0.9
    alive[0, -1] = True
    direct = Wakes.of(1, count + 1)
    sum_wakes(swarm, alive, parameters, 0, 1, False, LIST_SKIN, direct)
    few = Swarm(*(np.ascontiguousarray(array[:, :-1]) for array in swarm))
    wakes = Wakes.of(1, count)
    rows = np.ascontiguousarray(parameters[:, :-1])
    sum_wakes(few, np.ascontiguousarray(alive[:, :-1]), rows, 0, 1, False, LIST_SKIN, wakes)
    pairs = direct.pairs[: direct.listed[0]]
    expected = pairs[pairs[:, 2] < count]
    np.testing.assert_array_equal(wakes.pairs[: wakes.listed[0]], expected)
    np.testing.assert_array_equal(wakes.felt, direct.felt[:, :-1])
    assert len(expected) > 100
