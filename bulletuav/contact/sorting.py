"""Sort the drones of a world by position, so that results do not depend on their indices."""

import numpy as np

from bulletuav.compiled.kernel import func


@func
def _is_before(position: np.ndarray, w: int, i: int, j: int) -> bool:
    """Check whether drone i comes before drone j by x, then y, then z."""
    for k in range(3):
        one = float(position[w, i, k])
        other = float(position[w, j, k])
        if one != other:
            return one < other
    return False


@func
def sort_drones(order: np.ndarray, position: np.ndarray, w: int) -> None:
    """Write the indices (N,) of the drones of a world, sorted by x, then y, then z."""
    for last in range(order.shape[0]):
        i = last
        k = last
        while k > 0 and _is_before(position, w, i, order[k - 1]):
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
