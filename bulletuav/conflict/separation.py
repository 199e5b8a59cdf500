"""Conflict: separation below d_safe (never to be mixed with collision, which is contact of collision shapes)."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import closest_squared, offset
from bulletuav.kernel import kernel


class Conflict(NamedTuple):
    """Separations of each drone from the others within one decision, all (W, N).

    separation  closest distance to another living drone, m; inf when alone
    onsets      other drones with which a conflict began, count
    nearness    sum over others of how deep they came into the warning zone, from its edge (0) to d_safe (1)
    """

    separation: np.ndarray
    onsets: np.ndarray
    nearness: np.ndarray


@kernel
def _conflict(before, after, alive, d_safe, zone, separation, onsets, nearness):
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                start, least = closest_squared(offset(before, w, i, j), offset(after, w, i, j))
                start, least = math.sqrt(start), math.sqrt(least)
                began = 1 if least < d_safe <= start else 0
                depth = min(1.0, max(0.0, (zone - least) / (zone - d_safe)))
                for k in (i, j):
                    separation[w, k] = min(separation[w, k], least)
                    onsets[w, k] += began
                    nearness[w, k] += depth


def conflict(
    before: np.ndarray, after: np.ndarray, alive: np.ndarray, d_safe: float, zone: float
) -> Conflict:
    """Separations while positions (W, N, 3) go straight from `before` to `after`; only living drones (W, N) count.

    A conflict that lasts is counted once, in the decision in which the separation falls below `d_safe` (m). The warning
    zone ends at a separation of `zone` (m), more than d_safe.
    """
    result = Conflict(
        np.full(alive.shape, np.inf), np.zeros(alive.shape, dtype=np.int64), np.zeros(alive.shape)
    )
    _conflict(before, after, alive, d_safe, zone, *result)
    return result
