"""Separations in lanes, against pairs of drones one by one."""

import math

import numpy as np
import pytest
from swarms import PLACES, place_points

from bulletuav.conflict.separation import measure_conflict
from bulletuav.geometry.closest_approach import closest_squared_distances

D_SAFE, ZONE = 0.5, 1.0


def pair_by_pair(before, after, alive):
    """Sum up the pairs of each world, in the order of the drones."""
    separation, nearness = np.full(alive.shape, np.inf), np.zeros(alive.shape)
    onsets = np.zeros(alive.shape, dtype=int)
    for w, i in np.argwhere(alive):
        for j in np.flatnonzero(alive[w]):
            if i == j:
                continue
            gap, later = before[w, j] - before[w, i], after[w, j] - after[w, i]
            start, least = map(math.sqrt, closest_squared_distances(tuple(gap), tuple(later)))
            separation[w, i] = least if least < separation[w, i] else separation[w, i]
            onsets[w, i] += least < D_SAFE <= start
            depth = (ZONE - least) / (ZONE - D_SAFE)
            nearness[w, i] += 0.0 if not depth > 0.0 else min(depth, 1.0)
    return separation, onsets, nearness


@pytest.mark.parametrize("shape", [(1, 1), (5, 2), (3, 3), (4, 8), (2, 9), (1, 19)])
def test_separations_have_the_bits_of_pairs_one_by_one(shape):
    rng = np.random.default_rng(shape[1])
    before = rng.uniform(-1.0, 1.0, (*shape, 3))
    after = before + rng.normal(0.0, 0.5, before.shape)
    after[:, ::2] = before[:, ::2]  # pairs that stand still
    for alive in (np.ones(shape, dtype=bool), rng.random(shape) < 0.7):
        for got, expected in zip(
            measure_conflict(before, after, alive, D_SAFE, ZONE),
            pair_by_pair(before, after, alive),
            strict=True,
        ):
            np.testing.assert_array_equal(got, expected)


def all_pairs(before, after, alive, d_safe, zone):
    """Return the same as `pair_by_pair` for one world, computed for all pairs together."""
    gap, later = (each[None, :] - each[:, None] for each in (before, after))
    change = later - gap

    def dot(a, b):
        return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]

    along, square, start = dot(gap, change), dot(change, change), dot(gap, gap)
    with np.errstate(all="ignore"):
        time = np.minimum(1.0, -along / square)
    vertex = np.maximum(0.0, start + 2.0 * time * along + time * time * square)
    least = np.sqrt(np.where(along < 0.0, vertex, start))
    least[~alive] = least[:, ~alive] = np.inf
    np.fill_diagonal(least, np.inf)
    depth = np.clip((zone - least) / (zone - d_safe), 0.0, 1.0)
    onsets = ((least < d_safe) & (d_safe <= np.sqrt(start))).sum(axis=1)
    return least.min(axis=1), onsets, np.cumsum(depth, axis=1)[:, -1]


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("count", [127, 128, 200, 300, 1500])
def test_many_drones_have_the_bits_of_all_pairs(kind, count):
    rng = np.random.default_rng(count)
    before = place_points(rng, kind, count)
    for speed in (0.0, 0.1, 10.0):
        after = before + rng.normal(0.0, speed, before.shape)
        alive = rng.random(count) < 0.9
        found = measure_conflict(before[None], after[None], alive[None], D_SAFE, ZONE)
        for got, expected in zip(found, all_pairs(before, after, alive, D_SAFE, ZONE), strict=True):
            np.testing.assert_array_equal(got[0], expected)


def test_a_drone_that_is_nowhere_is_near_to_nobody():
    before = np.arange(9.0).reshape(1, 3, 3) / 9
    before[0, 1] = math.nan
    after, alive = before.copy(), np.ones((1, 3), dtype=bool)
    found = measure_conflict(before, after, alive, D_SAFE, ZONE)
    apart = 2 / 3 * math.sqrt(3)
    np.testing.assert_allclose(found.separation[0, [0, 2]], apart)
    assert found.separation[0, 1] == math.inf
    assert not found.nearness.any()


@pytest.mark.parametrize("gap", [ZONE * (1 - 1e-9), ZONE, ZONE * (1 + 1e-9)])
def test_nearness_begins_at_the_edge_of_the_zone(gap):
    before, alive = np.zeros((1, 2, 3)), np.ones((1, 2), dtype=bool)
    before[0, 1, 2] = gap
    found = measure_conflict(before, before, alive, D_SAFE, ZONE)
    assert found.nearness.tolist() == [[max(0.0, (ZONE - gap) / (ZONE - D_SAFE))] * 2]
    assert found.separation.tolist() == [[gap] * 2]
    assert not found.onsets.any()


def test_separations_follow_their_drones():
    rng = np.random.default_rng(7)
    before = rng.uniform(-1.0, 1.0, (1, 11, 3))
    after, alive = before + rng.normal(0.0, 0.5, before.shape), rng.random((1, 11)) < 0.8
    order = rng.permutation(11)
    one = measure_conflict(before, after, alive, D_SAFE, ZONE)
    other = measure_conflict(before[:, order], after[:, order], alive[:, order], D_SAFE, ZONE)
    np.testing.assert_array_equal(other.separation, one.separation[:, order])
    np.testing.assert_array_equal(other.onsets, one.onsets[:, order])
    np.testing.assert_allclose(other.nearness, one.nearness[:, order], rtol=1e-14)
