"""Measures of flocks, against numbers by hand."""

import math

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from bulletuav.tasks.parts import flocks

ALL = np.ones((1, 4), dtype=bool)
FOUR = np.array([[(3.0, 0, 0), (0, 5.0, 0), (2.0, 0, 0), (0.1, 0, 0)]])
"""Velocities east, north, east, and too slow to have a direction"""
LINE = np.array([[(0.0, 0, 9), (10.0, 0, 9), (20.0, 0, 9), (50.0, 0, 9)]])
"""Positions 10, 10 and 30 m apart"""


def directions(velocity=FOUR, counts=ALL, min_speed=1.0):
    return flocks.measure_directions(velocity, counts, min_speed)


def test_directions_are_unit_vectors_of_drones_that_move():
    expected = [(1, 0, 0), (0, 1, 0), (1, 0, 0), (0, 0, 0)]
    assert directions()[0].tolist() == [list(map(float, one)) for one in expected]
    # A drone at rest has none at any minimum speed
    still = directions(np.zeros((1, 4, 3)), min_speed=0.0)
    assert not still.any()


def test_order_is_the_norm_of_the_mean_direction():
    # |(2, 1, 0)| / 4
    assert flocks.measure_order(directions(), ALL)[0] == pytest.approx(math.sqrt(5) / 4)
    three = np.array([[True, True, True, False]])
    order = flocks.measure_order(directions(counts=three), three)
    assert order[0] == pytest.approx(math.sqrt(5) / 3)
    opposite = np.array([[(1.0, 0, 0), (-1.0, 0, 0), (0, 0, 1.0), (0, 0, -1.0)]])
    assert flocks.measure_order(directions(opposite, min_speed=0.5), ALL)[0] == 0
    assert flocks.measure_order(directions(), ~ALL)[0] == 0


def test_order_does_not_depend_on_speeds_or_a_common_rotation():
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(5, 30, 3))
    counts = np.ones((5, 30), dtype=bool)
    order = flocks.measure_order(flocks.measure_directions(velocity, counts, 0.0), counts)
    turned = velocity[..., [1, 2, 0]] * rng.uniform(0.5, 2.0, (5, 30, 1))
    again = flocks.measure_order(flocks.measure_directions(turned, counts, 0.0), counts)
    np.testing.assert_allclose(order, again, atol=1e-12)


@pytest.mark.parametrize(
    ("reach", "group", "connectivity"),
    [(9.9, [0, 1, 2, 3], 0), (10.0, [0, 0, 0, 3], 2 / 3), (30.0, [0, 0, 0, 0], 1)],
)
def test_groups_are_chains_of_links(reach, group, connectivity):
    found = flocks.find_groups(LINE, ALL, reach)
    assert found[0].tolist() == group
    # rank(L) / (n - 1) of the graph of links
    distance = np.abs(LINE[0, :, None, 0] - LINE[0, None, :, 0])
    links = (distance <= reach) & ~np.eye(4, dtype=bool)
    laplacian = np.diag(links.sum(axis=1)) - links
    assert np.linalg.matrix_rank(laplacian) / 3 == pytest.approx(connectivity)
    assert flocks.measure_connectivity(found)[0] == pytest.approx(connectivity)


def test_drones_that_are_not_counted_link_none():
    counts = np.array([[True, False, True, True]])
    found = flocks.find_groups(LINE, counts, 10.0)
    assert found[0].tolist() == [0, flocks.NO_GROUP, 2, 3]
    assert flocks.measure_group_size(found)[0].tolist() == [1, 0, 1, 1]


def test_groups_agree_with_scipy():
    rng = np.random.default_rng(1)
    position = rng.uniform(0, 100, (6, 60, 3))
    found = flocks.find_groups(position, np.ones((6, 60), dtype=bool), 18.0)
    sizes = flocks.measure_group_size(found)
    for w, places in enumerate(position):
        count, label = connected_components(cdist(places, places) <= 18.0)
        assert len(np.unique(found[w])) == count > 1
        assert sizes[w].tolist() == np.bincount(label)[label].tolist()


@pytest.mark.parametrize("reach", [4.0, 9.0, 40.0])
def test_groups_of_large_swarms_are_those_of_all_pairs(reach):
    rng = np.random.default_rng(2)
    position = rng.uniform(0, 60, (2, 300, 3))
    counts = rng.random((2, 300)) < 0.9
    found = flocks.find_groups(position, counts, reach)
    for w in range(2):
        counted = np.flatnonzero(counts[w])
        near = cdist(position[w, counted], position[w, counted]) <= reach
        _, group = connected_components(near)
        first = [counted[np.flatnonzero(group == own)[0]] for own in group]
        np.testing.assert_array_equal(found[w, counted], first)
    assert (found[~counts] == flocks.NO_GROUP).all()


def test_connectivity_of_one_drone_and_none():
    one = np.array([[True, False, False, False], [False] * 4])
    found = flocks.find_groups(np.concatenate([LINE, LINE]), one, 10.0)
    assert flocks.measure_connectivity(found).tolist() == [1, 0]


def test_correlation_is_the_mean_cosine_with_others_in_the_group():
    group = flocks.find_groups(LINE, ALL, 10.0)
    # East with north and east: 1/2; north with east twice: 0; the last drone is alone
    assert flocks.measure_correlation(directions(), group)[0].tolist() == [0.5, 0, 0.5, 0]
    # With the slow drone in the group: 1/3
    group = flocks.find_groups(LINE, ALL, 30.0)
    expected = [1 / 3, 0, 1 / 3, 0]
    np.testing.assert_allclose(flocks.measure_correlation(directions(), group)[0], expected)
    opposite = np.array([[(1.0, 0, 0), (-1.0, 0, 0), (1.0, 0, 0), (-1.0, 0, 0)]])
    correlation = flocks.measure_correlation(directions(opposite, min_speed=0.5), group)
    np.testing.assert_allclose(correlation[0], -1 / 3)


def test_variance_of_velocities_and_mean_speed():
    # Means 1.275 and 1.25 m/s of the components
    expected = (3**2 + 5**2 + 2**2 + 0.1**2) / 4 - 1.275**2 - 1.25**2
    assert flocks.measure_velocity_variance(FOUR, ALL)[0] == pytest.approx(expected)
    assert flocks.measure_mean_speed(FOUR, ALL)[0] == pytest.approx(10.1 / 4)
    two = np.array([[True, False, True, False]])
    assert flocks.measure_velocity_variance(FOUR, two)[0] == pytest.approx(0.25)
    assert flocks.measure_mean_speed(FOUR, two)[0] == 2.5


def test_cohesion_radius_is_the_largest_distance_from_the_centre():
    # Centre at 20 m
    assert flocks.measure_cohesion_radius(LINE, ALL)[0] == 30
    three = np.array([[True, True, True, False]])
    assert flocks.measure_cohesion_radius(LINE, three)[0] == 10
    assert flocks.measure_cohesion_radius(LINE, ~ALL)[0] == 0


@pytest.mark.parametrize(("distance", "share"), [(10.0, 0), (10.1, 2 / 6), (20.1, 3 / 6)])
def test_close_pairs_are_a_fraction_of_all_pairs(distance, share):
    assert flocks.measure_close_pairs(LINE, ALL, distance)[0] == pytest.approx(share)


def test_close_pairs_of_less_than_two_drones():
    assert flocks.measure_close_pairs(LINE, ~ALL, 10.0)[0] == 0
