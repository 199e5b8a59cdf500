"""Formulas of metrics."""

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.rotation import dot


def jain(values: np.ndarray) -> float:
    """Compute Jain's fairness index, (sum x)^2 / (n sum x^2).

    Args:
        values: Non-negative numbers, (n,).

    Returns:
        1 if all numbers are equal, or all are zero; 1/n if all but one are zero.

    References:
        R. Jain, D. Chiu, W. Hawe, A quantitative measure of fairness and discrimination, DEC
        TR-301, 1984.
    """
    total, square = float(values.sum()), len(values) * float((values * values).sum())
    # A product instead of a power, whose rounding differs between C libraries
    return total * total / square if square > 0 else 1.0


@allocating
def soonest_conflict(
    position: np.ndarray, velocity: np.ndarray, alive: np.ndarray, d_safe: float
) -> np.ndarray:
    """Compute the shortest time to a conflict of any two drones at constant velocity.

    Two points are `d_safe` apart where |p + v t| = d_safe, with their relative position p and
    velocity v; the smaller root is the start of the conflict.

    Args:
        position: Positions, (W, N, 3), m.
        velocity: Velocities, (W, N, 3), m/s.
        alive: Mask of the drones to consider, (W, N) bool.
        d_safe: Separation below which two drones are in conflict, m.

    Returns:
        Times, (W,), s: 0 if two drones are in conflict already, inf if there will be no conflict.
    """
    result = np.full(alive.shape[0], np.inf)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                # Position and velocity of drone j relative to drone i.
                gap = offset(position, w, i, j)
                speed = offset(velocity, w, i, j)
                # Coefficients of the quadratic equation in time, and its discriminant.
                along = dot(gap, speed)
                outside = dot(gap, gap) - d_safe * d_safe
                root = along * along - dot(speed, speed) * outside
                if outside < 0.0:
                    result[w] = 0.0
                elif along < 0.0 and root > 0.0:
                    # This form of the smaller root avoids cancellation.
                    result[w] = min(result[w], outside / (np.sqrt(root) - along))
    return result
