"""Policy `gvo`: predicted turns, and free controls."""

import math

import numpy as np
import pytest

from bulletuav.analysis.evaluation import evaluate
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.gvo import (
    STEP,
    STEPS,
    GeneralizedVelocityObstacles,
    predict_others,
    tabulate_controls,
)
from bulletuav.policies.straight import StraightLine
from bulletuav.vehicle.swarm import Swarm


def mean(rows, name):
    """Mean of a metric over episodes."""
    return np.mean([row[name] for row in rows])


def test_controls_are_sorted_by_cost_and_start_with_the_preferred_one():
    controls = tabulate_controls()
    np.testing.assert_array_equal(controls[0], 0.0)
    assert (np.diff(controls[:, 3]) >= 0).all()
    # To the right costs less than to the left
    right, left = (
        min(row[3] for row in controls if math.isclose(row[0], side * math.radians(30)))
        for side in (-1, 1)
    )
    assert right < left
    assert len({tuple(row) for row in controls[:, :3].tolist()}) == len(controls)


def test_others_turn_at_the_rate_of_their_bank():
    swarm = Swarm.zeros(1, 2, 1)
    swarm.velocity[:] = 14.0, 0.0, 1.0
    # A bank of 45 degrees to the left turns at g / V
    swarm.quaternion[0, 0] = -math.sin(math.pi / 8), 0.0, 0.0, math.cos(math.pi / 8)
    swarm.quaternion[0, 1] = swarm.quaternion[0, 0]
    others = np.empty((1, 2, STEPS + 1, 3))
    predict_others(swarm, np.array([True, False]), 9.80665, others)
    turned = 6 * STEP * 9.80665 / 14.0
    end = others[0, 0, -1] - others[0, 0, -2]
    assert math.atan2(end[1], end[0]) == pytest.approx(turned, rel=1e-9)
    assert others[0, 0, -1, 2] == pytest.approx(8.0)
    # A drone that turns by other means flies straight
    np.testing.assert_allclose(others[0, 1, -1], (8 * 14.0, 0.0, 8.0))


@pytest.fixture
def lone():
    """One aircraft that flies north."""
    options = {"start": [[0.0, 0.0, 70.0]], "goal": [[0.0, 60.0, 70.0]], "heading": 0.0}
    aviary = Aviary(
        "free_flight", 1, airframe="trainer", num_drones=1, dynamics="point_mass", **options
    )
    aviary.reset()
    yield aviary
    aviary.close()


def fly_to_goal(aviary, kind, east):
    """Fly to a goal to the east, of a radius of 2 m; return the distance at the end, m."""
    aviary.scene.goal[0, 0] = aviary.swarm.position[0, 0] + (east, 0.0, 0.0)
    aviary.task.config.__dict__["goal_radius"] = 2.0
    policy = kind(aviary)
    for _ in range(400):
        aviary.step(policy.act(None, aviary.swarm))
        if not aviary.alive[0, 0]:
            return np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    return np.inf


@pytest.mark.parametrize("east", [-60.0, 60.0])
def test_an_aircraft_alone_reaches_a_goal_on_either_side(lone, east):
    assert fly_to_goal(lone, GeneralizedVelocityObstacles, east) <= 2.0


@pytest.mark.parametrize("east", [-10.0, 18.0])
def test_a_goal_inside_the_tightest_turn_is_left_behind_first(lone, east):
    assert fly_to_goal(lone, GeneralizedVelocityObstacles, east) <= 2.0


def test_pure_pursuit_circles_around_a_goal_inside_the_tightest_turn(lone):
    assert fly_to_goal(lone, StraightLine, 18.0) == np.inf


@pytest.mark.parametrize(("num_drones", "wind"), [(8, (0, 0, 0)), (8, (3, 2, 0)), (16, (0, 0, 0))])
def test_aeroplanes_cross_without_conflict(num_drones, wind):
    options = {
        "airframe": "trainer",
        "num_drones": num_drones,
        "dynamics": "point_mass",
        "wind": wind,
    }
    assert mean(evaluate("crossing", "straight", 3, **options).rows, "conflicts") >= 4
    rows = evaluate("crossing", "gvo", 3, **options).rows
    assert mean(rows, "conflicts") == 0
    assert mean(rows, "success") == 1.0


def test_a_mixed_fleet_crosses_without_conflict():
    fleet = ("trainer", "hummingbird", "quadplane", "trainer") * 2
    options = {"airframe": fleet, "num_drones": 8, "dynamics": "point_mass"}
    rows = evaluate("crossing", "gvo", 3, **options).rows
    assert mean(rows, "conflicts") == 0
    assert mean(rows, "success") == 1.0


def test_aeroplanes_stay_with_goals_that_move():
    options = {"airframe": "trainer", "dynamics": "point_mass"}
    rows = evaluate("pursuit", "gvo", 2, **options).rows
    assert mean(rows, "drone_success") == 1.0
