"""Checks of arrays that callers give."""

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.errors import numbers_of


def check_values(
    name: str, value: ArrayLike, unit: str, least: float = -np.inf, most: float = np.inf
) -> np.ndarray:
    """Check that a value is finite numbers within bounds.

    Args:
        name: What the numbers are, for the message.
        value: A number or an array of any shape.
        unit: Their unit, for the message.
        least: Least number allowed; any finite one when left out.
        most: Greatest number allowed; any finite one when left out.

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: A number is not finite or out of bounds; the first such is named.
    """
    array = numbers_of(f"{name} is", value)
    wrong = array[~(np.isfinite(array) & (array >= least) & (array <= most))]
    if wrong.size:
        bounded = np.isfinite((least, most)).all()
        needed = f"a number from {least:g} to {most:g}" if bounded else "a finite number"
        raise ValueError(f"{name} is {wrong[0]:.10g} {unit}: {needed} is needed")
    return array


def check_vectors(name: str, value: ArrayLike, entries: str) -> np.ndarray:
    """Check that a value is finite vectors along its last axis.

    Args:
        name: What the vectors are, for the message.
        value: One vector (K,), or many (..., K).
        entries: Names of the K entries with commas between, such as "x, y, z".

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: The last axis has another length, or a number is not finite.
    """
    array = numbers_of(f"{name} is", value)
    if array.ndim == 0 or array.shape[-1] != entries.count(",") + 1:
        raise ValueError(f"{name} has shape {array.shape}: a last axis of {entries} is needed")
    if not np.isfinite(array).all():
        wrong = array[~np.isfinite(array).all(axis=-1)][0]
        raise ValueError(f"{name} is {wrong.tolist()}: finite numbers are needed")
    return array
