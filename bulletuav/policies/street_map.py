"""Maps that drones make of the streets around them, from the ranges of level beams.

A map has a cell for each square of the ground, in the axes of the world. Each cell counts the
evidence that something stands there at the height of flight: H. Moravec, A. Elfes, High resolution
maps from wide angle sonar (1985), with counts in place of probabilities.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.envs.aviary import Aviary

CELL = 2.0
"""Side of the cells, m"""
EVIDENCE = 12
"""Evidence after a hit: so many beams must pass through a cell before it counts as free"""
SAME_WALL = 8.0
"""Distance between the hits of neighbouring beams up to which they are one wall, m; narrower
than streets are"""
ROOM = 2
"""Cells about an occupied one that are not flown through: 4 m, of which 2.6 m are room"""


def level_beams(aviary: Aviary) -> tuple[np.ndarray, np.ndarray]:
    """Find the level beams of the range finder.

    Drones that are told velocities keep their noses to the east, so beams have world axes.

    Args:
        aviary: The worlds that are observed.

    Returns:
        Which numbers of the block they are, (B,), and their directions, (B, 2).

    Raises:
        ValueError: There are none.
    """
    beams = aviary.task.context.beams
    chosen = np.array([k for k, beam in enumerate(beams) if beam.elevation == 0.0], dtype=int)
    if not len(chosen):
        raise ValueError(
            "lidar_elevations has no 0: level beams are needed, choose lidar_elevations=0"
        )
    azimuth = np.radians([beams[k].azimuth for k in chosen])
    return chosen, np.stack([cos(azimuth), sin(azimuth)], axis=1)


@kernel
def scan(
    evidence: np.ndarray,
    place: np.ndarray,
    ranges: np.ndarray,
    directions: np.ndarray,
    reach: float,
    looks: np.ndarray,
) -> None:
    """Write what beams saw into the maps.

    Args:
        evidence: (W, N, X, Y) of each cell, written.
        place: (W, N, 2) places of the drones, m from the first corner of their maps.
        ranges: (W, N, B) ranges of the beams, m.
        directions: (B, 2) their unit vectors, one next to the other.
        reach: Range of a beam that sees nothing, m.
        looks: (W, N) bool, which drones look.
    """
    beams = len(directions)
    for w in range(looks.shape[0]):
        for i in range(looks.shape[1]):
            if not looks[w, i]:
                continue
            grid = evidence[w, i]
            x, y = place[w, i, 0], place[w, i, 1]
            # What beams passed through is free.
            for b in range(beams):
                # A cell short of the end, which belongs to what stands there
                free = ranges[w, i, b] - CELL
                pass_through(grid, x, y, directions[b, 0], directions[b, 1], free)
            # Where they ended something stands, also between the ends of neighbours.
            for b in range(beams):
                if ranges[w, i, b] >= reach:
                    continue
                x_end = x + ranges[w, i, b] * directions[b, 0]
                y_end = y + ranges[w, i, b] * directions[b, 1]
                mark(grid, x_end, y_end)
                # Both ends are near each other on one wall, or the gap is marked, too
                other = (b + 1) % beams
                if ranges[w, i, other] < reach:
                    x_other = x + ranges[w, i, other] * directions[other, 0]
                    y_other = y + ranges[w, i, other] * directions[other, 1]
                    join(grid, x_end, y_end, x_other - x_end, y_other - y_end)


@func
def pass_through(
    grid: np.ndarray, x: float, y: float, east: float, north: float, length: float
) -> None:
    """Take evidence from the cells along a beam of `length` m, once from each."""
    last_a, last_b = -1, -1
    for k in range(int(max(length, 0.0) / (0.5 * CELL))):
        # Steps of half a cell: at most corners of cells are cut
        a = math.floor(x / CELL + 0.5 * k * east)
        b = math.floor(y / CELL + 0.5 * k * north)
        # Evidence wears off, but never below none
        if is_within(grid, a, b) and (a != last_a or b != last_b):
            grid[a, b] = max(grid[a, b] - 1, 0)
        last_a, last_b = a, b


@func
def mark(grid: np.ndarray, x: float, y: float) -> None:
    """Note that something stands at a place, m."""
    a, b = math.floor(x / CELL), math.floor(y / CELL)
    if is_within(grid, a, b):
        grid[a, b] = EVIDENCE


@func
def join(grid: np.ndarray, x: float, y: float, east: float, north: float) -> None:
    """Mark the way from one hit to another, (east, north) m off, if both are of one wall."""
    length = math.sqrt(east * east + north * north)
    if length <= SAME_WALL:
        steps = int(length / (0.5 * CELL)) + 1
        for k in range(1, steps):
            mark(grid, x + east * k / steps, y + north * k / steps)


@func
def is_within(grid: np.ndarray, a: int, b: int) -> bool:
    """Tell whether a map has a cell."""
    is_inside: bool = 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1]
    return is_inside


@kernel
def grow(evidence: np.ndarray, occupied: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Write which cells are not flown through.

    These are those near evidence, and those that are not wholly in the airspace.

    Args:
        evidence: (X, Y) of each cell.
        occupied: (X + 2, Y + 2, 3) bool, written: a layer with a border all around.
        low: (2,) where the airspace begins, m from the map's first corner.
        high: (2,) where it ends, m.
    """
    occupied[:] = True
    # Cells of the airspace are free ...
    for a in range(evidence.shape[0]):
        for b in range(evidence.shape[1]):
            is_in = low[0] <= a * CELL and (a + 1) * CELL <= high[0]
            if is_in and low[1] <= b * CELL and (b + 1) * CELL <= high[1]:
                occupied[a + 1, b + 1, 1] = False
    # ... but for those about evidence.
    for a in range(evidence.shape[0]):
        for b in range(evidence.shape[1]):
            if evidence[a, b] == 0:
                continue
            for da in range(-ROOM, ROOM + 1):
                for db in range(-ROOM, ROOM + 1):
                    near = da * da + db * db <= ROOM * ROOM
                    if near and is_within(evidence, a + da, b + db):
                        occupied[a + da + 1, b + db + 1, 1] = True
