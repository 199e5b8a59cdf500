"""Checks of arrays that callers pass."""

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.errors import numbers_of


def check_values(
    name: str, value: ArrayLike, unit: str, low: float = -np.inf, high: float = np.inf
) -> np.ndarray:
    """Check that all numbers of a value are finite and within bounds.

    Args:
        name: Name of the value, for the message.
        value: A number or an array of any shape.
        unit: Unit of the numbers, for the message.
        low: Minimum number.
        high: Maximum number.

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: If a number is not finite or out of bounds; the message names the first one.
    """
    array = numbers_of(f"{name} is", value)
    wrong = array[~(np.isfinite(array) & (array >= low) & (array <= high))]
    if wrong.size:
        bounded = np.isfinite((low, high)).all()
        needed = f"a number from {low:g} to {high:g}" if bounded else "a finite number"
        raise ValueError(f"{name} is {wrong[0]:.10g} {unit}: {needed} is needed")
    return array


def check_vectors(name: str, value: ArrayLike, entries: str) -> np.ndarray:
    """Check that a value consists of finite vectors along its last axis.

    Args:
        name: Name of the value, for the message.
        value: One vector (K,), or many (..., K).
        entries: Names of the K entries, separated by commas, such as "x, y, z".

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: If the last axis has another length, or a number is not finite.
    """
    array = numbers_of(f"{name} is", value)
    if array.ndim == 0 or array.shape[-1] != entries.count(",") + 1:
        raise ValueError(f"{name} has shape {array.shape}: a last axis of {entries} is needed")
    if not np.isfinite(array).all():
        wrong = array[~np.isfinite(array).all(axis=-1)][0]
        raise ValueError(f"{name} is {wrong.tolist()}: finite numbers are needed")
    return array
