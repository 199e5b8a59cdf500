"""Whitening of prediction errors, so that each error counts according to its information."""

from collections.abc import Sequence

import numpy as np

from bulletuav.identification.errors import PredictionErrors

Weights = tuple[np.ndarray, np.ndarray]
"""Whitening matrices of positions and velocities, (3, 10, 10), and of attitudes and rates"""
MIN_DIAGONAL_FRACTION = 0.05
"""Minimum weight of the diagonal in the shrunk covariance"""


def whiten(errors: PredictionErrors, weights: Weights) -> np.ndarray:
    """Return errors with approximately unit covariance.

    Args:
        errors: Errors of K windows.
        weights: Whitening matrices.

    Returns:
        Whitened errors, (K, E).
    """
    parts = []
    for values, weight in zip(_group_by_axis(errors), weights, strict=True):
        parts.append(np.einsum("aij,akj->kai", weight, values).reshape(values.shape[1], -1))
    return np.concatenate(parts, axis=1)


def _group_by_axis(errors: PredictionErrors) -> tuple[np.ndarray, np.ndarray]:
    """Group the errors that are whitened together, those of one axis, (3, K, E)."""
    found = []
    for values in (errors.translation, errors.rotation):
        size = len(values)
        split = values.reshape(size, -1, 2, 3)
        found.append(np.moveaxis(split, 3, 0).reshape(3, size, -1))
    return found[0], found[1]


def compute_weights(errors: Sequence[PredictionErrors]) -> Weights:
    """Compute whitening matrices from the robust covariance of errors, shrunk to its diagonal."""
    found = []
    for values in zip(*map(_group_by_axis, errors), strict=True):
        joined = np.concatenate(values, axis=1)
        matrices = []
        for axis in joined:
            middle = np.median(axis, axis=0)
            deviation = 1.4826 * np.median(np.abs(axis - middle), axis=0)
            deviation = np.maximum(deviation, 1e-3 * deviation.max() + 1e-12)
            clipped = np.clip((axis - middle) / deviation, -3, 3)
            count, size = clipped.shape
            covariance = clipped.T @ clipped / count
            fraction = max(MIN_DIAGONAL_FRACTION, size / (count + size))
            covariance = (1 - fraction) * covariance + fraction * np.diag(np.diag(covariance))
            matrices.append(np.linalg.inv(np.linalg.cholesky(covariance)) / deviation)
        found.append(np.array(matrices))
    return found[0], found[1]
