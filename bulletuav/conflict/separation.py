"""Conflict: a separation below d_safe.

Never to be mixed with collision, which is contact of collision shapes.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import closest_squared, offset
from bulletuav.kernel import kernel


class Conflict(NamedTuple):
    """Separations of each drone from the others within one decision.

    Attributes:
        separation: (W, N) closest distance to another living drone, m; inf when alone.
        onsets: (W, N) number of other drones with which a conflict began.
        nearness: (W, N) sum over the others of how deep they came into the warning zone, from its
            edge (0) to d_safe (1).
    """

    separation: np.ndarray
    onsets: np.ndarray
    nearness: np.ndarray


def no_conflict(shape: tuple[int, int]) -> Conflict:
    """Make the separations of drones (W, N) that are alone."""
    return Conflict(
        separation=np.full(shape, np.inf),
        onsets=np.zeros(shape, dtype=np.int64),
        nearness=np.zeros(shape),
    )


@kernel
def fill_conflict(
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    d_safe: float,
    zone: float,
    separation: np.ndarray,
    onsets: np.ndarray,
    nearness: np.ndarray,
) -> None:
    """Fill the arrays of a `Conflict`; see `conflict` for the arguments."""
    for w in range(alive.shape[0]):
        # Who flies alone keeps these
        for i in range(alive.shape[1]):
            separation[w, i] = np.inf
            onsets[w, i] = 0
            nearness[w, i] = 0.0
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                # How close the pair comes on its way, and at its start.
                at_start = offset(before, w, i, j)
                at_end = offset(after, w, i, j)
                start_squared, least_squared = closest_squared(at_start, at_end)
                start = math.sqrt(start_squared)
                least = math.sqrt(least_squared)
                # A conflict that lasts began in an earlier decision.
                began = 1 if least < d_safe <= start else 0
                depth = min(1.0, max(0.0, (zone - least) / (zone - d_safe)))
                # Both drones of the pair count it.
                for k in (i, j):
                    separation[w, k] = min(separation[w, k], least)
                    onsets[w, k] += began
                    nearness[w, k] += depth


def conflict(
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    d_safe: float,
    zone: float,
) -> Conflict:
    """Measure separations while all drones go straight from one position to the next.

    A conflict that lasts is counted once, in the decision in which the separation falls below
    `d_safe`.

    Args:
        before: (W, N, 3) positions at the start of the decision, m.
        after: (W, N, 3) positions at its end, m.
        alive: (W, N) bool, the drones that count.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone ends, m; more than `d_safe`.

    Returns:
        The separations of each drone.
    """
    result = no_conflict(alive.shape)
    fill_conflict(before, after, alive, d_safe, zone, *result)
    return result
