"""Where drones of bridges stand at the start."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.errors import as_int, points_of

MOST_DRONES = 256


def starts(drones: int | Sequence[Sequence[float]], height: float, spacing: float) -> np.ndarray:
    """Tell where drones stand at the start.

    Args:
        drones: Their number, or (N, 2) where, m.
        height: Of their centres, m.
        spacing: Distance between neighbours, if a number is given, m.

    Returns:
        (N, 3) m; of a number, in rows as long as there are rows, the first at the origin.

    Raises:
        ValueError: A number cannot be.
    """
    if isinstance(drones, int | np.integer):
        count = as_int("drones", drones, 1, MOST_DRONES)
        side = math.isqrt(count - 1) + 1
        places = [(spacing * (k % side), spacing * (k // side)) for k in range(count)]
    else:
        as_int("number of drones", len(drones), 1, MOST_DRONES)
        places = [(one[0], one[1]) for one in map(tuple, drones)]
    return points_of("drones", [(*place, height) for place in places])
