"""Rotation vectors of arrays of quaternions (x, y, z, w)."""

import numpy as np


def to_rotation_vectors(q: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (..., 3), up to pi long, of quaternions (..., 4)."""
    size = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    signed = np.where(q[..., 3:] < 0, -1.0, 1.0)
    angle = 2.0 * np.arctan2(size, np.abs(q[..., 3:]))
    # 2 v is the limit of the angle times the axis for small angles
    factor = np.divide(angle, size, out=np.full_like(size, 2.0), where=size > 1e-9)
    vectors: np.ndarray = signed * factor * q[..., :3]
    return vectors


def from_rotation_vectors(v: np.ndarray) -> np.ndarray:
    """Return the unit quaternions (..., 4) of rotation vectors (..., 3)."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    # sin(a / 2) / a
    half = 0.5 * np.sinc(angle / (2.0 * np.pi))
    return np.concatenate([half * v, np.cos(0.5 * angle)], axis=-1)
