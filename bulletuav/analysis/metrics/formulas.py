"""Formulas of metrics that are nowhere else in the package."""

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.geometry.closest_approach import offset
from bulletuav.geometry.rotation import dot


def jain(values: np.ndarray) -> float:
    """Compute Jain's index of fairness, (sum x)^2 / (n sum x^2).

    R. Jain, D. Chiu, W. Hawe, A quantitative measure of fairness and discrimination, DEC TR-301,
    1984.

    Args:
        values: Numbers (n,) that are not negative.

    Returns:
        1 when all are equal, or all are zero; 1/n when one has everything.
    """
    total, square = float(values.sum()), len(values) * float((values * values).sum())
    # A product, as powers are rounded otherwise by other C libraries
    return total * total / square if square > 0 else 1.0


@allocating
def soonest_conflict(
    position: np.ndarray, velocity: np.ndarray, alive: np.ndarray, d_safe: float
) -> np.ndarray:
    """Compute the shortest time to a conflict of two drones that fly straight on.

    Two points are `d_safe` apart where |gap + speed t| = d_safe; the smaller root is taken.

    Args:
        position: Positions (W, N, 3), m.
        velocity: Velocities (W, N, 3), m/s.
        alive: Drones that count, (W, N) bool.
        d_safe: Separation below which there is a conflict, m.

    Returns:
        Times (W,), s: 0 where two are in conflict already, inf where no two will be.
    """
    result = np.full(alive.shape[0], np.inf)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            for j in range(i + 1, alive.shape[1]):
                if not (alive[w, i] and alive[w, j]):
                    continue
                # Relative position and velocity of drone j as drone i sees them.
                gap = offset(position, w, i, j)
                speed = offset(velocity, w, i, j)
                # Coefficients of the quadratic equation in time, and its discriminant.
                along = dot(gap, speed)
                outside = dot(gap, gap) - d_safe * d_safe
                root = along * along - dot(speed, speed) * outside
                if outside < 0.0:
                    result[w] = 0.0
                elif along < 0.0 and root > 0.0:
                    # This form of the smaller root does not cancel.
                    result[w] = min(result[w], outside / (np.sqrt(root) - along))
    return result
