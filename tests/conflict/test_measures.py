"""Conflict measures against oracles, Monte Carlo and their own symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.special import ndtr
from scipy.stats import ncx2

from bulletuav.conflict import measures
from bulletuav.conflict.measures import (
    closest_point_of_approach,
    conflict_probability,
    conflict_probability_of,
    in_cylinder,
    pair_offsets,
    time_to_conflict,
)

vector = st.tuples(*[st.floats(-50, 50)] * 3).map(np.array)
spread = st.tuples(*[st.floats(-4, 4)] * 3).map(lambda powers: 10.0 ** np.array(powers))
turn = st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(random_state=seed).as_matrix())


@pytest.mark.parametrize(
    ("distance", "sigma", "d_safe", "figure"), [(0, 1, 1, 0.198748), (10, 3, 5, 0.0179474)]
)
def test_probability_oracles(distance, sigma, d_safe, figure):
    offset = np.array([0.0, distance, 0.0])
    assert conflict_probability(offset, sigma, d_safe) == pytest.approx(figure, rel=1e-5)
    assert conflict_probability_of(offset, sigma**2 * np.eye(3), d_safe) == pytest.approx(
        figure, rel=1e-5
    )


def test_isotropic_probability_is_noncentral_chi_square():
    distance, sigma = np.geomspace(1e-12, 30, 60)[:, None], np.geomspace(0.2, 1e3, 40)
    found = conflict_probability(distance[..., None] * (0, 0.6, 0.8), sigma, 5.0)
    np.testing.assert_allclose(
        found, ncx2.cdf((5 / sigma) ** 2, 3, (distance / sigma) ** 2), rtol=0, atol=1e-12
    )
    assert conflict_probability(np.zeros(3), 2.0, 5.0) == pytest.approx(
        conflict_probability(np.full(3, 1e-9), 2.0, 5.0)
    )


def test_isotropic_probability_at_the_extremes():
    # Where sigma is small the ball is a half space: half of it on the edge, less the share
    # sigma / (d sqrt(2 pi)) of the curvature.
    for sigma in (1e-3, 1e-6, 1e-9):
        edge = 0.5 - sigma / (5 * np.sqrt(2 * np.pi))
        assert conflict_probability(np.array([5.0, 0, 0]), sigma, 5.0) == pytest.approx(
            edge, abs=1e-12
        )
        assert conflict_probability(np.array([1.0, 0, 0]), sigma, 5.0) == 1
        assert conflict_probability(np.array([9.0, 0, 0]), sigma, 5.0) == 0


def test_probability_with_any_covariance_against_monte_carlo():
    rng = np.random.default_rng(0)
    for stretch in (0.1, 1.0, 5.0):
        root = rng.normal(size=(3, 3)) * (1.0, 1.0, stretch)
        covariance, offset = root @ root.T + 0.1 * np.eye(3), rng.normal(size=3) * 2
        drawn = np.linalg.norm(rng.multivariate_normal(offset, covariance, 400_000), axis=1) < 2.5
        assert conflict_probability_of(offset, covariance, 2.5) == pytest.approx(
            drawn.mean(), abs=4 * 0.5 / 400_000**0.5
        )


def test_probability_with_a_flat_covariance_does_not_underflow():
    rng = np.random.default_rng(2)
    for sigma, distance in ((0.1, 4.9), (0.01, 4.99), (1e-3, 4.0)):
        offset, sigmas = np.array([distance, 0, 0]), np.array([sigma, 1, 1])
        drawn = np.linalg.norm(offset + sigmas * rng.normal(size=(400_000, 3)), axis=1) < 5
        found = conflict_probability_of(offset, np.diag(sigmas**2), 5.0)
        assert found == pytest.approx(drawn.mean(), abs=4 * 0.5 / 400_000**0.5)


@pytest.mark.parametrize(
    ("mean", "sigmas", "d_safe"),
    [
        ((1, 2, 3), (1, 2, 3), 4),
        ((0, 0, 5), (0.3, 0.5, 1), 5),
        ((4.9, 0, 0), (0.1, 1, 1), 5),
        ((0, 0.5, 0), (2, 9, 30), 1),
    ],
)
def test_probability_with_any_covariance_against_quadrature(mean, sigmas, d_safe):
    def column(angle, radius):
        x, y, half = radius * np.cos(angle), radius * np.sin(angle), np.sqrt(d_safe**2 - radius**2)
        density = np.exp(
            -0.5 * (((x - mean[0]) / sigmas[0]) ** 2 + ((y - mean[1]) / sigmas[1]) ** 2)
        )
        inside = ndtr((half - mean[2]) / sigmas[2]) - ndtr((-half - mean[2]) / sigmas[2])
        return radius * density * inside / (2 * np.pi * sigmas[0] * sigmas[1])

    figure, _ = dblquad(column, 0, d_safe, -np.pi, np.pi, epsabs=1e-10, epsrel=1e-10)
    found = conflict_probability_of(np.array(mean, float), np.diag(sigmas) ** 2.0, d_safe)
    assert found == pytest.approx(figure, abs=2e-9)


def test_probability_with_errors_far_from_d_safe():
    # Tiny in two axes: the normal distribution on a chord. Huge: the density at the centre times
    # the volume.
    offset, sigmas = np.array([0.3, 0.0, 0.0]), np.array([2.0, 1e-7, 1e-7])
    chord = ndtr((1 - 0.3) / 2) - ndtr((-1 - 0.3) / 2)
    assert conflict_probability_of(offset, np.diag(sigmas**2), 1.0) == pytest.approx(
        chord, abs=1e-9
    )
    wide = conflict_probability_of(offset, np.diag([1e4, 1e6, 1e8]), 1.0, tolerance=1e-15)
    assert wide == pytest.approx(4 / 3 * np.pi / ((2 * np.pi) ** 1.5 * 1e9), rel=1e-4)
    for far in (1e3, 1e50, 1e100):
        assert conflict_probability_of(offset * far, np.diag([1e-9, 1e-5, 1e-6]), 1.0) == 0


@given(vector, spread, turn, turn, st.floats(0.1, 30), st.floats(1, 2))
def test_probability_is_one_turns_along_and_grows_with_d_safe(
    offset, sigmas, axes, rotation, d_safe, more
):
    covariance = axes @ np.diag(sigmas**2) @ axes.T
    covariance += 1e-6 * np.trace(covariance) * np.eye(3)  # rounding must not matter
    found = conflict_probability_of(offset, covariance, d_safe)
    assert 0 <= found <= 1
    assert conflict_probability_of(
        rotation @ offset, rotation @ covariance @ rotation.T, d_safe
    ) == pytest.approx(found, abs=3e-9)
    assert conflict_probability_of(offset, covariance, d_safe * more) >= found - 2e-9
    assert conflict_probability_of(offset, covariance, d_safe, 1e-6) == pytest.approx(
        found, abs=1e-6
    )


@given(vector, st.floats(-3, 4), st.floats(0.1, 30))
def test_probabilities_agree_on_isotropic_errors(offset, power, d_safe):
    sigma = 10.0**power
    found = conflict_probability_of(offset, sigma**2 * np.eye(3), d_safe)
    assert found == pytest.approx(conflict_probability(offset, sigma, d_safe), abs=1e-9)


@pytest.mark.parametrize(
    ("covariance", "words"),
    [
        (np.diag([1.0, 1.0, 0.0]), r"\[0.0, 0.0, 0.0\].*positive definite"),
        (np.diag([1.0, 1.0, -1.0]), "positive definite"),
        (np.eye(3) + np.eye(3, k=1) / 2, "symmetric"),
        (np.diag([1.0, np.nan, 1.0]), "nan.*not finite"),
    ],
)
def test_probability_needs_a_covariance(covariance, words):
    with pytest.raises(ValueError, match=words):
        conflict_probability_of(np.zeros((2, 3)), np.stack([np.eye(3), covariance]), 1.0)


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_probabilities_need_lengths(wrong):
    with pytest.raises(ValueError, match=f"sigma is {wrong} m"):
        conflict_probability(np.zeros((2, 3)), np.array([1.0, wrong]), 1.0)
    with pytest.raises(ValueError, match=f"d_safe is {wrong} m"):
        conflict_probability(np.zeros(3), 1.0, wrong)
    with pytest.raises(ValueError, match=f"d_safe is {wrong} m"):
        conflict_probability_of(np.zeros(3), np.eye(3), wrong)


def test_a_probability_out_of_reach_is_refused():
    with pytest.raises(ValueError, match=r"within 1e-25 at offset \[1.0, 0.0, 0.0\] m"):
        conflict_probability_of(np.array([1.0, 0, 0]), np.eye(3), 1.0, tolerance=1e-25)
    with pytest.raises(ValueError, match="nan"):
        conflict_probability_of(np.array([(1.0, 0, 0), (np.nan, 0, 0)]), np.eye(3), 1.0)


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
    assert time_to_conflict(
        np.array(offset, float), np.array(velocity, float), 5.0
    ) == pytest.approx(seconds)


@given(vector, vector, st.floats(0.5, 20))
def test_closest_approach_and_time_to_conflict_agree_with_the_path(offset, velocity, d_safe):
    time, distance = closest_point_of_approach(offset, velocity)
    best = minimize_scalar(
        lambda t: np.linalg.norm(offset + velocity * t), bounds=(0, 2 * time + 1), method="bounded"
    )
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
    root = rng.normal(size=(500, 3, 3))
    covariance = root @ root.swapaxes(1, 2) + 0.1 * np.eye(3)
    both = covariance[:, None] + covariance
    apart, passing = pair_offsets(position), pair_offsets(velocity)
    results = {
        "apart": np.linalg.norm(apart, axis=-1),
        "in cylinder": in_cylinder(apart, 20.0, 10.0),
        "approach": closest_point_of_approach(apart, passing)[0],
        "distance": closest_point_of_approach(apart, passing)[1],
        "time": time_to_conflict(apart, passing, 5.0),
        "chance": conflict_probability(apart, 2.0, 5.0),
        "any chance": conflict_probability_of(apart, both, 5.0),
    }
    for name, values in results.items():
        assert values.shape == (500, 500), name
        np.testing.assert_allclose(values, values.T, atol=1e-9, err_msg=name)
    i, j = np.argwhere((results["any chance"] > 0.1) & (results["any chance"] < 0.9))[0]
    np.testing.assert_array_equal(apart[i, j], position[j] - position[i])
    assert results["in cylinder"][i, j] == in_cylinder(apart[i, j], 20.0, 10.0)
    assert results["time"][i, j] == time_to_conflict(apart[i, j], passing[i, j], 5.0)
    assert results["chance"][i, j] == conflict_probability(apart[i, j], 2.0, 5.0)
    assert results["any chance"][i, j] == pytest.approx(
        conflict_probability_of(apart[i, j], both[i, j], 5.0), abs=1e-12
    )
    np.testing.assert_allclose(
        conflict_probability_of(apart, 4 * np.eye(3), 5.0), results["chance"], rtol=0, atol=1e-9
    )


def test_the_former_name_of_offsets_warns():
    with pytest.warns(DeprecationWarning, match="offsets is now pair_offsets"):
        assert measures.offsets is measures.pair_offsets
    with pytest.raises(AttributeError, match="no attribute 'distance'"):
        _ = measures.distance
