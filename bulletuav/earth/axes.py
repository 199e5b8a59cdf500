"""Conversions between the axes of this package and those of autopilots.

| | world | body | yaw 0 points | positive yaw |
|---|---|---|---|---|
| this package | ENU: east, north, up | FLU: forward, left, up | east | to the left |
| autopilots | NED: north, east, down | FRD: forward, right, down | north | to the right |

Each conversion is its own inverse. Both directions have names, to make calls readable.
"""

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.earth.arrays import check_vectors

HALF_ROOT = 0.5**0.5


def enu_to_ned(vector: ArrayLike) -> np.ndarray:
    """Convert vectors from ENU to NED.

    Args:
        vector: (..., 3) east, north and up, in any unit.

    Returns:
        (..., 3) north, east and down, in the same unit.

    Raises:
        ValueError: If the last axis is not of length 3, or a number is not finite.
    """
    return _swap_world(check_vectors("vector", vector, "east, north, up"))


def ned_to_enu(vector: ArrayLike) -> np.ndarray:
    """Convert vectors from NED to ENU.

    Args:
        vector: (..., 3) north, east and down, in any unit.

    Returns:
        (..., 3) east, north and up, in the same unit.

    Raises:
        ValueError: If the last axis is not of length 3, or a number is not finite.
    """
    return _swap_world(check_vectors("vector", vector, "north, east, down"))


def flu_to_frd(vector: ArrayLike) -> np.ndarray:
    """Convert vectors in body axes, such as angular velocities, from FLU to FRD.

    Args:
        vector: (..., 3) forward, left and up, in any unit.

    Returns:
        (..., 3) forward, right and down, in the same unit.

    Raises:
        ValueError: If the last axis is not of length 3, or a number is not finite.
    """
    return _flip_yz(check_vectors("vector", vector, "forward, left, up"))


def frd_to_flu(vector: ArrayLike) -> np.ndarray:
    """Convert vectors in body axes, such as angular velocities, from FRD to FLU.

    Args:
        vector: (..., 3) forward, right and down, in any unit.

    Returns:
        (..., 3) forward, left and up, in the same unit.

    Raises:
        ValueError: If the last axis is not of length 3, or a number is not finite.
    """
    return _flip_yz(check_vectors("vector", vector, "forward, right, down"))


def attitude_to_ned(quaternion: ArrayLike, scalar_first: bool = False) -> np.ndarray:
    """Convert attitudes from this package's axes to those of autopilots.

    A drone of yaw 0 points east in this package. Its yaw in NED is 90 degrees, as yaw 0 points
    north there.

    Args:
        quaternion: (..., 4) x, y, z, w; rotates body axes (FLU) into world axes (ENU).
        scalar_first: Return w, x, y, z, the order of MAVLink and many autopilots.

    Returns:
        (..., 4) x, y, z, w; rotates body axes (FRD) into world axes (NED). Norms are unchanged.

    Raises:
        ValueError: If the last axis is not of length 4, or a number is not finite.
    """
    attitude = _swap_attitude(check_vectors("quaternion", quaternion, "x, y, z, w"))
    return np.roll(attitude, 1, axis=-1) if scalar_first else attitude


def attitude_to_enu(quaternion: ArrayLike, scalar_first: bool = False) -> np.ndarray:
    """Convert attitudes from the axes of autopilots to this package's axes.

    A drone of yaw 0 points north in NED. Its yaw in this package is 90 degrees, as yaw 0 points
    east.

    Args:
        quaternion: (..., 4) x, y, z, w; rotates body axes (FRD) into world axes (NED).
        scalar_first: The argument is w, x, y, z, the order of MAVLink and many autopilots.

    Returns:
        (..., 4) x, y, z, w; rotates body axes (FLU) into world axes (ENU). Norms are unchanged.

    Raises:
        ValueError: If the last axis is not of length 4, or a number is not finite.
    """
    entries = "w, x, y, z" if scalar_first else "x, y, z, w"
    attitude = check_vectors("quaternion", quaternion, entries)
    return _swap_attitude(np.roll(attitude, -1, axis=-1) if scalar_first else attitude)


def _swap_world(vector: np.ndarray) -> np.ndarray:
    """Swap the first two entries (..., 3) and negate the third."""
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def _flip_yz(vector: np.ndarray) -> np.ndarray:
    """Negate the last two entries (..., 3)."""
    return np.stack([vector[..., 0], -vector[..., 1], -vector[..., 2]], axis=-1)


def _swap_attitude(quaternion: np.ndarray) -> np.ndarray:
    """Rotate both the world axes and the body axes (..., 4): the product s q b.

    s = (1, 1, 0, 0) / sqrt(2) is the half turn about the bisector of east and north, which swaps
    ENU and NED. b = (1, 0, 0, 0), the half turn about forward, swaps FLU and FRD. The sign makes
    the product its own inverse.
    """
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    return HALF_ROOT * np.stack([x + y, x - y, w - z, w + z], axis=-1)
