"""Obstacles that are drawn anew: those that keep off no place."""

import numpy as np
import pytest

from bulletuav.tasks.parts.obstacle_field import find_first_near


@pytest.mark.parametrize("seed", range(5))
def test_the_first_that_does_not_keep_off_is_found(seed):
    rng = np.random.default_rng(seed)
    obstacle, places = rng.uniform(-10, 10, (12, 3)), rng.uniform(-10, 10, (6, 3))
    min_distance = rng.uniform(0, 9, 12)
    gaps = np.linalg.norm(places - obstacle[:, None], axis=2).min(axis=1)
    near = gaps <= min_distance
    assert near.any()
    assert not near.all()
    for first in range(13):
        expected = next((k for k in range(first, 12) if near[k]), 12)
        assert find_first_near(obstacle, first, min_distance, places) == expected


def test_a_distance_has_to_be_exceeded():
    places = np.array([(3.0, 4.0, 0.0)])
    obstacle = np.zeros((2, 3))
    assert find_first_near(obstacle, 0, np.array([5.0, 4.0]), places) == 0
    assert find_first_near(obstacle, 0, np.array([4.9, 5.1]), places) == 1
    assert find_first_near(obstacle, 2, np.array([5.0, 5.0]), places) == 2
