"""Formulas of pursuit, and how chasers and evaders fly."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, HalfspaceIntersection

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.intercept import constant_bearing, interception, shared_face

POINTS = {"dynamics": "single_integrator", "difficulty": "easy", "evader_speed": 1.0}
LOW, HIGH = np.zeros(3), np.array([10.0, 8.0, 6.0])
NUMBER = st.floats(-20, 20)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)


def test_constant_bearing_by_hand():
    """A target 40 m east that flies north at 6 m/s is met at (40, 30) m after 5 s at 10 m/s."""
    np.testing.assert_allclose(constant_bearing((40.0, 0, 0), (0.0, 6, 0), 10.0), (8, 6, 0))
    # One that flies away, and one that nobody meets: straight at it.
    np.testing.assert_allclose(constant_bearing((40.0, 0, 0), (5.0, 0, 0), 10.0), (10, 0, 0))
    np.testing.assert_allclose(constant_bearing((0.0, 2, 0), (12.0, 0, 0), 10.0), (0, 10, 0))


@given(VECTOR, VECTOR)
def test_the_bearing_stays_and_the_speed_is_kept(way, other):
    velocity = np.array(constant_bearing(way, other, 40.0))
    assert np.linalg.norm(velocity) == pytest.approx(40.0)
    if np.linalg.norm(way) > 1e-3:
        closing = velocity - other
        assert np.linalg.norm(np.cross(way, closing)) < 1e-6 * np.linalg.norm(way) * 80
        assert closing @ np.array(way) > 0


def test_interception_is_constant_bearing_of_each_drone():
    rng = np.random.default_rng(0)
    place, goal, velocity = rng.normal(size=(3, 2, 4, 3))
    speed = np.array([3.0, 4.0, 5.0, 6.0])
    found = interception(place, goal, velocity, speed)
    for w, i in itertools.product(range(2), range(4)):
        wanted = constant_bearing(goal[w, i] - place[w, i], velocity[w, i], speed[i])
        np.testing.assert_array_equal(found[w, i], wanted)


def cell(place, others):
    """Corners of the Voronoi cell of a place among others in the box, by scipy."""
    faces = [
        (*(others - place)[k], -(others**2 - place**2)[k].sum() / 2) for k in range(len(others))
    ]
    for axis in range(3):
        unit = np.eye(3)[axis]
        faces += [(*unit, -HIGH[axis]), (*-unit, LOW[axis])]
    return HalfspaceIntersection(np.array(faces), place).intersections


def test_a_shared_face_by_hand():
    """The face between (2, 4, 3) and (6, 4, 3) is all of x = 4; a third one cuts off its top."""
    place, others = np.array([2.0, 4, 3]), np.array([(6.0, 4, 3)])
    assert shared_face(place, others, 0, LOW, HIGH) == (True, pytest.approx((4, 4, 3)))
    others = np.array([(6.0, 4, 3), (2.0, 4, 7)])
    assert shared_face(place, others, 0, LOW, HIGH) == (True, pytest.approx((4, 4, 2.5)))
    others = np.array([(9.0, 4, 3), (4.0, 4, 3)])
    assert not shared_face(place, others, 0, LOW, HIGH)[0]


def test_the_cell_shrinks_fastest_towards_the_middle_of_the_shared_face():
    """The gradient of the cell's volume, by differences of scipy's volumes, is along that way."""
    rng = np.random.default_rng(1)
    compared = 0
    for _ in range(30):
        place, *others = rng.uniform(LOW + 0.5, HIGH - 0.5, (4, 3))
        others = np.array(others)
        found, middle = shared_face(place, others, 0, LOW, HIGH)
        gradient = np.zeros(3)
        for axis, sign in itertools.product(range(3), (-1, 1)):
            moved = others.copy()
            moved[0, axis] += sign * 1e-4
            gradient[axis] += sign * ConvexHull(cell(place, moved)).volume / 2e-4
        if not found:
            assert np.abs(gradient).max() < 1e-6
            continue
        # Towards the middle the volume falls.
        way = others[0] - middle
        cosine = gradient @ way / np.linalg.norm(gradient) / np.linalg.norm(way)
        assert cosine == pytest.approx(1.0, abs=1e-4)
        compared += 1
    assert compared > 10


@pytest.fixture
def flown():
    """Builds aviaries of drones at given places; gives the velocities that a policy asks for."""
    made = []

    def fly(name, start, teams, moving=None):
        options = {**POINTS, "num_drones": sum(teams), "teams": teams, "start": start}
        options["area"] = 100.0
        made.append(bulletuav.Aviary("pursuit_evasion", **options))
        aviary = made[-1]
        observations = aviary.reset(seeds=0)
        policy = find_policy(name)(aviary)
        policy.reset(np.ones(1, dtype=bool))
        if moving is not None:
            aviary.scene.goal_velocity[0] = moving
        return 10 * policy.act(observations, aviary.swarm)[0]

    yield fly
    for one in made:
        one.close()


def test_chasers_fly_to_where_evaders_are_or_will_be(flown):
    start = [(-20, 0, 20), (20, 0, 20)]
    turn = 0.5  # m/s: a wish is turned a little to the right by policy `mvp`
    np.testing.assert_allclose(flown("pure_pursuit", start, (1, 1))[0], (10, 0, 0), atol=turn)
    velocity = flown("lead", start, (1, 1), moving=(0.0, 6.0, 0.0))[0]
    np.testing.assert_allclose(velocity, (8, 6, 0), atol=turn)


def test_area_minimising_chasers_fly_to_the_middle_of_the_face(flown):
    """Two chasers beside an evader; the cell's faces end half-way at the other one's."""
    start = [(0, 0, 25), (0, 20, 25), (0, 5, 25)]
    velocity = flown("area_minimising", start, (2, 1))
    # The one to the south: the face y = 2.5 spans the arena, whose middle is at z = 25.
    np.testing.assert_allclose(velocity[0], (0, 10, 0), atol=0.6)
    np.testing.assert_allclose(velocity[1], (0, -10, 0), atol=0.6)
    aside = flown("area_minimising", [(-30, 0, 25), (0, 0, 25)], (1, 1))[0]
    np.testing.assert_allclose(aside, (10, 0, 0), atol=0.6)


def test_evaders_fly_away(flown):
    start = [(-10, 0, 25), (0, 10, 25), (0, 0, 25)]
    nearer = [(-9, 0, 25), (0, 10, 25), (0, 0, 25)]
    np.testing.assert_allclose(flown("flee", nearer, (2, 1))[2], (10, 0, 0), atol=0.6)
    away = flown("flee_weighted", start, (2, 1))[2]
    np.testing.assert_allclose(away, 10 * np.array([1, -1, 0]) / np.sqrt(2), atol=0.8)
    gap = flown("flee_gap", start, (2, 1))[2]
    assert gap @ (1, -1, 0) > 10
    # Nobody flees out of the arena.
    corner = flown("flee_gap", [(20, 0, 25), (45, 0, 25)], (1, 1))[1]
    assert corner[0] < 2.6


def test_wanderers_draw_from_their_worlds():
    aviary = bulletuav.Aviary("pursuit_evasion", 2, **POINTS)
    policy = find_policy("wander")(aviary)
    rows = []
    for seeds in ([3, 4], [4, 4]):
        aviary.reset(seeds=seeds)
        policy.reset(np.ones(2, dtype=bool))
        flight = []
        for _ in range(25):
            flight.append(policy.velocities(aviary.swarm).copy())
            aviary.step(np.zeros((2, 4, 3)))
        rows.append(np.array(flight))
    np.testing.assert_array_equal(rows[0][:, 1], rows[1][:, 0])
    np.testing.assert_array_equal(rows[1][:, 0], rows[1][:, 1])
    assert (rows[0][0] == rows[0][19]).all()
    assert (rows[0][19] != rows[0][20]).any(axis=-1).all()
    np.testing.assert_allclose(np.linalg.norm(rows[0], axis=-1), 10.0)
    aviary.close()


def test_sides_keep_to_the_speeds_of_their_teams():
    aviary = bulletuav.Aviary("pursuit_evasion", **{**POINTS, "evader_speed": 0.4})
    for name in ("lead", "flee"):
        policy = find_policy(name)(aviary)
        observations = aviary.reset(seeds=0)
        speed = 10 * np.linalg.norm(policy.act(observations, aviary.swarm)[0], axis=-1)
        np.testing.assert_allclose(speed, (10, 10, 10, 4), rtol=0.05)
        assert (speed <= np.array((10, 10, 10, 4)) + 1e-9).all()
    aviary.close()


def beaten(policy, episodes=10):
    """Whether evaders were captured, and returns of the chasers, in some episodes."""
    rows = bulletuav.evaluate(
        "pursuit_evasion", policy, episodes, metrics=("team_0_return",), **POINTS
    ).rows
    return [np.array([row[name] for row in rows]) for name in ("captured", "team_0_return")]


def test_chasers_beat_random_evaders_and_evaders_random_chasers():
    captured, earned = beaten("lead vs random")
    assert captured.all()
    escaped, gained = beaten("random vs flee")
    assert not escaped.any()
    assert (earned > gained).all()


@pytest.mark.parametrize("chasers", ["pure_pursuit", "area_minimising"])
def test_other_chasers_capture_who_wanders(chasers):
    captured, _ = beaten(f"{chasers} vs wander", 5)
    assert captured.mean() >= 0.8
