"""Measures of conflict between two drones, from their offset and relative velocity; all pairs of a swarm in one call.

Arrays end in 3 and broadcast: for all pairs of positions (..., N, 3) use `offsets`. SI units.
"""

import numpy as np
from scipy.stats import chi2, ncx2


def offsets(position: np.ndarray) -> np.ndarray:
    """(..., N, N, 3) from drone i to drone j of (..., N, 3)."""
    return position[..., None, :, :] - position[..., :, None, :]


def in_cylinder(offset: np.ndarray, horizontal: float, vertical: float) -> np.ndarray:
    """Whether both the horizontal and the vertical separation are below their limits (m), as air traffic counts it."""
    return (np.hypot(offset[..., 0], offset[..., 1]) < horizontal) & (np.abs(offset[..., 2]) < vertical)


def closest_point_of_approach(offset: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Time (s, 0 when they part already) and distance (m) of the closest approach, both flying straight on.

    offset, velocity (..., 3): of the other relative to the one, m, m/s.
    """
    square = (velocity**2).sum(axis=-1)
    along = -(offset * velocity).sum(axis=-1)
    time = np.maximum(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0.0)
    return time, np.linalg.norm(offset + velocity * time[..., None], axis=-1)


def time_to_conflict(offset: np.ndarray, velocity: np.ndarray, d_safe: float) -> np.ndarray:
    """Seconds until the distance of two that fly straight on falls below `d_safe` (m): 0 inside already, inf when never."""
    square = (velocity**2).sum(axis=-1)
    along = (offset * velocity).sum(axis=-1)
    outside = (offset**2).sum(axis=-1) - d_safe**2
    root = along**2 - square * outside
    meets = (along < 0) & (root > 0)
    # The smaller root, as outside / (-along + sqrt(root)): it does not cancel where the two pass slowly.
    time = np.divide(outside, -along + np.sqrt(np.maximum(root, 0.0)), out=np.full(root.shape, np.inf), where=meets)
    return np.where(outside < 0, 0.0, time)


def conflict_probability(offset: np.ndarray, sigma: np.ndarray | float, d_safe: float) -> np.ndarray:
    """Probability that two are closer than `d_safe` (m) whose offset is known with an error of `sigma` (m) on each axis.

    sigma^2 is the sum of both variances; square distance over sigma^2 is noncentral chi-square with 3 degrees of freedom.
    """
    scale = np.asarray(sigma, dtype=float) ** 2
    return ncx2.cdf(d_safe**2 / scale, 3, (offset**2).sum(axis=-1) / scale)


def conflict_probability_of(offset: np.ndarray, covariance: np.ndarray, d_safe: float, tolerance: float = 1e-9) -> float:
    """As `conflict_probability` for one offset (3,) whose error has any covariance (3, 3), m^2, to within `tolerance`.

    The series of H. Ruben (1962) for a quadratic form in normal variables: a mixture of central chi-square ones with
    positive weights, so what a truncation leaves out is at most the missing weight times the next distribution function.
    """
    scales, directions = np.linalg.eigh(covariance)
    if scales[0] <= 0:
        raise ValueError(f"covariance {np.asarray(covariance).tolist()} is not positive definite")
    shift = (directions.T @ offset) ** 2 / scales
    beta = scales[0]
    gamma = 1 - beta / scales
    weights = [float(np.exp(-0.5 * shift.sum()) * np.prod(np.sqrt(beta / scales)))]
    slopes: list[float] = []
    total = weights[0] * chi2.cdf(d_safe**2 / beta, 3)
    missing = 1 - weights[0]
    while missing * chi2.cdf(d_safe**2 / beta, 3 + 2 * len(weights)) > tolerance:
        k = len(weights)
        slopes.append(0.5 * float((gamma**k + k * shift * gamma ** (k - 1) * (1 - gamma)).sum()))
        weights.append(float(np.dot(slopes[::-1], weights)) / k)
        total += weights[-1] * chi2.cdf(d_safe**2 / beta, 3 + 2 * k)
        missing -= weights[-1]
    return float(total)
