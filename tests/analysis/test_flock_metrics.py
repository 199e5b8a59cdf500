"""Metrics of flocks, against numbers by hand, in a task with links and in one without."""

import math

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.metrics import find_metric

START = ((0.0, 0, 40), (10.0, 0, 40), (0.0, 40, 40), (4.0, 40, 40))
"""Two pairs, one of them closer than the 5 m of d_safe"""
VELOCITY = np.array([[(6.0, 0, 0), (0, 6.0, 0), (-3.0, 0, 0), (-3.0, 0, 0)]])
ORDER = math.sqrt(1 + 1) / 4
"""Norm of the sum of (1, 0), (0, 1), (-1, 0) and (-1, 0), over 4"""


@pytest.fixture
def aviary():
    made = bulletuav.Aviary(
        "flocking", num_drones=4, start=START, dynamics="single_integrator", difficulty="easy"
    )
    made.reset(seeds=0)
    yield made
    made.close()


def measured(aviary, name, decisions=1):
    metric = find_metric(name).start(aviary)
    for _ in range(decisions):
        step = aviary.step(aviary.action.encode(VELOCITY))
        value = metric(step, aviary)
    return value[0]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("flock_order", ORDER),
        ("flock_correlation", (0 + 0 + 1 + 1) / 4),
        ("flock_speed", 4.5),
        ("flock_collisions", 1 / 6),
        ("flock_wall", 0),
        # Mean of squares less the square of the mean (0, 1.5)
        ("flock_velocity_variance", (36 + 36 + 9 + 9) / 4 - 1.5**2),
        ("flock_connectivity", 2 / 3),
    ],
)
def test_numbers_of_one_decision(aviary, name, value):
    assert measured(aviary, name) == pytest.approx(value)


def test_the_cohesion_radius_is_the_mean_over_decisions(aviary):
    expected = []
    for k in (1, 2):
        places = np.array(START) + 0.1 * k * VELOCITY[0]
        expected.append(np.linalg.norm(places - places.mean(axis=0), axis=1).max())
    assert measured(aviary, "flock_radius", 2) == pytest.approx(np.mean(expected))


def test_drones_beyond_the_arena_are_counted(aviary):
    aviary.task.arena_high[1] = 30.0
    assert measured(aviary, "flock_wall") == 0.5


def test_hovering_drones_have_no_order_in_any_task():
    names = ("flock_order", "flock_speed", "flock_connectivity", "flock_correlation")
    options = {"dynamics": "single_integrator", "difficulty": "easy", "horizon": 5}
    row = bulletuav.evaluate("crossing", "stay", 1, metrics=names, **options).rows[0]
    assert row["flock_order"] == row["flock_correlation"] == 0
    assert row["flock_speed"] == pytest.approx(0, abs=1e-6)
    # Two pairs in two teams, 20 m apart, and links of 15 m
    assert row["flock_connectivity"] == 0
    row = bulletuav.evaluate("crossing", "straight", 1, metrics=names, **options).rows[0]
    # Two of four fly north, two east
    assert row["flock_order"] == pytest.approx(math.sqrt(8) / 4, abs=1e-3)
    assert row["flock_speed"] > 5
