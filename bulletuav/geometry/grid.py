"""Spatial grid (cell list) of the points of one world, for searches of near points.

The points are sorted into box-shaped cells of about one point each, so that memory and the time to
fill a grid are linear in the number of points. The grid covers the bulk of the points: points
beyond it belong to its outermost cells, so that a few distant points do not widen the cells. Every
search is exact whatever the size of the cells.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, minus, point, vec3

MIN_POINTS = 200
"""Number of points of a world from which on grids are faster than loops over all points"""
POINTS_PER_CELL = 1.0
"""Mean number of points in a cell of a uniform distribution"""
BULK = 3.0
"""Half the size of the largest grid along each axis, in standard deviations of the points"""
ROUNDING = 1e-9
"""Bound of the rounding errors of distances, as a fraction of the largest coordinate"""
PATHS = -1.0
"""Horizon of paths that are given by two positions, s"""
WIDENING = 1.6
"""Factor of the radius from one step of an expanding search to the next"""


class Grid(NamedTuple):
    """Points of one world by cell.

    Attributes:
        place: (N, 3) points, m; those that are not in use may have any values.
        box: (2, 3) lower corner of the grid, m, and number of cells per metre along each axis.
        sizes: (3,) edge of a cell, bound of rounding errors, and maximum of `reach`, m.
        cells: (3,) number of cells along each axis.
        first: (N + 2,) first entry of each cell in `item`, and the end of the last cell.
        item: (N,) indices of the points in use by cell, ascending in each cell.
        reach: (N,) distance around each point within which its search may find others, m; for users
            of the grid.
    """

    place: np.ndarray
    box: np.ndarray
    sizes: np.ndarray
    cells: np.ndarray
    first: np.ndarray
    item: np.ndarray
    reach: np.ndarray


class CellBox(NamedTuple):
    """Box of cells, given by the first cell along each axis and one past the last.

    Attributes:
        left: First along x.
        right: End along x.
        front: First along y.
        back: End along y.
        bottom: First along z.
        top: End along z.
    """

    left: int
    right: int
    front: int
    back: int
    bottom: int
    top: int


@allocating
def make_point_grid(num_points: int) -> Grid:
    """Allocate a grid of N points, without any points."""
    return Grid(
        place=np.empty((num_points, 3)),
        box=np.empty((2, 3)),
        sizes=np.zeros(3),
        cells=np.zeros(3, dtype=np.int64),
        first=np.zeros(num_points + 2, dtype=np.int64),
        item=np.empty(num_points, dtype=np.int64),
        reach=np.zeros(num_points),
    )


new_point_grid: Callable[[int], Grid] = make_point_grid.py_func  # type: ignore[attr-defined]
"""`make_point_grid` without compilation"""


@kernel
def fill_grid(
    grid: Grid, used: np.ndarray, w: int, points_per_cell: float = POINTS_PER_CELL
) -> bool:
    """Sort the points into cells.

    Args:
        grid: Grid with its `place` written; all other arrays but `reach` are written.
        used: (W, N) bool, points in use.
        w: Index of the world in `used`.
        points_per_cell: Mean number of points in a cell.

    Returns:
        False if a point in use is not finite; there is no grid then.
    """
    place = grid.place
    count = 0
    for i in range(place.shape[0]):
        if used[w, i]:
            count += 1
            for k in range(3):
                if not math.isfinite(place[i, k]):
                    return False
    size = _set_box(grid, used, w, count)
    _set_cells(grid, size, max(count / points_per_cell, 1.0), place.shape[0] + 1)
    # Counting sort: count the points of each cell, sum up, and list the points from the last one on
    num_cells = grid.cells[0] * grid.cells[1] * grid.cells[2]
    for cell in range(num_cells + 1):
        grid.first[cell] = 0
    for i in range(place.shape[0]):
        if used[w, i]:
            grid.first[_cell_of(grid, i)] += 1
    for cell in range(num_cells):
        grid.first[cell + 1] += grid.first[cell]
    for back in range(place.shape[0]):
        i = place.shape[0] - 1 - back
        if used[w, i]:
            cell = _cell_of(grid, i)
            grid.first[cell] -= 1
            grid.item[grid.first[cell]] = i
    return True


@func
def _set_box(grid: Grid, used: np.ndarray, w: int, count: int) -> Vec3:
    """Write the lower corner of the grid and the bound of rounding errors; return its size, m."""
    place = grid.place
    reach = 0.0
    size = (0.0, 0.0, 0.0)
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in range(place.shape[0]):
            if used[w, i]:
                low = min(low, place[i, k])
                high = max(high, place[i, k])
        if count == 0:
            low = high = 0.0
        reach = max(reach, abs(low), abs(high))
        # Shrink to the bulk of the points, again as long as distant points dominate the deviation
        shrinks = high > low
        while shrinks:
            total, square = 0.0, 0.0
            for i in range(place.shape[0]):
                if used[w, i]:
                    x = min(max(place[i, k], low), high) - low
                    total += x
                    square += x * x
            mean = low + total / count
            far = BULK * math.sqrt(max(square / count - (total / count) ** 2, 0.0))
            width = high - low
            low = max(low, mean - far)
            high = min(high, mean + far)
            shrinks = 0.0 < high - low < 0.5 * width
        grid.box[0, k] = low
        width = max(high - low, 0.0)
        size = (
            width if k == 0 else size[0],
            width if k == 1 else size[1],
            width if k == 2 else size[2],
        )
    grid.sizes[1] = ROUNDING * (1.0 + reach)
    return size


@func
def _set_cells(grid: Grid, size: Vec3, wanted: float, most: int) -> None:
    """Divide the grid into at most `most` cells, about as many as wanted, cubes where possible."""
    # An axis along which the points extend less than a cell has one cell only
    edge = 0.0
    for _ in range(3):
        volume, axes = 1.0, 0
        for k in range(3):
            if size[k] > edge:
                volume *= size[k]
                axes += 1
        if axes > 0:
            edge = max(edge, (volume / wanted) ** (1.0 / axes))
    total = 1
    for k in range(3):
        cells = 1
        if 0.0 < edge < size[k]:
            cells = int(min(size[k] / edge, float(most // total)))
        cells = max(cells, 1)
        total *= cells
        grid.cells[k] = cells
        # Cells of an axis with one cell have no bounds
        grid.box[1, k] = cells / size[k] if cells > 1 else 0.0
    grid.sizes[0] = edge


@func
def _index(grid: Grid, k: int, x: float) -> int:
    """Return the index along axis k of the cell with a coordinate; non-decreasing in it."""
    at = (x - grid.box[0, k]) * grid.box[1, k]
    # Compared before the conversion, which fails for large numbers; an axis with one cell is 0
    last = float(grid.cells[k] - 1)
    return int(min(max(at, 0.0), last))


@func
def _cell_of(grid: Grid, i: int) -> int:
    """Return the cell of point i."""
    x, y, z = point(grid.place, i)
    row = _index(grid, 2, z) * grid.cells[1] + _index(grid, 1, y)
    cell: int = row * grid.cells[0] + _index(grid, 0, x)
    return cell


@func
def cells_around(grid: Grid, here: Vec3, radius: float) -> CellBox:
    """Return the cells of all points within a finite radius of a finite position, along each axis.

    Args:
        grid: The grid, filled.
        here: The position, m.
        radius: The radius, m.
    """
    return CellBox(
        _index(grid, 0, here[0] - radius),
        _index(grid, 0, here[0] + radius) + 1,
        _index(grid, 1, here[1] - radius),
        _index(grid, 1, here[1] + radius) + 1,
        _index(grid, 2, here[2] - radius),
        _index(grid, 2, here[2] + radius) + 1,
    )


@func
def is_grid_filled(grid: Grid) -> bool:
    """Return True if a grid has been filled since it was allocated or cleared."""
    return bool(grid.cells[0] > 0)


@func
def clear_grid(grid: Grid) -> None:
    """Mark a grid as not filled."""
    grid.cells[0] = 0


@func
def is_whole(grid: Grid, box: CellBox) -> bool:
    """Return True if a box contains all cells of the grid."""
    whole: bool = box.right - box.left == grid.cells[0]
    whole = whole and box.back - box.front == grid.cells[1]
    return whole and box.top - box.bottom == grid.cells[2]


@func
def num_rows(box: CellBox) -> int:
    """Return the number of rows of cells along x in a box."""
    return (box.back - box.front) * (box.top - box.bottom)


@func
def row_items(grid: Grid, box: CellBox, row: int) -> tuple[int, int]:
    """Return the range of `Grid.item` with the points of a row of a box."""
    depth = box.back - box.front
    line = (box.bottom + row // depth) * grid.cells[1] + box.front + row % depth
    cell = line * grid.cells[0]
    return grid.first[cell + box.left], grid.first[cell + box.right]


@func
def fill_path_grid(
    grid: Grid,
    begin: np.ndarray,
    end: np.ndarray,
    horizon: float,
    used: np.ndarray,
    w: int,
) -> bool:
    """Sort straight paths into cells by their midpoints.

    While all points move, two of them are at most their reaches closer than their midpoints. The
    reach of a path is half of its length, with a bound of rounding errors.

    Args:
        grid: The grid, written.
        begin: (W, N, 3) positions at the start, m.
        end: (W, N, 3) positions at the end, m; velocities, m/s, with a horizon.
        horizon: Duration of the motion, s, or `PATHS`.
        used: (W, N) bool, points in use.
        w: Index of the world.

    Returns:
        False if a point in use is not finite; there is no grid then.
    """
    reach = grid.reach
    for i in range(grid.place.shape[0]):
        half = _half_path(begin, end, horizon, w, i)
        start = vec3(begin, w, i)
        for k in range(3):
            grid.place[i, k] = start[k] + half[k]
        reach[i] = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    if not fill_grid(grid, used, w):
        return False
    most = 0.0
    for i in range(grid.place.shape[0]):
        reach[i] += grid.sizes[1] + ROUNDING * reach[i]
        if used[w, i]:
            most = max(most, reach[i])
    grid.sizes[2] = most
    return True


@func
def _half_path(begin: np.ndarray, end: np.ndarray, horizon: float, w: int, i: int) -> Vec3:
    """Return half the displacement of a point."""
    if horizon < 0.0:
        moved = minus(vec3(end, w, i), vec3(begin, w, i))
        return 0.5 * moved[0], 0.5 * moved[1], 0.5 * moved[2]
    half = 0.5 * horizon
    return half * end[w, i, 0], half * end[w, i, 1], half * end[w, i, 2]


@func
def sort_ascending(items: np.ndarray, count: int) -> None:
    """Sort the first `count` of different whole numbers in place (Shell sort)."""
    gap = count // 2
    while gap > 0:
        for last in range(gap, count):
            item = items[last]
            k = last
            while k >= gap and items[k - gap] > item:
                items[k] = items[k - gap]
                k -= gap
            items[k] = item
        gap = gap // 2


@func
def sort_by_key(keys: np.ndarray, items: np.ndarray, count: int) -> None:
    """Sort the first `count` different items, and their keys, by key and then by item, in place."""
    gap = count // 2
    while gap > 0:
        for last in range(gap, count):
            key, item = keys[last], items[last]
            k = last
            while k >= gap and (
                keys[k - gap] > key or (keys[k - gap] == key and items[k - gap] > item)
            ):
                keys[k], items[k] = keys[k - gap], items[k - gap]
                k -= gap
            keys[k], items[k] = key, item
        gap = gap // 2
