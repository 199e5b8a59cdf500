"""Sort the drones of a world by position, so that results do not depend on their indices."""

import numpy as np

from bulletuav.compiled.kernel import func

MAX_INSERTED = 32
"""Number of drones up to which they are sorted by insertion alone"""


@func
def _is_before(position: np.ndarray, w: int, i: int, j: int) -> bool:
    """Check whether drone i comes before drone j by x, then y, then z, then index."""
    for k in range(3):
        one = float(position[w, i, k])
        other = float(position[w, j, k])
        if one != other:
            return one < other
    return i < j


@func
def sort_drones(order: np.ndarray, position: np.ndarray, w: int) -> None:
    """Sort the indices (N,) of the drones of a world by x, then y, then z, then index.

    Args:
        order: (N,) indices of all drones in any order; that of the last call is faster than others.
        position: (W, N, 3) positions, m.
        w: Index of the world.
    """
    # Shell sort: in place, and fast for drones that are nearly sorted. One insertion sort is enough
    # for few drones.
    gap = order.shape[0] // 2
    if order.shape[0] <= MAX_INSERTED:
        gap = 1
        for i in range(order.shape[0]):
            order[i] = i
    while gap > 0:
        for last in range(gap, order.shape[0]):
            i = order[last]
            k = last
            while k >= gap and _is_before(position, w, i, order[k - gap]):
                order[k] = order[k - gap]
                k -= gap
            order[k] = i
        gap = gap // 2


@func
def write_ranks(order: np.ndarray, rank: np.ndarray) -> None:
    """Write the place of each drone in `order` to `rank` (N,)."""
    for place in range(order.shape[0]):
        rank[order[place]] = place
