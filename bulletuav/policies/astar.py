"""Ways through a known city: voxels, A*, shortening.

A city is a grid of cubic cells, free or occupied. Every point of a segment through free cells is within half a cell of
the centre of one, on each axis; so is one between two free cells that touch in an edge or corner only. It is therefore
farther than `clearance` less half a cell from every solid, and A* may step diagonally between occupied cells.
"""

import heapq
import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.rotation import dot
from bulletuav.kernel import func, kernel

STEPS = np.array(
    [
        (x, y, z)
        for x in (-1, 0, 1)
        for y in (-1, 0, 1)
        for z in (-1, 0, 1)
        if (x, y, z) != (0, 0, 0)
    ]
)
UNIT = (
    2**40
)  # of lengths in A*, to a cell: whole numbers, so that ways of the same length tie exactly
EDGE, FACE, SPACE = (
    UNIT,
    round(UNIT * math.sqrt(2)),
    round(UNIT * math.sqrt(3)),
)  # steps along 1, 2 and 3 axes
UNREACHED = 2**62


class Voxels(NamedTuple):
    """Cubic cells of `size` m, occupied (X, Y, Z) or free; the first has its low corner at `origin` (3,), m.

    The outermost cells are always occupied.
    """

    occupied: np.ndarray
    origin: np.ndarray
    size: float


def voxels(
    bounds: np.ndarray, low: np.ndarray, high: np.ndarray, size: float, clearance: float
) -> Voxels:
    """The cells of an arena with corners low, high (3,), m, free where they are wholly in it and clear of everything.

    Occupied are those with a centre in a box of bounds (P, 2, 3), m, grown on each side by `clearance`, m, or no higher
    than `clearance` above the ground.
    """
    inside = np.maximum(np.floor((high - low) / size), 0).astype(int)
    origin = low - size
    occupied = np.ones(inside + 2, dtype=bool)
    occupied[1:-1, 1:-1, 1:-1] = False
    first = np.ceil((bounds[:, 0] - clearance - origin) / size - 0.5).clip(0).astype(int)
    end = np.floor((bounds[:, 1] + clearance - origin) / size + 0.5).clip(0).astype(int)
    for (x, y, z), (x_end, y_end, z_end) in zip(first.tolist(), end.tolist(), strict=True):
        occupied[x:x_end, y:y_end, z:z_end] = True
    occupied[:, :, : max(0, math.floor((clearance - origin[2]) / size + 0.5))] = True
    return Voxels(occupied, origin, float(size))


def plan(grid: Voxels, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Waypoints (K, 3), m, of a short way through free cells from start to goal (3,), with both; (0, 3) if there is none.

    A start or goal that is not in a free cell is joined to the centre of the nearest one by a straight leg.
    """
    if is_clear(grid, start, goal):
        return np.stack([start, goal])
    if grid.occupied.all():
        return np.zeros((0, 3))
    cells = shortest_path(grid.occupied, nearest_free(grid, start), nearest_free(grid, goal))
    if len(cells) == 0:
        return np.zeros((0, 3))
    centres = grid.origin + grid.size * (cells + 0.5)
    return shortened(grid, np.concatenate([start[None], centres, goal[None]]))


@kernel
def nearest_free(grid, point):
    """Cell (3 indices) that is free and has its centre nearest to `point` (3,), m; the lowest indices among equals.

    One must be free.
    """
    x, y, z = cell_of(grid, point)
    if _is_free(grid, (x, y, z)):
        return x, y, z
    least, best = math.inf, (0, 0, 0)
    for x in range(grid.occupied.shape[0]):
        for y in range(grid.occupied.shape[1]):
            for z in range(grid.occupied.shape[2]):
                if not grid.occupied[x, y, z]:
                    gap = (
                        _offset(grid, point, 0, x),
                        _offset(grid, point, 1, y),
                        _offset(grid, point, 2, z),
                    )
                    square = dot(gap, gap)
                    if square < least:
                        least, best = square, (x, y, z)
    return best


@func
def _offset(grid, point, axis, k):
    """How far the centre of the k-th cell is from a point on one axis, m."""
    return grid.origin[axis] + grid.size * (k + 0.5) - point[axis]


@func
def cell_of(grid, point):
    """Indices of the cell that holds a point, m; out of range where it is out of the grid."""
    return _index(grid, point, 0), _index(grid, point, 1), _index(grid, point, 2)


@func
def _index(grid, point, axis):
    return math.floor((point[axis] - grid.origin[axis]) / grid.size)


@func
def _is_free(grid, cell):
    for axis in range(3):
        if not 0 <= cell[axis] < grid.occupied.shape[axis]:
            return False
    return not grid.occupied[cell[0], cell[1], cell[2]]


@kernel
def shortest_path(occupied, start, goal):
    """Cells (K, 3) of a shortest way between two free ones, both included, by steps to any of 26 neighbours; or (0, 3).

    `occupied` (X, Y, Z) is True in the outermost cells. Steps cost their Euclidean length. A*: P. Hart, N. Nilsson,
    B. Raphael, A formal basis for the heuristic determination of minimum cost paths (1968). Where ways seem equally
    promising, it goes on with the one nearest to the goal, then with the lowest cell: the answer is always the same.
    """
    shape = occupied.shape
    offset, length = np.empty(len(STEPS), np.int64), np.empty(len(STEPS), np.int64)
    for k in range(len(STEPS)):
        x, y, z = STEPS[k]
        offset[k] = (x * shape[1] + y) * shape[2] + z
        length[k] = octile(x, y, z)
    blocked, cost, came_from = (
        occupied.ravel(),
        np.full(occupied.size, UNREACHED),
        np.full(occupied.size, -1),
    )
    first = (start[0] * shape[1] + start[1]) * shape[2] + start[2]
    last = (goal[0] * shape[1] + goal[1]) * shape[2] + goal[2]
    left = octile(goal[0] - start[0], goal[1] - start[1], goal[2] - start[2])
    cost[first] = 0
    heap = [(left, left, first)]
    while len(heap) > 0:
        total, left, cell = heapq.heappop(heap)
        if cell == last:
            break
        if total - left > cost[cell]:
            continue  # a shorter way there was found meanwhile
        for k in range(len(STEPS)):
            other, reached = cell + offset[k], cost[cell] + length[k]
            if reached < cost[other] and not blocked[other]:
                cost[other], came_from[other] = reached, cell
                x, y, z = _cell(other, shape)
                left = octile(goal[0] - x, goal[1] - y, goal[2] - z)
                heapq.heappush(heap, (reached + left, left, other))
    return _traced(came_from, first, last, shape)


@func
def octile(x, y, z):
    """Least length, in UNIT, of steps that lead x, y and z cells away where all is free."""
    x, y, z = abs(x), abs(y), abs(z)
    most, least = max(x, y, z), min(x, y, z)
    middle = x + y + z - most - least
    return SPACE * least + FACE * (middle - least) + EDGE * (most - middle)


@func
def _cell(index, shape):
    """Indices on three axes of a flat index."""
    return index // (shape[1] * shape[2]), index // shape[2] % shape[1], index % shape[2]


@kernel
def _traced(came_from, first, last, shape):
    """The cells (K, 3) from `first` to `last`; none where `last` was not reached."""
    count, cell = 1, last
    while cell != first and cell != -1:
        count, cell = count + 1, came_from[cell]
    if cell == -1:
        return np.empty((0, 3), np.int64)
    cells = np.empty((count, 3), np.int64)
    cell = last
    for k in range(count - 1, -1, -1):
        cells[k] = _cell(cell, shape)
        cell = came_from[cell]
    return cells


@kernel
def shortened(grid, points):
    """Those of the points (K, 3), m, that are left when from each the way leads straight to the last one in sight."""
    kept, k = [0], 0
    while k < len(points) - 1:
        seen = len(points) - 1
        while seen > k + 1 and not is_clear(grid, points[k], points[seen]):
            seen -= 1
        kept.append(seen)
        k = seen
    return points[np.array(kept)]


@kernel
def is_clear(grid, start, end):
    """Whether the segment between two points (3,), m, is in free cells only.

    J. Amanatides, A. Woo, A fast voxel traversal algorithm for ray tracing (1987).
    """
    cell, last = cell_of(grid, start), cell_of(grid, end)
    if not (_is_free(grid, cell) and _is_free(grid, last)):
        return False
    while cell != last:
        x = _crossing(grid, start, end, cell, last, 0)
        y = _crossing(grid, start, end, cell, last, 1)
        z = _crossing(grid, start, end, cell, last, 2)
        if x <= min(y, z):
            cell = cell[0] + (1 if last[0] > cell[0] else -1), cell[1], cell[2]
        elif y <= z:
            cell = cell[0], cell[1] + (1 if last[1] > cell[1] else -1), cell[2]
        else:
            cell = cell[0], cell[1], cell[2] + (1 if last[2] > cell[2] else -1)
        if grid.occupied[cell[0], cell[1], cell[2]]:
            return False
    return True


@func
def _crossing(grid, start, end, cell, last, axis):
    """Share of the segment before it leaves `cell` on this axis; infinite once it is level with the last cell."""
    if cell[axis] == last[axis]:
        return math.inf
    face = grid.origin[axis] + grid.size * (cell[axis] + (last[axis] > cell[axis]))
    return (face - start[axis]) / (end[axis] - start[axis])
