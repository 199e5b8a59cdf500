"""Start positions of the drones that the servers of `bulletuav.bridges` fly."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.errors import as_int, points_of

MAX_DRONES = 256


def make_start_positions(
    drones: int | Sequence[Sequence[float]], height: float, spacing: float
) -> np.ndarray:
    """Return the start positions of the drones of a server.

    Args:
        drones: Number of drones, or (N, 2) positions, east and north, m.
        height: Height of the centres of the drones, m.
        spacing: Distance between neighbours on the grid, used if `drones` is a number, m.

    Returns:
        (N, 3) positions, m. For a number of drones: a square grid whose first drone is at the
        origin.

    Raises:
        ValueError: If the number of drones is out of range, or a position is not a finite number.
    """
    if isinstance(drones, int | np.integer):
        count = as_int("drones", drones, 1, MAX_DRONES)
        side = math.isqrt(count - 1) + 1
        positions = [(spacing * (k % side), spacing * (k // side)) for k in range(count)]
    else:
        as_int("number of drones", len(drones), 1, MAX_DRONES)
        positions = [(position[0], position[1]) for position in map(tuple, drones)]
    return points_of("drones", [(*position, height) for position in positions])
