"""Conflicts, neighbours, weights and overlaps, each function by itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist
from swarms import PLACES, place_points

from bulletuav.conflict.separation import measure_conflict
from bulletuav.tasks.base import merge_weights
from bulletuav.tasks.observations.neighbours import (
    INTRUDER_HORIZON,
    NO_HORIZON,
    write_nearest_known,
    write_nearest_present,
)
from bulletuav.tasks.starts import check_overlap

NEIGHBOURS = 3


@given(st.integers(0, 10**6), st.integers(1, 6))
def test_conflict_agrees_with_dense_sampling_of_the_straight_paths(seed, drones):
    rng = np.random.default_rng(seed)
    before, after = rng.uniform(-10, 10, (2, 1, drones, 3))
    alive = rng.uniform(size=(1, drones)) < 0.8
    d_safe = 5.0
    result = measure_conflict(before, after, alive, d_safe, 2 * d_safe)
    paths = before[0] + np.linspace(0, 1, 4001)[:, None, None] * (after[0] - before[0])
    for i in range(drones):
        gaps = np.array(
            [
                np.linalg.norm(paths[:, j] - paths[:, i], axis=1)
                for j in range(drones)
                if j != i and alive[0, j]
            ]
        )
        if not alive[0, i] or not len(gaps):
            assert result.separation[0, i] == np.inf
            assert result.onsets[0, i] == result.nearness[0, i] == 0
            continue
        least = gaps.min(axis=1)
        assert result.separation[0, i] == pytest.approx(least.min(), abs=0.02)
        clear = np.abs(least - d_safe) > 0.02
        if clear.all():
            assert result.onsets[0, i] == ((least < d_safe) & (gaps[:, 0] >= d_safe)).sum()
        assert result.nearness[0, i] == pytest.approx(
            np.clip(2 - least / d_safe, 0, 1).sum(), abs=0.02
        )


def test_a_fast_pass_between_two_decisions_is_seen_and_counted_once():
    before = np.array([[(-10.0, 0, 0), (10.0, 1, 0)]])
    passing = before * [-1, 1, 1]
    alive = np.ones((1, 2), dtype=bool)
    during = measure_conflict(before, passing, alive, 5.0, 10.0)
    np.testing.assert_allclose(during.separation, 1.0)
    np.testing.assert_array_equal(during.onsets, 1)
    np.testing.assert_array_equal(measure_conflict(passing, passing, alive, 5.0, 10.0).onsets, 0)
    near = np.array([[(0.0, 0, 0), (4.0, 0, 0)]])
    nearer = np.array([[(0.0, 0, 0), (3.0, 0, 0)]])
    # It lasts, it does not begin.
    np.testing.assert_array_equal(measure_conflict(near, nearer, alive, 5.0, 10.0).onsets, 0)
    np.testing.assert_array_equal(measure_conflict(near, nearer, alive, 3.5, 7.0).onsets, 1)


@given(st.integers(0, 10**6), st.integers(1, 8))
def test_neighbours_are_the_nearest_present_others(seed, drones):
    rng = np.random.default_rng(seed)
    position, velocity = rng.normal(size=(2, 1, drones, 3))
    present = rng.uniform(size=(1, drones)) < 0.7
    shape = (1, drones, drones, 3)
    known = present[:, None] & ~np.eye(drones, dtype=bool)
    out = np.zeros((1, drones, 7 * NEIGHBOURS))
    theirs = (np.broadcast_to(array[:, None], shape) for array in (position, velocity))
    write_nearest_known(position, velocity, *theirs, known, NO_HORIZON, NEIGHBOURS, out)
    same = np.zeros_like(out)
    write_nearest_present(position, velocity, present, NO_HORIZON, NEIGHBOURS, same)
    np.testing.assert_array_equal(same, out)
    distance = cdist(position[0], position[0])
    for i in range(drones):
        others = [j for j in np.argsort(distance[i]) if j != i and present[0, j]][:NEIGHBOURS]
        expected = [
            (distance[i, j], *(position[0, j] - position[0, i]), *(velocity[0, j] - velocity[0, i]))
            for j in others
        ]
        expected += [(0.0,) * 7] * (NEIGHBOURS - len(others))
        np.testing.assert_allclose(out[0, i].reshape(NEIGHBOURS, 7), expected, atol=1e-12)


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("drones", [199, 200, 300, 700])
def test_neighbours_of_many_have_the_bits_and_the_order_of_all_pairs(kind, drones):
    rng = np.random.default_rng(drones)
    position = place_points(rng, kind, drones)[None]
    velocity = np.round(rng.normal(size=position.shape))
    shape = (1, drones, drones, 3)
    theirs = [np.broadcast_to(array[:, None], shape) for array in (position, velocity)]
    for share, horizon in ((0.8, NO_HORIZON), (1.0, INTRUDER_HORIZON), (0.01, NO_HORIZON)):
        present = rng.uniform(size=(1, drones)) < share
        known = present[:, None] & ~np.eye(drones, dtype=bool)
        out, same = np.zeros((2, 1, drones, 7 * NEIGHBOURS))
        write_nearest_known(position, velocity, *theirs, known, horizon, NEIGHBOURS, out)
        write_nearest_present(position, velocity, present, horizon, NEIGHBOURS, same)
        np.testing.assert_array_equal(same, out)


def test_intruders_are_those_that_come_nearest_and_not_those_that_are():
    """Two fly north side by side, 20 m apart; the third meets the first in 6 s."""
    position = np.array([[(0.0, 0, 40), (20, 0, 40), (60, 60, 40)]])
    velocity = np.array([[(0.0, 10, 0), (0, 10, 0), (-10, 0, 0)]])
    expected = {
        NO_HORIZON: [20, 20, 0, 0, 0, 0, 0],
        INTRUDER_HORIZON: [7200**0.5, 60, 60, 0, -10, -10, 0],
    }
    for horizon, first in expected.items():
        out = np.zeros((1, 3, 7))
        write_nearest_present(position, velocity, np.ones((1, 3), bool), horizon, 1, out)
        np.testing.assert_allclose(out[0, 0], first, atol=1e-12)


def test_weights_merge_by_name():
    assert merge_weights({"a": 1.0, "b": 2.0}, {"b": 3.0}) == {"a": 1.0, "b": 3.0}
    with pytest.raises(ValueError, match="did you mean 'goal'"):
        merge_weights({"goal": 1.0}, {"gaol": 2.0})


def test_overlap_names_the_pair():
    check_overlap(np.array([(0.0, 0, 0), (0.3, 0, 0)]), 0.1)
    check_overlap(np.array([(0.0, 0, 0)]), 0.1)
    with pytest.raises(ValueError, match="drones 0 and 2 overlap"):
        check_overlap(np.array([(0.0, 0, 0), (5, 0, 0), (0.1, 0, 0)]), 0.1)
