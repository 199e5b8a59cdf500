"""Conflict: a separation below d_safe.

Never to be mixed with collision, which is contact of collision shapes.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.gather import gathered, lane_numbers, scatter, three
from bulletuav.compiled.kernel import kernel
from bulletuav.compiled.lanes import WIDTH, is_any, where
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.rotation import minus, vec3


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
    """Fill the arrays of a `Conflict`; see `measure_conflict` for the arguments."""
    num_drones = alive.shape[1]
    # Farther pairs are outside of the zone, however their squares are rounded
    far = (1.0 + 1e-9) * zone * zone
    for w in range(alive.shape[0]):
        # Drones in lanes, each with all others of its world
        for lowest in range(0, num_drones, WIDTH):
            first = w * num_drones + lowest
            here = three(before, first)
            there = three(after, first)
            # Nothing compares with NaN: who does not fly is near to nobody
            x = where(gathered(alive, first, 0), here[0], math.nan)
            itself = lane_numbers() + lowest
            closest, begun, depths = np.inf, 0.0, 0.0
            for j in range(num_drones):
                if not alive[w, j]:
                    continue
                # How close the pair comes on its way, and at its start
                others = (where(itself != j, x, math.nan), here[1], here[2])
                at_start = minus(vec3(before, w, j), others)
                at_end = minus(vec3(after, w, j), there)
                start_squared, least_squared = closest_squared_distances(at_start, at_end)
                closest = min(closest, least_squared)
                if is_any(least_squared < far):
                    start = math.sqrt(start_squared)
                    least = math.sqrt(least_squared)
                    # A conflict that lasts began in an earlier decision
                    begun += where(least < d_safe, where(d_safe <= start, 1.0, 0.0), 0.0)
                    depths += min(1.0, max(0.0, (zone - least) / (zone - d_safe)))
            count = min(num_drones - lowest, WIDTH)
            scatter(separation, first, count, math.sqrt(closest))
            scatter(onsets, first, count, begun)
            scatter(nearness, first, count, depths)


def measure_conflict(
    before: np.ndarray, after: np.ndarray, alive: np.ndarray, d_safe: float, zone: float
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
    places = (np.ascontiguousarray(before), np.ascontiguousarray(after))
    fill_conflict(*places, np.ascontiguousarray(alive), d_safe, zone, *result)
    return result
