"""Quaternion algebra of arrays, (x, y, z, w); `rotation` has that of compiled code."""

import numpy as np


def multiply_quaternions(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the Hamilton products p q of quaternions (..., 4)."""
    vector = p[..., 3:] * q[..., :3] + q[..., 3:] * p[..., :3] + np.cross(p[..., :3], q[..., :3])
    scalar = p[..., 3:] * q[..., 3:] - np.sum(p[..., :3] * q[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def rotate_vectors(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    twice = 2 * np.cross(q[..., :3], v)
    turned: np.ndarray = v + q[..., 3:] * twice + np.cross(q[..., :3], twice)
    return turned
