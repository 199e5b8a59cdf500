"""Axes of this package and of autopilots.

| | world | body | yaw 0 points | yaw turns |
|---|---|---|---|---|
| here | ENU: east, north, up | FLU: forward, left, up | east | to the left |
| autopilots | NED: north, east, down | FRD: forward, right, down | north | to the right |

Each conversion is its own inverse; both have names, so that calls tell what they mean.
"""

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.earth.arrays import check_vectors

HALF_ROOT = 0.5**0.5


def enu_to_ned(vector: ArrayLike) -> np.ndarray:
    """Convert vectors from ENU into NED.

    Args:
        vector: (..., 3) east, north and up, in any unit.

    Returns:
        (..., 3) north, east and down, in the same unit.

    Raises:
        ValueError: The last axis is no triple, or a number is not finite.
    """
    return _swap_world(check_vectors("vector", vector, "east, north, up"))


def ned_to_enu(vector: ArrayLike) -> np.ndarray:
    """Convert vectors from NED into ENU.

    Args:
        vector: (..., 3) north, east and down, in any unit.

    Returns:
        (..., 3) east, north and up, in the same unit.

    Raises:
        ValueError: The last axis is no triple, or a number is not finite.
    """
    return _swap_world(check_vectors("vector", vector, "north, east, down"))


def flu_to_frd(vector: ArrayLike) -> np.ndarray:
    """Convert vectors in body axes, such as angular velocities, from FLU into FRD.

    Args:
        vector: (..., 3) forward, left and up, in any unit.

    Returns:
        (..., 3) forward, right and down, in the same unit.

    Raises:
        ValueError: The last axis is no triple, or a number is not finite.
    """
    return _flip_yz(check_vectors("vector", vector, "forward, left, up"))


def frd_to_flu(vector: ArrayLike) -> np.ndarray:
    """Convert vectors in body axes, such as angular velocities, from FRD into FLU.

    Args:
        vector: (..., 3) forward, right and down, in any unit.

    Returns:
        (..., 3) forward, left and up, in the same unit.

    Raises:
        ValueError: The last axis is no triple, or a number is not finite.
    """
    return _flip_yz(check_vectors("vector", vector, "forward, right, down"))


def attitude_to_ned(quaternion: ArrayLike, scalar_first: bool = False) -> np.ndarray:
    """Convert attitudes of this package into those of autopilots.

    A drone of yaw 0 looks east here. Its yaw in NED is 90 degrees, as yaw 0 looks north there.

    Args:
        quaternion: (..., 4) x, y, z, w; it turns body axes (FLU) into world axes (ENU).
        scalar_first: Return w, x, y, z, as MAVLink and many autopilots have it.

    Returns:
        (..., 4) x, y, z, w; it turns body axes (FRD) into world axes (NED). Lengths stay.

    Raises:
        ValueError: The last axis is not of four, or a number is not finite.
    """
    attitude = _swap_attitude(check_vectors("quaternion", quaternion, "x, y, z, w"))
    return np.roll(attitude, 1, axis=-1) if scalar_first else attitude


def attitude_to_enu(quaternion: ArrayLike, scalar_first: bool = False) -> np.ndarray:
    """Convert attitudes of autopilots into those of this package.

    A drone of yaw 0 looks north in NED. Its yaw here is 90 degrees, as yaw 0 looks east here.

    Args:
        quaternion: (..., 4) x, y, z, w; it turns body axes (FRD) into world axes (NED).
        scalar_first: It is given as w, x, y, z, as MAVLink and many autopilots have it.

    Returns:
        (..., 4) x, y, z, w; it turns body axes (FLU) into world axes (ENU). Lengths stay.

    Raises:
        ValueError: The last axis is not of four, or a number is not finite.
    """
    entries = "w, x, y, z" if scalar_first else "x, y, z, w"
    attitude = check_vectors("quaternion", quaternion, entries)
    return _swap_attitude(np.roll(attitude, -1, axis=-1) if scalar_first else attitude)


def _swap_world(vector: np.ndarray) -> np.ndarray:
    """Exchange the first two entries (..., 3) and turn the third around."""
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def _flip_yz(vector: np.ndarray) -> np.ndarray:
    """Turn the last two entries (..., 3) around."""
    return np.stack([vector[..., 0], -vector[..., 1], -vector[..., 2]], axis=-1)


def _swap_attitude(quaternion: np.ndarray) -> np.ndarray:
    """Turn both the world's axes and the body's (..., 4): the product s q b.

    s = (1, 1, 0, 0) / sqrt(2) is the half turn about the line between east and north that
    exchanges ENU and NED. b = (1, 0, 0, 0), the half turn about forward, exchanges FLU and FRD.
    The sign is such that the product is its own inverse.
    """
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    return HALF_ROOT * np.stack([x + y, x - y, w - z, w + z], axis=-1)
