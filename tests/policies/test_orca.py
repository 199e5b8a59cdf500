"""Velocities of `orca`.

Expected ones of the configurations: RVO2-3D, commit c8e6044, one step (float32), neighbours without
limit.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from traffic_around import fly as fly_points
from traffic_around import velocities as chosen
from urban import TOWER, WALL, placed

import bulletuav
from bulletuav.policies.half_spaces import (
    SYMMETRY_BREAKING_TURN,
    AvoidanceParameters,
    choose_turn,
    orca_half_space,
    turn_right,
)
from bulletuav.policies.linear_program import DEPTH, solve_linear_program, solve_velocity
from bulletuav.policies.orca import Orca, orca_velocities

# Time step, time horizon, radius of an agent, max speed; position, velocity and preferred velocity
# of each; its new velocity.
REFERENCE = {
    "head-on, nearest to the ball of the horizon": (
        (0.1, 5, 1, 2),
        [(0, 0, 0, 1, 0, 0, 1.9, 0.1, 0), (12, 0, 0, -1, 0, 0, -1.9, 0, 0.2)],
        [(1, 0.1, 0), (-1, 0, 0.2)],
    ),
    "with an offset, nearest to the cone": (
        (0.1, 5, 1, 2),
        [(0, 0, 0, 1.5, 0, 0, 1.5, 0, 0), (6, 0.4, 0.3, -1.5, 0, 0, -1.5, 0, 0)],
        [(1.404214, -0.293404, -0.220053), (-1.404214, 0.293404, 0.220053)],
    ),
    "four in a plane": (
        (0.1, 4, 0.75, 2),
        [
            (6, 0.5, 0, -1.2, 0, 0, -1.5, 0, 0),
            (0.3, 6, 0, 0, -1.1, 0, 0, -1.5, 0),
            (-6, 0.2, 0, 1.2, 0.1, 0, 1.5, 0, 0),
            (0, -6.5, 0, 0, 1, 0, 0, 1.5, 0),
        ],
        [
            (-1.31739, -0.1087623, 0),
            (-0.0349177, -1.115853, 0),
            (1.308895, 0.00488691, 0),
            (-0.01454785, 1.238875, 0),
        ],
    ),
    "example Sphere, six agents at the start": (
        (0.125, 10, 1.5, 2),
        [
            (99.749, 0, 7.074, 0, 0, 0, -0.9975, 0, -0.0707),
            (98.515, 15.643, 7.074, 0, 0, 0, -0.9852, -0.1564, -0.0707),
            (94.843, 30.899, 7.074, 0, 0, 0, -0.9484, -0.309, -0.0707),
            (99.957, 0, -2.92, 0, 0, 0, -0.9996, 0, 0.0292),
            (98.726, 15.643, -2.92, 0, 0, 0, -0.9873, -0.1564, 0.0292),
            (95.061, 30.901, -2.92, 0, 0, 0, -0.9506, -0.309, 0.0292),
        ],
        [
            (-0.9975, 0, -0.0707),
            (-0.9852, -0.1564, -0.0707),
            (-0.9484, -0.309, -0.0707),
            (-0.9996, 0, 0.0292),
            (-0.9873, -0.1564, 0.0292),
            (-0.9506, -0.309, 0.0292),
        ],
    ),
    "overlapping": (
        (0.5, 5, 1, 2),
        [(0, 0, 0, 0.5, 0.1, 0, 1, 0, 0), (1.2, 0.5, 0.3, -0.4, 0, 0.1, -1, 0, 0)],
        [(-0.1211079, -0.6726646, -0.5231837), (0.2520938, 0.7512562, 0.5843104)],
    ),
    "a crowd": (
        (0.25, 4, 0.8, 1.5),
        [
            (3.44, 3.48, -5.35, 0.36, -0.26, 0.18, -0.22, -0.24, 0.82),
            (-1.57, -4.98, -3.68, 0.34, 0.34, 0.05, -0.21, -0.3, -0.3),
            (-3.43, 4.3, -4.48, 0.11, -0.6, -0.01, -0.04, -0.81, 0.09),
            (-2.44, -0.09, 4.19, -0.75, -0.04, 0.07, 0.84, 0.13, 0.49),
            (5.58, 2.5, -3.44, 0.55, -0.21, -0.96, 0.89, 0.68, 0.49),
            (0.54, 2.47, -5.38, 0.06, -0.59, 0.48, 0.63, 0.64, -0.49),
        ],
        [
            (-0.02879091, -0.1313373, 0.7654355),
            (-0.21, -0.3, -0.3),
            (-0.04, -0.81, 0.09),
            (0.84, 0.13, 0.49),
            (1.034882, 0.6325986, 0.4382152),
            (0.08306318, -0.07862195, -0.1124346),
        ],
    ),
    "so dense that nothing is permitted": (
        (0.25, 4, 0.8, 1.5),
        [
            (-1.82, -1.16, 1.33, 0.78, 0.17, -0.06, 0.7, -0.21, -0.04),
            (0.36, -1.79, -0.29, 0.55, -0.94, 0.41, -0.71, 0.4, -0.42),
            (-0.09, -1.5, 1.03, -0.25, -0.82, 0.32, 0.74, -0.45, 0.12),
            (-1.7, -0.48, 0.07, 0.86, -0.59, 0.26, -0.2, 0.23, -0.61),
            (-0.31, 0.38, 1.05, -0.4, 0.48, 0.44, -0.64, 0.49, 0.5),
            (2.01, -0.95, 0.65, -0.56, 0.66, 0.32, 0.13, 0.84, -0.59),
            (0.86, -0.91, -2.19, 0.37, 0.64, -0.14, 0.7, -0.66, 0.93),
            (2.08, -0.89, -0.82, 0.52, 0.76, -0.8, 0.25, 0.21, 0.94),
        ],
        [
            (0.385386, -0.1968487, 0.4263457),
            (-0.2608198, -1.084486, -0.2885326),
            (0.3203881, -0.45972, 0.7778629),
            (-0.2833169, -0.2280115, -0.4108303),
            (-0.64, 0.49, 0.5),
            (-0.09251993, 0.8253537, 0.04202379),
            (0.4125778, -0.08493694, -0.1027224),
            (0.5194204, 0.2773551, -0.4467232),
        ],
    ),
}

numbers = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def velocities(state, rules, **around):
    return chosen(orca_velocities, state, rules, **around)


def without_turns(state, rules, wishes=None):
    """Permitted velocities nearest to wishes, in half-spaces of all drones one by one."""
    state = np.array(state, float).reshape(-1, 3, 3)
    found = []
    for i, (here, own, wish) in enumerate(state):
        spaces = [
            orca_half_space(
                tuple(there - here), tuple(own), tuple(other), rules.separation, rules, 0.5
            )
            for there, other, _ in np.delete(state, i, axis=0)
        ]
        room, spare = rows(np.array([(*n, bound) for n, bound in spaces]))
        aim = wish if wishes is None else wishes[i]
        found.append(solve_velocity(room, spare, len(spaces), tuple(aim), rules.max_speed))
    return np.array(found)


def crowd(rng, drones=8, side=8.0):
    return np.concatenate(
        [rng.uniform(-side, side, (drones, 3)), rng.uniform(-1.5, 1.5, (drones, 6))], axis=1
    )


@pytest.mark.parametrize("name", REFERENCE)
def test_velocities_are_those_of_the_reference_library(name):
    (step, horizon, radius, speed), state, expected = REFERENCE[name]
    rules = AvoidanceParameters(2.0 * radius, float(horizon), 1.0, step, float(speed))
    np.testing.assert_allclose(without_turns(state, rules), expected, atol=1e-5)


@pytest.mark.parametrize("name", REFERENCE)
def test_wishes_turn_right_by_as_much_as_is_not_given(name):
    """The same half-spaces, with wishes that turn a little, and then by what is left of them."""
    (step, horizon, radius, speed), state, _ = REFERENCE[name]
    rules = AvoidanceParameters(2.0 * radius, float(horizon), 1.0, step, float(speed))
    first = [turn_right(row[6:], SYMMETRY_BREAKING_TURN) for row in state]
    given = without_turns(state, rules, first)
    angles = [choose_turn(one, tuple(best)) for one, best in zip(first, given, strict=True)]
    again = [turn_right(one, angle) for one, angle in zip(first, angles, strict=True)]
    expected = without_turns(state, rules, again)
    np.testing.assert_allclose(velocities(state, rules), expected, atol=1e-6)


def half_spaces(rng, count=10):
    n = rng.normal(size=(count, 3))
    return np.column_stack(
        [n / np.linalg.norm(n, axis=1, keepdims=True), rng.uniform(-6, 2, count)]
    )


def rows(spaces):
    room = np.zeros((DEPTH, len(spaces), 4))
    room[0] = spaces
    return room, np.zeros_like(room)


def minimum(cost, gradient, begin, spaces, slack):
    """Minimum by SLSQP over velocities of up to 5 m/s.

    Where `slack` is 1, over how much they may miss the half-spaces, too.
    """
    normals = np.column_stack([spaces[:, :3], np.full(len(spaces), slack)])
    inside = {"type": "ineq", "fun": lambda x: normals @ x - spaces[:, 3], "jac": lambda x: normals}
    ball = {
        "type": "ineq",
        "fun": lambda x: 25 - x[:3] @ x[:3],
        "jac": lambda x: -2 * np.append(x[:3], 0),
    }
    options = {"ftol": 1e-14, "maxiter": 500}
    return minimize(
        cost, begin, jac=gradient, constraints=[inside, ball], method="SLSQP", options=options
    ).x


@given(numbers)
def test_linear_program_finds_the_optimum(rng):
    spaces, wanted = half_spaces(rng), rng.normal(0, 6, 3)
    room, spare = rows(spaces)
    met, nearby = solve_linear_program(room, len(spaces), tuple(wanted), 5.0, False)
    best = np.array(solve_velocity(room, spare, len(spaces), tuple(wanted), 5.0))
    assert np.linalg.norm(best) <= 5 + 1e-9
    least = minimum(
        lambda x: x[3], lambda x: np.array((0, 0, 0, 1.0)), np.array((0, 0, 0, 9.0)), spaces, 1
    )
    assert (
        np.max(spaces[:, 3] - spaces[:, :3] @ best) == pytest.approx(max(least[3], 0), abs=1e-6)
        or least[3] < 0
    )
    if least[3] < -1e-3:
        assert met == len(spaces)
        np.testing.assert_array_equal(best, nearby)
        assert (spaces[:, :3] @ best >= spaces[:, 3] - 1e-8).all()
        begin = least - np.array((0, 0, 0, least[3]))
        other = minimum(
            lambda x: ((x[:3] - wanted) ** 2).sum() + x[3] ** 2,
            lambda x: 2 * (x - np.append(wanted, 0)),
            begin,
            spaces,
            0,
        )
        np.testing.assert_allclose(best, other[:3], atol=1e-6)


@pytest.mark.parametrize(
    ("spaces", "wanted", "expected"),
    [
        ([(1, 0, 0, 1), (1, 0, 0, 2)], (0, 0, 0), (2, 0, 0)),  # parallel
        (
            [(1, 0, 0, 1), (-1, 0, 0, 1)],
            (3, 1, 0),
            (0, 0, 0),
        ),  # contradicting: in the middle of both
        ([(1, 0, 0, 9)], (0, 1, 0), (5, 0, 0)),  # beyond the ball
        ([(1, 0, 0, 9), (1, 0, 0, 10)], (0, 1, 0), (5, 0, 0)),  # both
        ([(1, 0, 0, 1), (0, 1, 0, 2), (0, 0, 1, 3)], (0, 0, 0), (1, 2, 3)),  # a corner
        (
            [(1, 0, 0, 0), (0.6, 0.8, 0, 0), (0.6, -0.8, 0, 0)],
            (-1, 0, 0),
            (0, 0, 0),
        ),  # three planes through a line
    ],
)
def test_linear_program_by_hand(spaces, wanted, expected):
    room, spare = rows(np.array(spaces, float))
    np.testing.assert_allclose(
        solve_velocity(room, spare, len(spaces), wanted, 5.0), expected, atol=1e-9
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (0.6, 0, 0.8)])
def test_a_pair_changes_places(axis):
    """Both turn to their right, also where one is above the other."""
    places = 10 * np.array((axis, -np.array(axis)))
    end, least = fly_points(
        orca_velocities, places, -places, AvoidanceParameters(2.0, 3.0, 1.0, 0.1, 2.0), 20.0
    )
    np.testing.assert_allclose(end, -places, atol=1e-2)
    assert least >= 2 - 1e-3


@given(numbers)
def test_the_order_of_drones_and_their_heading_do_not_matter(rng):
    state, rules = crowd(rng), AvoidanceParameters(1.6, 4.0, 1.0, 0.25, 1.5)
    expected = velocities(state, rules)
    order, angle = rng.permutation(len(state)), rng.uniform(0, 2 * np.pi)
    np.testing.assert_allclose(velocities(state[order], rules), expected[order], atol=1e-6)
    turn = np.array(
        ((np.cos(angle), -np.sin(angle), 0), (np.sin(angle), np.cos(angle), 0), (0, 0, 1))
    )
    moved = (state.reshape(-1, 3, 3) @ turn.T).reshape(-1, 9)
    np.testing.assert_allclose(velocities(moved, rules), expected @ turn.T, atol=1e-6)


@given(numbers)
def test_up_and_down_are_alike(rng):
    state, rules = crowd(rng), AvoidanceParameters(1.6, 4.0, 1.0, 0.25, 1.5)
    mirrored = state * np.tile((1, 1, -1), 3)
    expected = velocities(state, rules) * (1, 1, -1)
    np.testing.assert_allclose(velocities(mirrored, rules), expected, atol=1e-6)


def test_all_drones_count_that_can_come_too_close_within_the_horizon():
    """At 1.5 m/s each, 1.6 m apart for 4 s: those within 13.6 m, and no others."""
    rules = AvoidanceParameters(1.6, 4.0, 1.0, 0.25, 1.5)
    own = (0, 0, 0, 0, 0, 0, 1.5, 0, 0)
    for distance, is_free in ((13.5, False), (13.7, True)):
        state = [own, (distance, 0, 0, -1.5, 0, 0, -1.5, 0, 0)]
        free = velocities([own, (1000, 0, 0, 0, 0, 0, 0, 0, 0)], rules)[0]
        assert np.array_equal(velocities(state, rules)[0], free) == is_free
    # Also the fortieth of a row, which has slower ones before it.
    row = [(0, 0.5 * k - 10, 2.0, 0, 0, 0, 0, 0, 0) for k in range(40)]
    fast = (9.0, 0, 0, -1.5, 0, 0, -1.5, 0, 0)
    with_it, without = velocities([own, *row, fast], rules)[0], velocities([own, *row], rules)[0]
    assert not np.allclose(with_it, without)


def test_drones_that_do_not_fly_do_not_count():
    state, rules = (
        crowd(np.random.default_rng(1), 12, 3.0),
        AvoidanceParameters(1.6, 4.0, 1.0, 0.25, 1.5),
    )
    alive = np.arange(12) < 5
    masked = velocities(state, rules, alive=alive)
    np.testing.assert_array_equal(masked[alive], velocities(state[alive], rules))
    assert not np.allclose(masked[alive], velocities(state, rules)[alive])


@pytest.fixture
def fly():
    """Flies episodes to the end; returns how many conflicts began, and who succeeded (W, N)."""

    def run(policy, task, worlds, **options):
        aviary = bulletuav.Aviary(task, worlds, **options)
        pilot, observations = policy(aviary), aviary.reset(seeds=0)
        pilot.reset(np.ones(worlds, bool))
        conflicts, success = 0, np.zeros(aviary.alive.shape, bool)
        while aviary.alive.any():
            step = aviary.step(pilot.act(observations, aviary.swarm))
            observations = step.observations
            conflicts += step.info["conflicts"].sum() // 2
            success |= step.info["success"]
        aviary.close()
        return conflicts, success

    return run


def test_policy_crosses_without_conflict(fly):
    conflicts, success = fly(Orca, "crossing", 3, dynamics="bullet")
    assert conflicts == 0
    assert success.all()


@pytest.mark.parametrize("dynamics", ["single_integrator", "bullet"])
def test_policy_keeps_off_buildings(fly, dynamics):
    """Straight through a tower 20 m wide, and before a wall 100 m wide."""
    options = {"dynamics": dynamics, "num_drones": 1, "height": (5.0, 20.0), "ceiling": 120.0}
    task = placed("navigation", [(-50.0, 0, 10)], goal=[(50.0, 0, 10)])
    _, success = fly(Orca, task, 1, city=TOWER, **options)
    assert success.all()
    aviary = bulletuav.Aviary(task, city=WALL, horizon=200, **options)
    pilot, observations = Orca(aviary), aviary.reset(seeds=0)
    while aviary.alive.any():
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        assert not step.info["collision"].any()
    aviary.close()


def test_policy_gives_velocities_only():
    with pytest.raises(
        ValueError,
        match="policy 'orca' supports velocity or velocity_increment actions, not 'rotor': "
        "choose action='velocity'",
    ):
        Orca(bulletuav.Aviary("crossing", action="rotor"))
