"""Thermals against Allen's formulas, computed by hand, and what aircraft feel of them."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from bulletuav import Aviary
from bulletuav.envs.airspace import Airspace
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.envelope import find_climb
from bulletuav.vehicle.thermals import (
    MAX_RADIUS_RATIO,
    SHAPES,
    TOP,
    Thermals,
    as_thermals,
    thermal_radius,
    updraft_velocity,
)
from bulletuav.vehicle.wind import Wind

DEPTH, STRENGTH = 1400.0, 2.5


def velocity(distance, height, strength=STRENGTH, number=1, area=9e6):
    return updraft_velocity(distance, height, strength, DEPTH, number, area)


@pytest.mark.parametrize(
    ("height", "radius"),
    [
        # 0.102 (z / zi)^(1/3) (1 - 0.25 z / zi) zi
        (0.0, 10.0),
        (100.0, 58.1916),
        (700.0, 99.1729),
        (1200.0, 106.580),
    ],
)
def test_radius_by_hand(height, radius):
    assert thermal_radius(height / DEPTH, DEPTH) == pytest.approx(radius, rel=1e-5)


def test_the_largest_radius():
    radii = [thermal_radius(ratio, DEPTH) / DEPTH for ratio in np.linspace(0.0, 1.0, 1001)]
    assert max(radii) == pytest.approx(MAX_RADIUS_RATIO, rel=1e-12)


def test_velocity_of_the_middle_by_hand():
    """At half the depth the mean is 0.892913 m/s and the peak 2.04307 m/s; r1 / r2 is 0.24909."""
    mean = 0.5 ** (1 / 3) * (1 - 1.1 * 0.5) * STRENGTH
    assert mean == pytest.approx(0.892913, abs=1e-6)
    bell = 1 / (1 + (1.5265 * 0.0176) ** 3.6054)
    assert velocity(0.0, 700.0) == pytest.approx(2.043067 * bell, rel=2e-6)


def test_velocity_inside_by_hand():
    """20 m from the middle at half the depth, inside r1 = 24.7 m: 0.9643 of the peak."""
    place = 20.0 / 99.17288
    bell = 1 / (1 + (1.5265 * (place - 0.0176)) ** 3.6054) - 0.1265 * place
    assert bell == pytest.approx(0.9643, abs=5e-5)
    assert velocity(20.0, 700.0) == pytest.approx(2.043067 * bell, rel=2e-6)


@pytest.mark.parametrize("ratio", range(7))
def test_shapes_have_the_flux_of_a_frustum(ratio):
    """Allen fitted the shapes to frustums with the peak 1 and the radii r1 and 1."""
    k1, k2, k3, k4 = SHAPES[ratio]
    inner = 0.14 + 0.11 * ratio
    frustum = (1 + inner + inner**2) / 3

    def bell(place):
        return max(1 / (1 + abs(k1 * (place + k3)) ** k2) + k4 * place, 0.0)

    flux = quad(lambda place: 2 * place * bell(place), 0.0, 3.0, limit=200)[0]
    assert flux == pytest.approx(frustum, rel=0.025)


@pytest.mark.parametrize("height", [50.0, 100.0, 350.0, 700.0, 1000.0, 1200.0])
def test_air_that_rises_sinks_between_the_thermals(height):
    """The net flux over the part of the area around each thermal is below 8 % of the updraft's."""
    number, area = 39, 9e6
    edge = math.sqrt(area / number / math.pi)
    radii = np.linspace(0.0, edge, 5001)
    flow = np.array([velocity(r, height, number=number, area=area) for r in radii]) * 2 * radii
    net, rising = np.trapezoid(flow, radii), np.trapezoid(np.maximum(flow, 0), radii)
    assert abs(net) < 0.08 * rising
    assert velocity(0.9 * edge, height, number=number, area=area) < 0.0


def test_profile_over_height():
    """Updrafts are strongest in the middle of the layer and end at 10/11 of it."""
    heights = np.linspace(1.0, 1.2 * DEPTH, 400)
    middle = np.array([velocity(0.0, height) for height in heights])
    assert (middle >= 0).all()
    assert 0.15 < heights[middle.argmax()] / DEPTH < 0.35
    assert (middle[heights >= TOP * DEPTH] == 0).all()
    assert velocity(0.0, 0.0) == velocity(0.0, -5.0) == 0.0
    assert velocity(0.0, 0.001) < 0.1


def test_rings_of_sinking_air_in_the_upper_half():
    """At 0.7 of the depth the downdraft at 1.5 radii is half of pi / 6 times the mean."""
    height = 0.7 * DEPTH
    mean = 0.7 ** (1 / 3) * (1 - 1.1 * 0.7) * STRENGTH
    radius = thermal_radius(0.7, DEPTH)
    assert velocity(1.5 * radius, height) == pytest.approx(-0.5 * math.pi / 6 * mean, rel=0.01)
    assert abs(velocity(1.5 * radius, 0.49 * DEPTH)) < 0.01 * mean


def test_velocities_are_proportional_to_the_strength():
    for distance in (0.0, 30.0, 80.0, 150.0, 900.0):
        once, twice = velocity(distance, 900.0), velocity(distance, 900.0, 2 * STRENGTH)
        assert twice == pytest.approx(2 * once, rel=1e-12, abs=1e-12)


def test_the_nearest_thermal_counts():
    thermals = Thermals(centres=((0, 0), (400, 0)))
    wind = Wind((1.0, 2.0, 0.5), 0.0, 1, thermals=thermals)
    wind.reset(0, np.random.default_rng(0))
    places = np.array([[(x, 0, 300.0) for x in (0.0, 50.0, 350.0, 400.0)]])
    found = wind.sample(places, np.zeros(1))[0]
    np.testing.assert_array_equal(found[:, :2], [(1.0, 2.0)] * 4)
    expected = [0.5 + velocity(distance, 300.0, number=2) for distance in (0, 50, 50, 0)]
    np.testing.assert_allclose(found[:, 2], expected, rtol=1e-13)


def test_episodes_draw_their_thermals():
    def centres(seed, turbulence=0.0):
        wind = Wind((0.0, 0.0, 0.0), turbulence, 2, thermals=Thermals(count=5, side=2000.0))
        wind.reset(1, np.random.default_rng(seed))
        return wind.kept()["thermals"]

    first = centres(0)
    np.testing.assert_array_equal(first, centres(0))
    assert (first[0] == 0).all()
    assert (first[1] != centres(1)[1]).all()
    drawn = np.concatenate([centres(seed)[1] for seed in range(200)])
    assert np.abs(drawn).max() < 1000.0
    np.testing.assert_allclose(drawn.std(axis=0), 2000 / math.sqrt(12), rtol=0.05)


def test_gusts_are_the_same_with_thermals():
    waves = []
    for thermals in (None, Thermals()):
        wind = Wind((0.0, 0.0, 0.0), 5.0, 1, thermals=thermals)
        wind.reset(0, np.random.default_rng(3))
        waves.append(wind.kept()["waves"])
    np.testing.assert_array_equal(*waves)


def test_default_number_of_thermals():
    """A straight flight of the layer's depth crosses 1.2 thermals."""
    thermals = Thermals()
    width = 2 * thermal_radius(0.5, thermals.depth)
    assert thermals.number * width * thermals.depth / thermals.area == pytest.approx(1.2, rel=0.02)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("strong", "thermals is 'strong': Thermals, or a dict of strength, depth"),
        ({"strenght": 2.0}, "unknown attribute of thermals: 'strenght': did you mean 'strength'"),
        ({"strength": 0.0}, "thermals: strength is 0"),
        ({"depth": 20.0}, "thermals: depth is 20"),
        ({"side": float("nan")}, "thermals: side is nan"),
        ({"count": 0}, "thermals: count is 0"),
        ({"count": 2, "centres": [(0, 0)]}, "leave out count"),
        ({"centres": [(0, 0, 5)]}, "thermals: a centre is .*: a list or tuple of 2"),
        ({"centres": [(0, "east")]}, "thermals: y of a centre is 'east'"),
        ({"centres": []}, "centres is empty"),
        ({"count": 50, "side": 1000.0}, "50 thermals of up to 107 m cover more than half"),
    ],
)
def test_invalid_thermals(given, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("crossing", 1, {"thermals": given})


def test_thermals_of_options():
    assert as_thermals(None) is None
    assert as_thermals({}) == Thermals()
    given = Thermals(centres=[[1, 2]])
    assert as_thermals(given) is given
    assert given.centres == ((1.0, 2.0),)


def test_multirotors_rise_in_a_thermal():
    """A drone without thrust falls by the drag of the air that rises past it."""
    ends = []
    for thermals in (None, {"centres": [(0, 0)]}):
        airspace = Airspace(
            [(0, 0, 300), (400, 0, 300)], thermals=thermals, dynamics="point_mass", decision_hz=30
        )
        airspace.step()
        ends.append(airspace.swarm.velocity[:, 2].copy())
        airspace.close()
    inside, between = ends[1] - ends[0]
    assert inside > 0.0 > between


def test_worlds_repeat_with_the_seed():
    flown = []
    for _ in range(2):
        aviary = Aviary("crossing", 2, thermals={"count": 4}, dynamics="point_mass", num_drones=2)
        aviary.reset(seeds=4)
        flown.append(aviary.worlds.state.wind.copy())
        aviary.close()
    np.testing.assert_array_equal(*flown)


TRAINER_SPEED, TRAINER_BANK = 11.0, math.radians(30)


def glide(thermals, seconds):
    """Return the heights of a trainer that circles about (R, 0) with stopped rotors, m."""
    trim = find_climb(load_airframe("trainer"), TRAINER_SPEED, 0.0, TRAINER_BANK)
    attitude = Rotation.from_euler("ZYX", (math.pi / 2, -trim.pitch, trim.bank))
    ahead = math.cos(trim.alpha) * math.cos(trim.sideslip)
    below = math.sin(trim.alpha) * math.cos(trim.sideslip)
    velocity = TRAINER_SPEED * np.array((ahead, -math.sin(trim.sideslip), -below))
    airspace = Airspace(
        [(0, 0, 300)],
        airframe="trainer",
        dynamics="rigid_body",
        thermals=thermals,
        decision_hz=60,
    )
    down = attitude.inv().apply((0, 0, -1))
    motion = (attitude.apply(velocity), trim.turn_rate * down)
    airspace.place(0, (0, 0, 300), attitude.as_quat(), *motion)
    airspace.command(0, "rotor", (0.0, *trim.deflection))
    airspace.world.state.swarm.deflection[0, 0] = trim.deflection
    heights = []
    for _ in range(60 * seconds):
        airspace.step()
        heights.append(airspace.swarm.position[0, 2])
    airspace.close()
    return np.array(heights), trim


def test_a_glider_gains_height_by_circling_in_a_thermal():
    """Its climb is the updraft at the radius of its circle minus its sink in still air."""
    still, trim = glide(None, 8)
    sink = TRAINER_SPEED * math.sin(-trim.climb)
    assert 300 - still[-1] == pytest.approx(8 * sink, rel=0.01)
    radius = TRAINER_SPEED * math.cos(trim.climb) / trim.turn_rate
    rising, _ = glide({"centres": [(radius, 0)]}, 8)
    assert rising[-1] > 300 + 4.0
    updraft = velocity(radius, 300.0)
    assert rising[-1] - rising[60] == pytest.approx(7 * (updraft - sink), rel=0.1)
    sinking, _ = glide({"centres": [(radius + 400, 0)], "side": 700.0}, 8)
    assert sinking[-1] < still[-1]
