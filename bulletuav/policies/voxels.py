"""Maps of a known city as cubic cells, free or occupied.

Every point of a segment through free cells is within half a cell of the centre of one, on each
axis; so is one between two free cells that touch in an edge or corner only. It is therefore
farther than `clearance` less half a cell from every solid, and A* may step diagonally between
occupied cells.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3Like, dot

Cell = tuple[int, int, int]
"""Indices of a cell on the axes x, y and z"""


class Voxels(NamedTuple):
    """Map of cubic cells; the outermost ones are always occupied.

    Attributes:
        occupied: (X, Y, Z) bool, which cells are not free.
        origin: (3,) low corner of the first cell, m.
        size: Length of a cell, m.
    """

    occupied: np.ndarray
    origin: np.ndarray
    size: float


def voxels(
    bounds: np.ndarray, low: np.ndarray, high: np.ndarray, size: float, clearance: float
) -> Voxels:
    """Make the map of an arena; cells that are not wholly in it are occupied.

    So are those whose centre is in a box grown by `clearance`, or no higher than `clearance` above
    the ground.

    Args:
        bounds: (P, 2, 3) lower and upper corners of boxes, m.
        low: (3,) lower corner of the arena, m.
        high: (3,) upper corner of the arena, m.
        size: Length of a cell, m.
        clearance: Distance by which each box grows on each side, m.

    Returns:
        The map.
    """
    # Whole cells of the arena, and one more on every side.
    inside = np.maximum(np.floor((high - low) / size), 0).astype(int)
    origin = low - size
    occupied = np.ones(inside + 2, dtype=bool)
    occupied[1:-1, 1:-1, 1:-1] = False
    # The first cell with its centre in each grown box, and the first one beyond it.
    lowest = (bounds[:, 0] - clearance - origin) / size
    highest = (bounds[:, 1] + clearance - origin) / size
    first = np.ceil(lowest - 0.5).clip(0).astype(int)
    end = np.floor(highest + 0.5).clip(0).astype(int)
    for box in range(len(bounds)):
        x, y, z = first[box]
        x_end, y_end, z_end = end[box]
        occupied[x:x_end, y:y_end, z:z_end] = True
    # The ground.
    above = max(0, math.floor((clearance - origin[2]) / size + 0.5))
    occupied[:, :, :above] = True
    return Voxels(occupied, origin, float(size))


@kernel
def nearest_free(grid: Voxels, point: np.ndarray) -> Cell:
    """Find the free cell with its centre nearest to a point; the point's own cell if it is free.

    Args:
        grid: The map, of which one cell must be free.
        point: (3,) the point, m.

    Returns:
        The cell; among equals the one of the lowest indices.
    """
    # Its own cell, or the best of all.
    x, y, z = cell_of(grid, point)
    if _is_free(grid, (x, y, z)):
        return x, y, z
    least = math.inf
    best = (0, 0, 0)
    for x in range(grid.occupied.shape[0]):
        for y in range(grid.occupied.shape[1]):
            for z in range(grid.occupied.shape[2]):
                if not grid.occupied[x, y, z]:
                    # Offsets of the cell's centre from the point
                    gap = (
                        _offset(grid, point, 0, x),
                        _offset(grid, point, 1, y),
                        _offset(grid, point, 2, z),
                    )
                    square = dot(gap, gap)
                    if square < least:
                        least = square
                        best = (x, y, z)
    return best


@func
def _offset(grid: Voxels, point: Vec3Like, axis: int, k: int) -> float:
    """Compute how far the centre of the k-th cell is from a point on one axis, m."""
    gap: float = grid.origin[axis] + grid.size * (k + 0.5) - point[axis]
    return gap


@func
def cell_of(grid: Voxels, point: Vec3Like) -> Cell:
    """Find the cell that holds a point, m; out of range where the point is out of the grid."""
    return (
        _index(grid, point, 0),
        _index(grid, point, 1),
        _index(grid, point, 2),
    )


@func
def _index(grid: Voxels, point: Vec3Like, axis: int) -> int:
    """Find the index of the cell that holds a point, on one axis."""
    index: int = math.floor((point[axis] - grid.origin[axis]) / grid.size)
    return index


@func
def _is_free(grid: Voxels, cell: Cell) -> bool:
    """Tell whether a cell is within the grid and free."""
    for axis in range(3):
        if not 0 <= cell[axis] < grid.occupied.shape[axis]:
            return False
    return not grid.occupied[cell[0], cell[1], cell[2]]


@kernel
def is_clear(grid: Voxels, start: np.ndarray, end: np.ndarray) -> bool:
    """Tell whether the segment between two points is in free cells only.

    J. Amanatides, A. Woo, A fast voxel traversal algorithm for ray tracing (1987).

    Args:
        grid: The map.
        start: (3,) one end, m.
        end: (3,) the other end, m.
    """
    # Both ends must be free before the way between them matters
    cell = cell_of(grid, start)
    last = cell_of(grid, end)
    if not _is_free(grid, cell):
        return False
    if not _is_free(grid, last):
        return False
    while cell != last:
        # Step to the next cell through the face that the segment crosses first.
        x = _crossing(grid, start, end, cell, last, 0)
        y = _crossing(grid, start, end, cell, last, 1)
        z = _crossing(grid, start, end, cell, last, 2)
        # Among equals the order is fixed, so that results repeat
        if x <= min(y, z):
            cell = _next(cell[0], last[0]), cell[1], cell[2]
        elif y <= z:
            cell = cell[0], _next(cell[1], last[1]), cell[2]
        else:
            cell = cell[0], cell[1], _next(cell[2], last[2])
        if grid.occupied[cell[0], cell[1], cell[2]]:
            return False
    return True


@func
def _next(index: int, last: int) -> int:
    """Give the next index on the way to the last one."""
    return index + (1 if last > index else -1)


@func
def _crossing(
    grid: Voxels, start: np.ndarray, end: np.ndarray, cell: Cell, last: Cell, axis: int
) -> float:
    """Compute the share of the segment before it leaves a cell on one axis.

    It is infinite once the cell is level with the last one.
    """
    if cell[axis] == last[axis]:
        return math.inf
    is_ahead = last[axis] > cell[axis]
    # The face through which it is left, and when.
    face = grid.origin[axis] + grid.size * (cell[axis] + is_ahead)
    share: float = (face - start[axis]) / (end[axis] - start[axis])
    return share
