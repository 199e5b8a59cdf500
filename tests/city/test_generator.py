import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from bulletuav.city.generator import generate
from bulletuav.city.statistics import KINDS, Statistics, realised

DERIVED = {  # width, street, pitch, sqrt(alpha beta), mean height
    "suburban": (11.5470, 24.9678, 36.5148, 8.66025, 10.0265),
    "urban": (24.4949, 20.2265, 44.7214, 12.24745, 18.7997),
    "dense": (40.8248, 16.9102, 57.7350, 12.24745, 25.0663),
    "high_rise": (40.8248, 16.9102, 57.7350, 12.24745, 62.6657),
}


def city(kind="urban", side=500.0, seed=0, irregularity=0.0):
    return generate(kind, side, np.random.default_rng(seed), irregularity)


def overlapping(made):
    """Pairs of pieces of different buildings that share more than rounding."""
    low, high = made.solids.boxes[:, 0, :2], made.solids.boxes[:, 1, :2]
    both = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    return (both > 1e-9).all(axis=-1) & (made.building[:, None] != made.building)


def along(streets, share):
    """Points at these shares (K,) of each edge: (K, E, 2)."""
    start, end = streets.nodes[streets.edges].swapaxes(0, 1)
    return start + np.asarray(share)[:, None, None] * (end - start)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_that_follow_from_the_statistics(kind):
    one = KINDS[kind]
    found = (one.width, one.street, one.pitch, math.sqrt(one.alpha * one.beta), one.mean_height)
    assert found == pytest.approx(DERIVED[kind], abs=6e-5)


@pytest.mark.parametrize("irregularity", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_city_has_its_statistics(kind, irregularity):
    target, made = KINDS[kind], city(kind, 2000.0, 1, irregularity)
    found = realised(made, target)
    assert found["built-up share"] == (pytest.approx(target.alpha, rel=1e-12), target.alpha)
    assert found["buildings per km2"][0] == pytest.approx(target.beta, rel=0.03)
    assert found["mean height, m"][0] == pytest.approx(target.mean_height, rel=0.05)
    assert found["Rayleigh scale of heights, m"][0] == pytest.approx(target.gamma, rel=0.05)
    assert stats.kstest(made.heights, stats.rayleigh(scale=target.gamma).cdf).pvalue > 0.01
    if irregularity == 0:
        assert found["width of streets, m"][0] == pytest.approx(target.street, rel=0.02)


def test_a_regular_city_is_a_grid_of_equal_blocks():
    made = city()
    low, high = made.solids.boxes.swapaxes(0, 1)
    assert (
        made.heights.shape == made.building.shape == (121,)
    )  # 11 x 11 blocks of 45.45 m are nearest to 44.72 m
    assert np.ptp(high[:, :2] - low[:, :2]) < 1e-9
    np.testing.assert_allclose(
        np.unique(np.round((low + high)[:, 0] / 2, 6)), (np.arange(11) - 5) * 500 / 11, atol=1e-6
    )
    assert not low[:, 2].any()
    assert (made.heights == high[:, 2]).all()
    np.testing.assert_allclose(
        made.clearance(along(made.streets, [0.5]), 500), (1 - math.sqrt(0.3)) * 500 / 11 / 2
    )


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_the_seed_decides(irregularity):
    one, same, other = (city(seed=seed, irregularity=irregularity) for seed in (3, 3, 4))
    for field in ("boxes", "bounds"):
        assert np.array_equal(getattr(one.solids, field), getattr(same.solids, field))
    assert np.array_equal(one.building, same.building)
    assert np.array_equal(one.streets.nodes, same.streets.nodes)
    assert np.array_equal(one.streets.edges, same.streets.edges)
    assert not np.array_equal(one.heights, other.heights)
    assert (irregularity == 0) == np.array_equal(
        one.solids.boxes[:9, :, :2], other.solids.boxes[:9, :, :2]
    )


@settings(max_examples=60)
@given(
    st.floats(0.01, 0.97),
    st.floats(2, 14),
    st.one_of(st.just(0.0), st.just(1.0), st.floats(0, 1)),
    st.integers(0, 2**32),
)
def test_any_irregular_city_is_built_as_dense_with_passable_streets(
    alpha, blocks, irregularity, seed
):
    target = Statistics(alpha, 400, 10)
    made = generate(target, blocks * target.pitch, np.random.default_rng(seed), irregularity)
    low, high = made.solids.boxes.swapaxes(0, 1)
    assert made.coverage == pytest.approx(alpha, rel=1e-9)
    assert (high > low).all()
    assert np.abs(made.solids.boxes[..., :2]).max() < made.side / 2
    assert not overlapping(made).any()
    block = made.streets.nodes[:, 0]
    pitch = np.diff(np.unique(block)).max()
    least = (1 - irregularity / 2) * pitch * (1 - math.sqrt(alpha))
    assert (made.clearance(along(made.streets, np.linspace(0, 1, 9)), pitch) > 0.499 * least).all()


def test_an_irregular_city_has_all_that_is_promised():
    made = city(side=1000.0, irregularity=1.0)
    pieces = np.bincount(made.building)
    assert set(pieces) == {1, 2}
    assert 0.35 < (pieces == 2).mean() < 0.55
    tops = made.solids.boxes[:, 1, 2]
    assert (tops == made.heights[made.building]).all()
    second = np.flatnonzero(np.arange(len(tops)) >= len(pieces))
    one, two = made.solids.boxes[made.building[second]], made.solids.boxes[second]
    assert (
        (one[:, 0, 1] == two[:, 1, 1]) | (one[:, 1, 1] == two[:, 0, 1])
    ).all()  # the arms of an L touch
    blocks = (len(np.unique(made.streets.nodes[:, 0])) - 1) ** 2
    assert 0.1 < 1 - len(pieces) / blocks < 0.2  # parks
    shape = np.ptp(made.solids.boxes[: len(pieces), :, :2], axis=1)
    assert 1.5 < (shape.max(axis=1) / shape.min(axis=1)).max() < 4


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_streets_are_a_connected_grid_from_edge_to_edge(irregularity):
    streets = city(irregularity=irregularity).streets
    nodes, edges = streets.nodes, streets.edges
    lines = len(np.unique(nodes[:, 0])) - 2
    assert len(nodes) == lines**2 + 4 * lines
    assert len(edges) == 2 * lines * (lines + 1)
    assert set(np.bincount(edges.ravel())) == {1, 4}  # ends and crossings
    reached = {0}
    for _ in nodes:
        reached |= {int(end) for edge in edges if reached & set(edge) for end in edge}
        if len(reached) == len(nodes):
            break
    assert len(reached) == len(nodes)


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((0.0, 500, 15), "alpha is 0.0: .* between 0 and 1"),
        ((1, 500, 15), "alpha is 1: .* between 0 and 1"),
        ((math.nan, 500, 15), "alpha is nan: a finite number"),
        ((0.3, -5, 15), "beta is -5: a positive number of buildings"),
        ((0.3, "many", 15), "beta is 'many': a finite number"),
        ((0.3, 500, 0), "gamma is 0: a positive number of m"),
        ((0.3, 500, math.inf), "gamma is inf: a finite number"),
    ],
)
def test_statistics_that_cannot_be(numbers, message):
    with pytest.raises(ValueError, match=message):
        Statistics(*numbers)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "sububan"}, "unknown kind of city 'sububan': did you mean 'suburban'"),
        ({"side": 80.0}, "side is 80.0 m: two blocks need at least 89.44 m"),
        ({"side": -500.0}, "side is -500.0 m: two blocks"),
        ({"side": math.nan}, "side is nan: a finite number"),
        ({"irregularity": 1.1}, "irregularity is 1.1: a number from 0"),
        ({"irregularity": None}, "irregularity is None: a finite number"),
    ],
)
def test_cities_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        city(**options)
