"""Shortest ways through a known city: A* over its map of cells, and shortening of what it finds."""

import heapq
import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.policies.voxels import Cell, Voxels, is_clear, nearest_free

STEPS = np.array(
    [
        (x, y, z)
        for x in (-1, 0, 1)
        for y in (-1, 0, 1)
        for z in (-1, 0, 1)
        if (x, y, z) != (0, 0, 0)
    ]
)
"""(26, 3) steps to the neighbours of a cell, cells"""
UNIT = 2**40
"""Length of a cell in A*: whole numbers, so that ways of the same length tie exactly"""
EDGE = UNIT
"""Length of a step along one axis"""
FACE = round(UNIT * math.sqrt(2))
"""Length of a step along two axes"""
SPACE = round(UNIT * math.sqrt(3))
"""Length of a step along three axes"""
UNREACHED = 2**62
"""Length of the way to a cell before one is known"""


def plan(grid: Voxels, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Find a short way through free cells.

    A start or goal that is not in a free cell is joined to the centre of the nearest one by a
    straight leg.

    Args:
        grid: The map.
        start: (3,) where the way begins, m.
        goal: (3,) where it ends, m.

    Returns:
        (K, 3) waypoints, m, with both ends; (0, 3) if there is no way.
    """
    if is_clear(grid, start, goal):
        return np.stack([start, goal])
    if grid.occupied.all():
        return np.zeros((0, 3))
    first = nearest_free(grid, start)
    last = nearest_free(grid, goal)
    cells = shortest_path(grid.occupied, first, last)
    if len(cells) == 0:
        return np.zeros((0, 3))
    # From the start through the centres of the cells to the goal, without detours.
    centres = grid.origin + grid.size * (cells + 0.5)
    return shortened(grid, np.concatenate([start[None], centres, goal[None]]))


@allocating
def shortest_path(occupied: np.ndarray, start: Cell, goal: Cell) -> np.ndarray:
    """Find a shortest way between two free cells, by steps to any of 26 neighbours.

    Steps cost their Euclidean length. A*: P. Hart, N. Nilsson, B. Raphael, A formal basis for the
    heuristic determination of minimum cost paths (1968). Where ways seem equally promising, it
    goes on with the one nearest to the goal, then with the lowest cell: the answer is always the
    same.

    Args:
        occupied: (X, Y, Z) bool; the outermost cells are.
        start: The first cell.
        goal: The last cell.

    Returns:
        (K, 3) cells, with both ends; (0, 3) if there is no way.
    """
    shape = occupied.shape
    # Steps as offsets of flat indices, and their lengths.
    offset = np.empty(len(STEPS), np.int64)
    length = np.empty(len(STEPS), np.int64)
    for k in range(len(STEPS)):
        x, y, z = STEPS[k]
        offset[k] = _flat((x, y, z), shape)
        length[k] = octile(x, y, z)
    blocked = occupied.ravel()
    cost = np.full(occupied.size, UNREACHED)
    came_from = np.full(occupied.size, -1)
    first = _flat(start, shape)
    last = _flat(goal, shape)
    left = _least_way(start, goal)
    cost[first] = 0
    # Cells to go on from: least total length, way that is left at least, flat index.
    heap = [(left, left, first)]
    while len(heap) > 0:
        total, left, cell = heapq.heappop(heap)
        if cell == last:
            break
        # A shorter way there was found meanwhile.
        if total - left > cost[cell]:
            continue
        # A way through this cell may be shorter for its neighbours.
        for k in range(len(STEPS)):
            other = cell + offset[k]
            reached = cost[cell] + length[k]
            if reached < cost[other] and not blocked[other]:
                cost[other] = reached
                came_from[other] = cell
                left = _least_way(_cell(other, shape), goal)
                heapq.heappush(heap, (reached + left, left, other))
    return _traced(came_from, first, last, shape)


@func
def octile(x: int, y: int, z: int) -> int:
    """Compute the least length of steps that lead x, y and z cells away where all is free.

    Args:
        x: Cells on the first axis, of either sign.
        y: Cells on the second axis.
        z: Cells on the third axis.

    Returns:
        The length, in 1 / UNIT of a cell.
    """
    x, y, z = abs(x), abs(y), abs(z)
    most = max(x, y, z)
    least = min(x, y, z)
    middle = x + y + z - most - least
    return SPACE * least + FACE * (middle - least) + EDGE * (most - middle)


@func
def _least_way(cell: Cell, goal: Cell) -> int:
    """Compute the least length of steps from a cell to the goal where all is free."""
    return octile(
        goal[0] - cell[0],
        goal[1] - cell[1],
        goal[2] - cell[2],
    )


@func
def _flat(cell: Cell, shape: tuple[int, ...]) -> int:
    """Find the flat index of a cell, or the difference that a step makes."""
    return (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]


@func
def _cell(index: int, shape: tuple[int, ...]) -> Cell:
    """Find the cell of a flat index."""
    return (
        index // (shape[1] * shape[2]),
        index // shape[2] % shape[1],
        index % shape[2],
    )


@allocating
def _traced(came_from: np.ndarray, first: int, last: int, shape: tuple[int, ...]) -> np.ndarray:
    """Trace the cells (K, 3) from `first` to `last`; none where `last` was not reached."""
    # Count them from the end, then write them from the end.
    count = 1
    cell = last
    while cell != first and cell != -1:
        count += 1
        cell = came_from[cell]
    if cell == -1:
        return np.empty((0, 3), np.int64)
    cells = np.empty((count, 3), np.int64)
    cell = last
    for k in range(count - 1, -1, -1):
        cells[k] = _cell(cell, shape)
        cell = came_from[cell]
    return cells


@allocating
def shortened(grid: Voxels, points: np.ndarray) -> np.ndarray:
    """Leave out waypoints: from each one kept the way leads straight to the last one in sight.

    Args:
        grid: The map.
        points: (K, 3) waypoints, m.

    Returns:
        Those that are kept, with both ends.
    """
    kept = [0]
    k = 0
    while k < len(points) - 1:
        # The last point in sight, from the end of the way back.
        seen = len(points) - 1
        while seen > k + 1 and not is_clear(grid, points[k], points[seen]):
            seen -= 1
        kept.append(seen)
        k = seen
    left: np.ndarray = points[np.array(kept)]
    return left
