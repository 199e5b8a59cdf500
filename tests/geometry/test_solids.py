"""Convex pieces: their surfaces, their groups, and the grid by which compiled code finds them."""

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from bulletuav.city.generator import generate
from bulletuav.geometry.city_grid import GRID_CELL, NO_LAYOUT, make_city_grid, overlaps_piece
from bulletuav.geometry.solids import Solids, box_corners, group_separated

CUBE = np.array([(0.0, 0, 0), (1, 1, 1)])
CORNER = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])  # a tetrahedron of 1/6 m^3
NO_BOXES = np.zeros((0, 2, 3))


def volume(vertices, triangles):
    """Volume within a closed surface whose triangles turn left; negative where they turn right."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return (a * np.cross(b, c)).sum() / 6


def closed(triangles):
    """Whether each edge has one triangle on either side."""
    edges = [
        (a, b)
        for face in triangles.tolist()
        for a, b in zip(face, face[1:] + face[:1], strict=True)
    ]
    return len(set(edges)) == len(edges) and all((b, a) in set(edges) for a, b in edges)


def random_boxes(rng, count, spread, most):
    middle, half = rng.uniform(-spread, spread, (count, 3)), rng.uniform(0.1, most / 2, (count, 3))
    return np.stack([middle - half, middle + half], axis=1)


# Surfaces


def test_a_box_has_its_corners_and_its_volume():
    box = np.array([(-1.0, 2, 0), (3, 4, 5)])
    corners = box_corners(box)
    assert {tuple(corner) for corner in corners} == set(itertools.product((-1, 3), (2, 4), (0, 5)))
    vertices, triangles = Solids(box[None]).mesh
    assert volume(vertices, triangles) == pytest.approx(4 * 2 * 5)
    assert closed(triangles)


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_a_tetrahedron_turns_outward_in_any_order_of_its_corners(order):
    vertices, triangles = Solids(NO_BOXES, (CORNER[list(order)],)).mesh
    assert volume(vertices, triangles) == pytest.approx(1 / 6)
    assert closed(triangles)


@pytest.mark.parametrize("seed", range(20))
def test_the_surface_of_a_hull_is_closed_outward_and_of_its_volume(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 3)) * (3, 1, 0.2) + rng.uniform(
        -100, 100, 3
    )  # most of them inside the others
    ((vertices, triangles),) = Solids(NO_BOXES, (points,)).faces
    assert volume(vertices, triangles) == pytest.approx(ConvexHull(points).volume)
    assert closed(triangles)


def test_the_mesh_is_all_surfaces_boxes_first():
    solids = Solids(np.array([CUBE, 2 * CUBE + 5]), (CORNER - 10, CORNER + 20))
    vertices, triangles = solids.mesh
    assert volume(vertices, triangles) == pytest.approx(1 + 8 + 2 / 6)
    assert closed(triangles)
    assert len(triangles) == 12 + 12 + 4 + 4
    np.testing.assert_array_equal(vertices[:8], box_corners(CUBE))
    np.testing.assert_array_equal(
        solids.bounds[[1, 2]], [[(5, 5, 5), (7, 7, 7)], [(-10, -10, -10), (-9, -9, -9)]]
    )


def test_nothing_has_an_empty_mesh():
    vertices, triangles = Solids(NO_BOXES).mesh
    assert vertices.shape == triangles.shape == (0, 3)
    assert Solids(NO_BOXES).bounds.shape == (0, 2, 3)


@pytest.mark.parametrize(
    "flat",
    [CORNER * (1, 1, 0), CORNER[:3], CORNER * (1, 0, 0), np.ones((6, 3))],
    ids=["plane", "triangle", "line", "point"],
)
def test_a_piece_without_volume_is_refused(flat):
    with pytest.raises(ValueError, match=r"corners \[\[.* m spans no volume"):
        _ = Solids(NO_BOXES, (flat,)).faces


# Groups


def gap(one, two):
    """Least distance along some axis of two boxes (2, 3), by hand."""
    return max(max(one[0, k] - two[1, k], two[0, k] - one[1, k]) for k in range(3))


@pytest.mark.parametrize("apart", [0.0, 1.54, 20.0])
def test_members_of_a_group_keep_their_distance(apart):
    bounds = random_boxes(np.random.default_rng(1), 120, 30, 12)
    groups = group_separated(bounds, apart)
    assert sorted(p for group in groups for p in group) == list(range(120))
    for group in groups:
        assert all(gap(bounds[a], bounds[b]) >= apart for a, b in itertools.combinations(group, 2))
    assert len(groups) > 1  # otherwise nothing was tested


@pytest.mark.parametrize(("apart", "count"), [(1.54, 1), (20.2, 1), (20.3, 4)])
def test_a_regular_city_needs_one_group_and_four_where_streets_are_too_narrow(apart, count):
    """`urban`: blocks of 44.7214 m with streets of 20.2265 m."""
    city = generate("urban", 447.2136, np.random.default_rng(0))
    assert len(city.solids.boxes) == 100
    assert len(group_separated(city.solids.bounds, apart)) == count


def test_blocks_that_touch_all_around_need_four():
    low = np.array([(i, j, 0) for i in range(8) for j in range(8)], dtype=float)
    groups = group_separated(np.stack([low, low + 1], axis=1), 0.5)
    assert [len(group) for group in groups] == [16] * 4


def test_boxes_that_touch_or_overlap_are_in_different_groups():
    for shift in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (0.5, 0.5, 0.5)):
        assert len(group_separated(np.array([CUBE, CUBE + shift]), 1e-9)) == 2


def test_exactly_that_distance_is_enough():
    assert len(group_separated(np.array([CUBE, CUBE + (1.5, 0, 0)]), 0.5)) == 1
    assert len(group_separated(np.array([CUBE, CUBE + (1.499, 0, 0)]), 0.5)) == 2


def test_groups_are_the_same_for_the_same_pieces():
    bounds = random_boxes(np.random.default_rng(2), 80, 20, 12)
    for one, two in zip(
        group_separated(bounds, 1.0), group_separated(bounds.copy(), 1.0), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_no_pieces_are_no_groups():
    assert group_separated(NO_BOXES, 1.0) == []


# The atlas


def overlaps(bounds, low, high):
    """`overlaps_piece`, asked of each piece."""
    return any((piece[0] <= high).all() and (piece[1] >= low).all() for piece in bounds)


@pytest.mark.parametrize("spread", [20.0, 100.0, 300.0])
def test_the_grid_finds_what_asking_every_piece_finds(spread):
    rng = np.random.default_rng(3)
    hulls = tuple(
        spread * (rng.normal(size=(10, 3)) / 10 + rng.uniform(-1, 1, 3)) for _ in range(5)
    )
    layouts = (
        Solids(random_boxes(rng, 40, spread, spread / 2)),
        Solids(random_boxes(rng, 5, spread, spread), hulls),
    )
    city_grid = make_city_grid(layouts, 3)
    city_grid.layout[:] = 1, NO_LAYOUT, 0
    found = 0
    for low, high in random_boxes(
        rng, 2000, 1.3 * spread, spread / 5
    ):  # some reach over the grid's edge, some lie beyond
        expected = [overlaps(layouts[k].bounds, low, high) for k in (1, 0)]
        assert [overlaps_piece(city_grid, w, tuple(low), tuple(high)) for w in range(3)] == [
            expected[0],
            False,
            expected[1],
        ]
        found += sum(expected)
    assert 150 < found < 3500


def test_columns_reach_from_the_ground_to_the_sky():
    city_grid = make_city_grid((Solids(np.array([[(10.0, 20, 30), (12, 24, 31)]])),), 1)
    city_grid.layout[:] = 0
    inf = np.inf
    assert overlaps_piece(city_grid, 0, (11.0, 22.0, -inf), (11.0, 22.0, inf))
    assert overlaps_piece(city_grid, 0, (10.0, 20.0, -inf), (10.0, 20.0, inf))  # a touch counts
    assert not overlaps_piece(city_grid, 0, (9.999, 22.0, -inf), (9.999, 22.0, inf))
    assert not overlaps_piece(city_grid, 0, (11.0, 22.0, -inf), (11.0, 22.0, 29.999))
    assert not overlaps_piece(city_grid, 0, (11.0, 22.0, 31.001), (11.0, 22.0, inf))


def test_pieces_at_the_grids_edge_are_found_and_beyond_it_is_nothing():
    reach = 4 * GRID_CELL
    edge = np.array(
        [[(reach - 1, -1.0, 0), (reach, 1, 5)], [(-reach, -reach, 0), (-reach + 1, -reach + 1, 5)]]
    )
    city_grid = make_city_grid((Solids(edge),), 1)
    city_grid.layout[:] = 0
    assert (city_grid.half_side, city_grid.cells) == (reach, 8)
    assert overlaps_piece(city_grid, 0, (reach - 0.5, 0.0, 1.0), (reach + 0.5, 0.0, 1.0))
    assert overlaps_piece(city_grid, 0, (-reach - 9, -reach - 9, 1.0), (-reach, -reach, 1.0))
    assert overlaps_piece(city_grid, 0, (-1e6, -1e6, -1e6), (1e6, 1e6, 1e6))
    for x, y in (
        (reach + 0.1, 0.0),
        (1e6, 0.0),
        (0.0, 1e6),
        (-reach - 0.1, -reach),
        (-reach, -reach - 0.1),
    ):
        assert not overlaps_piece(city_grid, 0, (x, y, 1.0), (x, y, 1.0))


def test_an_atlas_of_nothing_meets_nothing():
    for layouts in ((), (Solids(NO_BOXES),)):
        city_grid = make_city_grid(layouts, 2)
        assert not overlaps_piece(city_grid, 1, (-1e3, -1e3, -1e3), (1e3, 1e3, 1e3))
        if layouts:
            city_grid.layout[:] = 0
            assert not overlaps_piece(city_grid, 1, (-1e3, -1e3, -1e3), (1e3, 1e3, 1e3))
