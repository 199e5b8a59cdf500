"""Searches of near points on grids, against all points one by one."""

import numpy as np
import pytest
from swarms import PLACES, place_points

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.grid import (
    cells_around,
    fill_grid,
    is_whole,
    make_point_grid,
    num_rows,
    row_items,
    sort_ascending,
    sort_by_key,
)


@kernel
def _mark_near(grid, here, radius, found):
    """Mark the points of the cells around a position; return whether these are all cells."""
    box = cells_around(grid, (here[0], here[1], here[2]), radius)
    for row in range(num_rows(box)):
        begin, end = row_items(grid, box, row)
        for m in range(begin, end):
            found[grid.item[m]] += 1
    return is_whole(grid, box)


@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("points_per_cell", [0.3, 1.0, 7.0, 1e9])
def test_cells_around_a_position_have_each_near_point_once(kind, points_per_cell):
    rng = np.random.default_rng(5)
    for count in (1, 2, 3, 40, 500):
        used = rng.random((2, count)) < 0.8
        grid = make_point_grid(count)
        grid.place[:] = place_points(rng, kind, count)
        grid.place[~used[1]] = np.nan
        assert fill_grid(grid, used, 1, points_per_cell)
        assert grid.cells.prod() <= count + 1
        for here in place_points(rng, kind, count)[:20]:
            for radius in (0.0, 0.5, 5.0, 1e7):
                found = np.zeros(count, dtype=np.int64)
                whole = _mark_near(grid, here, radius, found)
                near = np.linalg.norm(grid.place - here, axis=1) <= radius
                assert found.max() <= 1
                assert (found[near] == 1).all()
                assert not found[~used[1]].any()
                if whole:
                    assert found.sum() == used[1].sum()


def test_distant_points_do_not_widen_the_cells():
    rng = np.random.default_rng(5)
    grid, used = make_point_grid(2000), np.ones((1, 2000), dtype=bool)
    grid.place[:] = place_points(rng, "distant", 2000)
    fill_grid(grid, used, 0)
    assert np.diff(grid.first[: grid.cells.prod() + 1]).max() < 200


def test_points_that_are_not_finite_have_no_grid():
    grid = make_point_grid(3)
    grid.place[:] = 1.0
    grid.place[1, 2] = np.inf
    assert not fill_grid(grid, np.ones((1, 3), dtype=bool), 0)
    assert fill_grid(grid, np.array([[True, False, True]]), 0)


def test_numbers_are_sorted():
    for count in (0, 1, 2, 7, 100):
        items = np.random.default_rng(count).permutation(count + 3)
        expected = [*sorted(items[:count]), *items[count:]]
        sort_ascending(items, count)
        assert items.tolist() == expected


def test_items_are_sorted_by_key_and_then_by_item():
    for count in (0, 1, 2, 50, 300):
        rng = np.random.default_rng(count)
        items, keys = rng.permutation(count + 3), rng.integers(0, 20, count + 3) / 8
        expected = sorted(zip(keys[:count], items[:count], strict=True))
        rest = items[count:].copy()
        sort_by_key(keys, items, count)
        assert list(zip(keys[:count], items[:count], strict=True)) == expected
        np.testing.assert_array_equal(items[count:], rest)
