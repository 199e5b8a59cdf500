"""Conflict measures against oracles, Monte Carlo and their own symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from bulletuav.tasks.terms.measures import (
    closest_point_of_approach,
    conflict_probability,
    conflict_probability_of,
    in_cylinder,
    offsets,
    time_to_conflict,
)

vector = st.tuples(*[st.floats(-50, 50)] * 3).map(np.array)


@pytest.mark.parametrize(("distance", "sigma", "d_safe", "figure"), [(0, 1, 1, 0.198748), (10, 3, 5, 0.0179474)])
def test_probability_oracles(distance, sigma, d_safe, figure):
    offset = np.array([0.0, distance, 0.0])
    assert conflict_probability(offset, sigma, d_safe) == pytest.approx(figure, rel=1e-5)
    assert conflict_probability_of(offset, sigma**2 * np.eye(3), d_safe) == pytest.approx(figure, rel=1e-5)


def test_probability_with_any_covariance_against_monte_carlo():
    rng = np.random.default_rng(0)
    for stretch in (0.1, 1.0, 5.0):
        root = rng.normal(size=(3, 3)) * (1.0, 1.0, stretch)
        covariance, offset = root @ root.T + 0.1 * np.eye(3), rng.normal(size=3) * 2
        drawn = np.linalg.norm(rng.multivariate_normal(offset, covariance, 400_000), axis=1) < 2.5
        assert conflict_probability_of(offset, covariance, 2.5) == pytest.approx(drawn.mean(), abs=4 * 0.5 / 400_000**0.5)


def test_probability_needs_a_covariance():
    with pytest.raises(ValueError, match="positive definite"):
        conflict_probability_of(np.zeros(3), np.diag([1.0, 1.0, 0.0]), 1.0)


@pytest.mark.parametrize(
    ("offset", "velocity", "seconds"),
    [
        ((100, 0, 0), (-20, 0, 0), 4.75),
        ((100, 6, 0), (-20, 0, 0), np.inf),
        ((3, 0, 0), (0, 0, 0), 0.0),
        ((100, 0, 0), (20, 0, 0), np.inf),
        ((100, 0, 0), (0, 0, 0), np.inf),
        ((3, 4, 0), (-1, 0, 0), 0.0),  # on the edge, going in
    ],
)
def test_time_to_conflict_oracles(offset, velocity, seconds):
    assert time_to_conflict(np.array(offset, float), np.array(velocity, float), 5.0) == pytest.approx(seconds)


@given(vector, vector, st.floats(0.5, 20))
def test_closest_approach_and_time_to_conflict_agree_with_the_path(offset, velocity, d_safe):
    time, distance = closest_point_of_approach(offset, velocity)
    best = minimize_scalar(lambda t: np.linalg.norm(offset + velocity * t), bounds=(0, 2 * time + 1), method="bounded")
    assert distance <= best.fun + 1e-9 * (1 + best.fun)
    assert distance == pytest.approx(np.linalg.norm(offset + velocity * time))
    enters = time_to_conflict(offset, velocity, d_safe)
    if np.linalg.norm(offset) < d_safe:
        assert enters == 0
    elif np.isfinite(enters):
        assert np.linalg.norm(offset + velocity * enters) == pytest.approx(d_safe, rel=1e-6)
        assert enters <= time * (1 + 1e-9)
    else:
        assert distance >= d_safe * (1 - 1e-9)


def test_cylinder_needs_both_separations():
    found = in_cylinder(np.array([(3.0, 4, 1), (3.1, 4, 1), (3, 4, -2), (0, 0, 1.9)]), 5.0001, 2.0)
    np.testing.assert_array_equal(found, [True, False, False, True])


def test_all_pairs_of_500_at_once():
    rng = np.random.default_rng(1)
    position, velocity = rng.uniform(0, 100, (500, 3)), rng.normal(size=(500, 3))
    apart, passing = offsets(position), offsets(velocity)
    np.testing.assert_array_equal(apart[3, 7], position[7] - position[3])
    times = time_to_conflict(apart, passing, 5.0)
    assert times.shape == (500, 500)
    np.testing.assert_allclose(times, times.T)
    chances = conflict_probability(apart, 2.0, 5.0)
    np.testing.assert_allclose(chances, chances.T)
    assert chances[3, 7] == pytest.approx(conflict_probability_of(apart[3, 7], 4 * np.eye(3), 5.0), abs=2e-9)
