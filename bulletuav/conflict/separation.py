"""Separation of drones within a decision, and conflicts: separations below d_safe.

A conflict is not a collision, which is a contact of collision shapes.
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
    """Separations of each drone from all others within one decision.

    Attributes:
        separation: (W, N) minimum distance to another active drone, m; inf for a single drone.
        onsets: (W, N) number of other drones with which a conflict started.
        nearness: (W, N) sum over the other drones of the depth in the warning zone, from 0 at its
            edge to 1 at d_safe.
    """

    separation: np.ndarray
    onsets: np.ndarray
    nearness: np.ndarray


def no_conflict(shape: tuple[int, int]) -> Conflict:
    """Make the separations of drones (W, N) without any other drone."""
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
    """Write the result of `measure_conflict` to arrays; it has the same arguments."""
    num_drones = alive.shape[1]
    # Squared radius of the zone, with a margin for rounding errors
    far = (1.0 + 1e-9) * zone * zone
    for w in range(alive.shape[0]):
        # Several drones in lanes, each against all other drones of its world
        for lowest in range(0, num_drones, WIDTH):
            first = w * num_drones + lowest
            here = three(before, first)
            there = three(after, first)
            # Comparisons with NaN are false: a drone that does not fly has no near drone
            x = where(gathered(alive, first, 0), here[0], math.nan)
            itself = lane_numbers() + lowest
            closest, begun, depths = np.inf, 0.0, 0.0
            for j in range(num_drones):
                if not alive[w, j]:
                    continue
                # Minimum separation during the motion, and separation at its start
                others = (where(itself != j, x, math.nan), here[1], here[2])
                at_start = minus(vec3(before, w, j), others)
                at_end = minus(vec3(after, w, j), there)
                start_squared, least_squared = closest_squared_distances(at_start, at_end)
                closest = min(closest, least_squared)
                if is_any(least_squared < far):
                    start = math.sqrt(start_squared)
                    minimum = math.sqrt(least_squared)
                    # An ongoing conflict started in an earlier decision
                    begun += where(minimum < d_safe, where(d_safe <= start, 1.0, 0.0), 0.0)
                    depths += min(1.0, max(0.0, (zone - minimum) / (zone - d_safe)))
            count = min(num_drones - lowest, WIDTH)
            scatter(separation, first, count, math.sqrt(closest))
            scatter(onsets, first, count, begun)
            scatter(nearness, first, count, depths)


def measure_conflict(
    before: np.ndarray, after: np.ndarray, alive: np.ndarray, d_safe: float, zone: float
) -> Conflict:
    """Measure separations while all drones move in straight lines from one position to the next.

    A conflict over several decisions is counted once, in the decision in which the separation falls
    below `d_safe`.

    Args:
        before: (W, N, 3) positions at the start of the decision, m.
        after: (W, N, 3) positions at the end of the decision, m.
        alive: (W, N) bool, the drones to measure.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone starts, m; greater than `d_safe`.

    Returns:
        The separations of each drone.
    """
    result = no_conflict(alive.shape)
    places = (np.ascontiguousarray(before), np.ascontiguousarray(after))
    fill_conflict(*places, np.ascontiguousarray(alive), d_safe, zone, *result)
    return result
