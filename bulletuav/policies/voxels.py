"""Voxel maps of a known city.

Every point of a segment through free cells is within half a cell of the centre of a free cell, on
each axis. The same holds for a segment between two free cells that share only an edge or a corner.
The segment is therefore farther than `clearance` minus half a cell from every solid, and A* may
step diagonally between occupied cells.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3Like, dot

Cell = tuple[int, int, int]
"""Indices of a cell along the axes x, y and z"""


class Voxels(NamedTuple):
    """Voxel map of a volume; the outermost cells are always occupied.

    Attributes:
        occupied: (X, Y, Z) bool occupancy.
        origin: (3,) lower corner of the first cell, m.
        size: Edge length of a cell, m.
    """

    occupied: np.ndarray
    origin: np.ndarray
    size: float


def build_voxels(
    bounds: np.ndarray, low: np.ndarray, high: np.ndarray, size: float, clearance: float
) -> Voxels:
    """Build the voxel map of an arena; cells that are not entirely inside it are occupied.

    A cell is also occupied if its centre is inside a box inflated by `clearance`, or at most
    `clearance` above the ground.

    Args:
        bounds: (P, 2, 3) lower and upper corners of boxes, m.
        low: (3,) lower corner of the arena, m.
        high: (3,) upper corner of the arena, m.
        size: Edge length of a cell, m.
        clearance: Inflation of the boxes on each side, m.

    Returns:
        The voxel map.
    """
    # Whole cells of the arena, and a border of one cell.
    inside = np.maximum(np.floor((high - low) / size), 0).astype(int)
    origin = low - size
    occupied = np.ones(inside + 2, dtype=bool)
    occupied[1:-1, 1:-1, 1:-1] = False
    # First cell with its centre in each inflated box, and one past the last.
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
    """Find the free cell with its centre nearest to a point; the cell of the point itself if free.

    Args:
        grid: The voxel map, with at least one free cell.
        point: (3,) the point, m.

    Returns:
        The cell; in case of ties the one with the lowest indices.
    """
    x, y, z = voxel_of(grid, point)
    if _is_free(grid, (x, y, z)):
        return x, y, z
    closest = math.inf
    best = (0, 0, 0)
    for x in range(grid.occupied.shape[0]):
        for y in range(grid.occupied.shape[1]):
            for z in range(grid.occupied.shape[2]):
                if not grid.occupied[x, y, z]:
                    # Offsets of the cell's centre from the point
                    offset = (
                        _offset(grid, point, 0, x),
                        _offset(grid, point, 1, y),
                        _offset(grid, point, 2, z),
                    )
                    square = dot(offset, offset)
                    if square < closest:
                        closest = square
                        best = (x, y, z)
    return best


@func
def _offset(grid: Voxels, point: Vec3Like, axis: int, k: int) -> float:
    offset: float = grid.origin[axis] + grid.size * (k + 0.5) - point[axis]
    return offset


@func
def voxel_of(grid: Voxels, point: Vec3Like) -> Cell:
    """Return the cell that contains a point, m; out of range for points outside the map."""
    return (
        _index(grid, point, 0),
        _index(grid, point, 1),
        _index(grid, point, 2),
    )


@func
def _index(grid: Voxels, point: Vec3Like, axis: int) -> int:
    index: int = math.floor((point[axis] - grid.origin[axis]) / grid.size)
    return index


@func
def _is_free(grid: Voxels, cell: Cell) -> bool:
    """Return True if a cell is inside the map and free."""
    for axis in range(3):
        if not 0 <= cell[axis] < grid.occupied.shape[axis]:
            return False
    return not grid.occupied[cell[0], cell[1], cell[2]]


@kernel
def is_segment_free(grid: Voxels, start: np.ndarray, end: np.ndarray) -> bool:
    """Return True if the segment between two points crosses free cells only.

    References:
        J. Amanatides, A. Woo, A fast voxel traversal algorithm for ray tracing (1987).

    Args:
        grid: The voxel map.
        start: (3,) one end, m.
        end: (3,) the other end, m.
    """
    cell = voxel_of(grid, start)
    last = voxel_of(grid, end)
    if not _is_free(grid, cell):
        return False
    if not _is_free(grid, last):
        return False
    while cell != last:
        # Step to the next cell through the first face that the segment crosses.
        x = _crossing(grid, start, end, cell, last, 0)
        y = _crossing(grid, start, end, cell, last, 1)
        z = _crossing(grid, start, end, cell, last, 2)
        # Ties are broken in a fixed order, so that results are reproducible
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
    return index + (1 if last > index else -1)


@func
def _crossing(
    grid: Voxels, start: np.ndarray, end: np.ndarray, cell: Cell, last: Cell, axis: int
) -> float:
    """Return the fraction of the segment up to its exit from a cell along one axis.

    The fraction is infinite if the cell and the last cell have the same index on this axis.
    """
    if cell[axis] == last[axis]:
        return math.inf
    is_ahead = last[axis] > cell[axis]
    face = grid.origin[axis] + grid.size * (cell[axis] + is_ahead)
    fraction: float = (face - start[axis]) / (end[axis] - start[axis])
    return fraction
