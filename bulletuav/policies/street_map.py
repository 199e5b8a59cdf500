"""Occupancy maps of the streets around drones, built from the ranges of horizontal beams.

A map is a horizontal grid in world axes. Each cell counts the evidence of an obstacle at flight
height, in place of the probabilities of the reference.

References:
    H. Moravec, A. Elfes, High resolution maps from wide angle sonar (1985).
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.envs.aviary import Aviary

CELL = 2.0
"""Edge length of the cells, m"""
EVIDENCE = 12
"""Evidence of a hit: number of beams that must pass through the cell before it counts as free"""
SAME_WALL = 8.0
"""Maximum distance between hits of neighbouring beams on the same wall, m; less than the width
of streets"""
INFLATION = 2
"""Inflation of occupied cells, cells: 4 m, of which 2.6 m are free space"""


def level_beams(aviary: Aviary) -> tuple[np.ndarray, np.ndarray]:
    """Find the horizontal beams of the range finder.

    Drones under velocity control keep a heading of east, so the beams have world axes.

    Args:
        aviary: The observed worlds.

    Returns:
        Indices of the beams in the observation block, (B,), and their directions, (B, 2).

    Raises:
        ValueError: If there are no horizontal beams.
    """
    beams = aviary.task.context.beams
    chosen = np.array([k for k, beam in enumerate(beams) if beam.elevation == 0.0], dtype=int)
    if not len(chosen):
        raise ValueError(
            "lidar_elevations has no 0: horizontal beams are needed, set lidar_elevations=0"
        )
    azimuth = np.radians([beams[k].azimuth for k in chosen])
    return chosen, np.stack([cos(azimuth), sin(azimuth)], axis=1)


@kernel
def update_maps(
    evidence: np.ndarray,
    place: np.ndarray,
    ranges: np.ndarray,
    directions: np.ndarray,
    reach: float,
    updates: np.ndarray,
) -> None:
    """Update the maps with range measurements.

    Args:
        evidence: (W, N, X, Y) evidence of each cell, written.
        place: (W, N, 2) positions of the drones relative to the origins of their maps, m.
        ranges: (W, N, B) ranges of the beams, m.
        directions: (B, 2) unit vectors of the beams, in angular order.
        reach: Range of a beam without a hit, m.
        updates: (W, N) bool, which drones update their map.
    """
    beams = len(directions)
    for w in range(updates.shape[0]):
        for i in range(updates.shape[1]):
            if not updates[w, i]:
                continue
            grid = evidence[w, i]
            x, y = place[w, i, 0], place[w, i, 1]
            # Clear the cells along the beams.
            for b in range(beams):
                # Stop one cell before the hit, which belongs to the obstacle
                free = ranges[w, i, b] - CELL
                clear_beam(grid, x, y, directions[b, 0], directions[b, 1], free)
            # Mark the hits, and the lines between neighbouring hits.
            for b in range(beams):
                if ranges[w, i, b] >= reach:
                    continue
                x_end = x + ranges[w, i, b] * directions[b, 0]
                y_end = y + ranges[w, i, b] * directions[b, 1]
                mark_cell(grid, x_end, y_end)
                # Neighbouring hits that are close to each other are on one wall
                other = (b + 1) % beams
                if ranges[w, i, other] < reach:
                    x_other = x + ranges[w, i, other] * directions[other, 0]
                    y_other = y + ranges[w, i, other] * directions[other, 1]
                    mark_segment(grid, x_end, y_end, x_other - x_end, y_other - y_end)


@func
def clear_beam(
    grid: np.ndarray, x: float, y: float, east: float, north: float, length: float
) -> None:
    """Decrement the evidence of each cell along a beam of `length` m once."""
    last_a, last_b = -1, -1
    for k in range(int(max(length, 0.0) / (0.5 * CELL))):
        # Steps of half a cell miss corners of cells at most
        a = math.floor(x / CELL + 0.5 * k * east)
        b = math.floor(y / CELL + 0.5 * k * north)
        if is_within(grid, a, b) and (a != last_a or b != last_b):
            grid[a, b] = max(grid[a, b] - 1, 0)
        last_a, last_b = a, b


@func
def mark_cell(grid: np.ndarray, x: float, y: float) -> None:
    """Mark the cell at a position, m, as occupied."""
    a, b = math.floor(x / CELL), math.floor(y / CELL)
    if is_within(grid, a, b):
        grid[a, b] = EVIDENCE


@func
def mark_segment(grid: np.ndarray, x: float, y: float, east: float, north: float) -> None:
    """Mark the segment between two hits as occupied, if they are on the same wall.

    Args:
        grid: Evidence of each cell, written.
        x: Position of the first hit, m.
        y: Position of the first hit, m.
        east: Offset to the second hit, m.
        north: Offset to the second hit, m.
    """
    length = math.sqrt(east * east + north * north)
    if length <= SAME_WALL:
        steps = int(length / (0.5 * CELL)) + 1
        for k in range(1, steps):
            mark_cell(grid, x + east * k / steps, y + north * k / steps)


@func
def is_within(grid: np.ndarray, a: int, b: int) -> bool:
    """Return True if cell (a, b) is inside the map."""
    is_inside: bool = 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1]
    return is_inside


@kernel
def inflate(evidence: np.ndarray, occupied: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Compute the cells that paths must not cross.

    These are inflated obstacles, and cells that are not entirely in the airspace.

    Args:
        evidence: (X, Y) evidence of each cell.
        occupied: (X + 2, Y + 2, 3) bool, written: one layer with a border on all sides.
        low: (2,) lower corner of the airspace relative to the origin of the map, m.
        high: (2,) upper corner of the airspace, m.
    """
    occupied[:] = True
    # Free the cells that are entirely in the airspace.
    for a in range(evidence.shape[0]):
        for b in range(evidence.shape[1]):
            is_in = low[0] <= a * CELL and (a + 1) * CELL <= high[0]
            if is_in and low[1] <= b * CELL and (b + 1) * CELL <= high[1]:
                occupied[a + 1, b + 1, 1] = False
    # Inflate obstacles.
    for a in range(evidence.shape[0]):
        for b in range(evidence.shape[1]):
            if evidence[a, b] == 0:
                continue
            for da in range(-INFLATION, INFLATION + 1):
                for db in range(-INFLATION, INFLATION + 1):
                    near = da * da + db * db <= INFLATION * INFLATION
                    if near and is_within(evidence, a + da, b + db):
                        occupied[a + da + 1, b + db + 1, 1] = True
