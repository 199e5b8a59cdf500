"""Shortest paths through a known city: A* on a voxel map, followed by path shortening."""

import heapq
import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.policies.voxels import Cell, Voxels, is_segment_free, nearest_free

STEPS = np.array(
    [
        (x, y, z)
        for x in (-1, 0, 1)
        for y in (-1, 0, 1)
        for z in (-1, 0, 1)
        if (x, y, z) != (0, 0, 0)
    ]
)
"""(26, 3) index offsets to the neighbours of a cell"""
UNIT = 2**40
"""Edge length of a cell in A*; integer path lengths make ties between equal paths exact"""
EDGE = UNIT
"""Length of a step along one axis"""
FACE = round(UNIT * math.sqrt(2))
"""Length of a step along two axes"""
SPACE = round(UNIT * math.sqrt(3))
"""Length of a step along three axes"""
UNREACHED = 2**62
"""Path length of a cell that the search has not reached"""


def plan_path(grid: Voxels, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Find a short collision-free path between two points.

    A start or goal that is not in a free cell is connected by a straight segment to the centre of
    the nearest free cell.

    Args:
        grid: The voxel map.
        start: (3,) start position, m.
        goal: (3,) goal position, m.

    Returns:
        (K, 3) waypoints including start and goal, m; (0, 3) if there is no path.
    """
    if is_segment_free(grid, start, goal):
        return np.stack([start, goal])
    if grid.occupied.all():
        return np.zeros((0, 3))
    first = nearest_free(grid, start)
    last = nearest_free(grid, goal)
    cells = shortest_path(grid.occupied, first, last)
    if len(cells) == 0:
        return np.zeros((0, 3))
    centres = grid.origin + grid.size * (cells + 0.5)
    return shorten_path(grid, np.concatenate([start[None], centres, goal[None]]))


@allocating
def shortest_path(occupied: np.ndarray, start: Cell, goal: Cell) -> np.ndarray:
    """Find a shortest 26-connected path between two free cells with A*.

    A step costs its Euclidean length. Ties are broken by the smaller heuristic value, then by the
    lower cell index, so that the result is deterministic.

    References:
        P. Hart, N. Nilsson, B. Raphael, A formal basis for the heuristic determination of minimum
        cost paths (1968).

    Args:
        occupied: (X, Y, Z) bool occupancy; the outermost cells must be occupied.
        start: Start cell.
        goal: Goal cell.

    Returns:
        (K, 3) cells including start and goal; (0, 3) if there is no path.
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
    heuristic = _heuristic(start, goal)
    cost[first] = 0
    # Open set: estimated total cost, heuristic, flat index.
    heap = [(heuristic, heuristic, first)]
    while len(heap) > 0:
        total, heuristic, cell = heapq.heappop(heap)
        if cell == last:
            break
        # Stale entry: a shorter path to this cell was found after it was pushed.
        if total - heuristic > cost[cell]:
            continue
        for k in range(len(STEPS)):
            other = cell + offset[k]
            reached = cost[cell] + length[k]
            if reached < cost[other] and not blocked[other]:
                cost[other] = reached
                came_from[other] = cell
                heuristic = _heuristic(_cell(other, shape), goal)
                heapq.heappush(heap, (reached + heuristic, heuristic, other))
    return _trace_path(came_from, first, last, shape)


@func
def octile(x: int, y: int, z: int) -> int:
    """Compute the octile distance: the length of a shortest 26-connected path in free space.

    Args:
        x: Number of cells along the first axis, of either sign.
        y: Number of cells along the second axis.
        z: Number of cells along the third axis.

    Returns:
        The length, in cell edges times UNIT.
    """
    x, y, z = abs(x), abs(y), abs(z)
    longest = max(x, y, z)
    shortest = min(x, y, z)
    middle = x + y + z - longest - shortest
    return SPACE * shortest + FACE * (middle - shortest) + EDGE * (longest - middle)


@func
def _heuristic(cell: Cell, goal: Cell) -> int:
    return octile(
        goal[0] - cell[0],
        goal[1] - cell[1],
        goal[2] - cell[2],
    )


@func
def _flat(cell: Cell, shape: tuple[int, ...]) -> int:
    """Return the flat index of a cell, or the flat offset of a step."""
    return (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]


@func
def _cell(index: int, shape: tuple[int, ...]) -> Cell:
    return (
        index // (shape[1] * shape[2]),
        index // shape[2] % shape[1],
        index % shape[2],
    )


@allocating
def _trace_path(came_from: np.ndarray, first: int, last: int, shape: tuple[int, ...]) -> np.ndarray:
    """Trace the path back from `last` to `first`; return (K, 3) cells, or (0, 3) if unreached."""
    # First pass: count the cells. Second pass: write them in reverse order.
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
def shorten_path(grid: Voxels, points: np.ndarray) -> np.ndarray:
    """Remove waypoints that the line of sight makes unnecessary.

    From each kept waypoint, the path continues to the last waypoint that a free segment reaches.

    Args:
        grid: The voxel map.
        points: (K, 3) waypoints, m.

    Returns:
        The waypoints that are kept, including both ends, m.
    """
    kept = [0]
    k = 0
    while k < len(points) - 1:
        # Search backwards for the last waypoint in sight.
        seen = len(points) - 1
        while seen > k + 1 and not is_segment_free(grid, points[k], points[seen]):
            seen -= 1
        kept.append(seen)
        k = seen
    heuristic: np.ndarray = points[np.array(kept)]
    return heuristic
