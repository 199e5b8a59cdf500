"""Conversion and validation of the values of AirSim's calls.

AirSim sends vectors and poses as maps of numbers in north, east, down axes, from the start position
of each vehicle.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.earth import attitude_to_enu, attitude_to_ned, enu_to_ned, flu_to_frd
from bulletuav.errors import as_sequence, finite, shown
from bulletuav.geometry.rotation import Quat4, from_euler

MAX_VALUE = 1e5
"""Maximum magnitude of a coordinate (m) or velocity (m/s) in a call"""
MAX_DURATION = 1e9
"""Upper bound to which durations and timeouts are clamped, s; clients send 3e38 for infinity"""


def check_number(name: str, value: Any, max_value: float = MAX_VALUE) -> float:
    """Return a number of a call after validation.

    Args:
        name: Name of the number, for the error message.
        value: Value that the client sent.
        max_value: Maximum magnitude.

    Raises:
        ValueError: If the value is not a finite number, or its magnitude is too large.
    """
    return finite(name, value, -max_value, max_value)


def check_duration(name: str, value: Any) -> float:
    """Return a duration of a call after validation, s, clamped to `MAX_DURATION`.

    Raises:
        ValueError: If the value is not a number, or negative.
    """
    return min(finite(name, value, 0.0), MAX_DURATION)


def check_flag(name: str, value: Any) -> bool:
    """Return a boolean of a call after validation.

    Raises:
        ValueError: If the value is not a boolean; numbers and strings are not converted.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: true or false is needed")
    return value


def check_text(name: str, value: Any) -> str:
    """Return a string of a call after validation.

    Raises:
        ValueError: If the value is not a string.
    """
    if not isinstance(value, str):
        raise ValueError(f"{name} is {shown(value)}: a string is needed")
    return value


def write_vector(array: Any) -> dict[str, float]:
    """Convert a (3,) vector to AirSim's map."""
    return {f"{axis}_val": float(value) for axis, value in zip("xyz", array, strict=True)}


def write_quaternion(array: Any) -> dict[str, float]:
    """Convert a (4,) quaternion x, y, z, w to AirSim's map."""
    return {f"{axis}_val": float(value) for axis, value in zip("xyzw", array, strict=True)}


def read_axes(name: str, value: Any, keys: str) -> np.ndarray:
    """Convert AirSim's map of axes to an array; NaN values are kept.

    Args:
        name: Name of the value, for the error message.
        value: Value that the client sent.
        keys: Axes, such as "xyz".

    Returns:
        One number for each axis.

    Raises:
        ValueError: If the value is not a map of numbers, or a number is too large.
    """
    values = [value.get(f"{key}_val") for key in keys] if isinstance(value, Mapping) else [None]
    if not all(isinstance(number, int | float) for number in values):
        names = ", ".join(f"{key}_val" for key in keys)
        raise ValueError(f"{name} is {shown(value)}: a map of numbers {names} is needed")
    return np.array(
        [math.nan if number != number else check_number(name, number) for number in values]
    )


def read_vector(name: str, value: Any) -> np.ndarray:
    """Convert AirSim's map of x, y, z to an array, (3,).

    Raises:
        ValueError: If the value is not a map of numbers, or a number is not finite.
    """
    array = read_axes(name, value, "xyz")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {shown(value)}: finite numbers are needed")
    return array


def read_pose(value: Any) -> tuple[np.ndarray, np.ndarray]:
    """Convert AirSim's pose to a position and an orientation.

    Args:
        value: Value that the client sent. NaN components leave the vehicle's values unchanged.

    Returns:
        (3,) position, m, and (4,) unit quaternion x, y, z, w.

    Raises:
        ValueError: If the value is not a pose, or its quaternion has zero length.
    """
    if not isinstance(value, Mapping):
        raise ValueError(f"pose is {shown(value)}: a map of position and orientation is needed")
    position = read_axes("position", value.get("position"), "xyz")
    orientation = read_axes("orientation", value.get("orientation"), "xyzw")
    length = math.sqrt(float((orientation * orientation).sum()))
    if length < 1e-3:
        raise ValueError("orientation has zero length: a unit quaternion is needed")
    return position, orientation / length


def yaw_from_airsim(degrees: float) -> float:
    """Convert a yaw from degrees clockwise from north to rad counter-clockwise from east."""
    return math.remainder(math.pi / 2 - math.radians(degrees), math.tau)


def yaw_to_airsim(yaw: float) -> float:
    """Convert a yaw from rad counter-clockwise from east to degrees clockwise from north."""
    return math.degrees(math.remainder(math.pi / 2 - yaw, math.tau))


def write_pose(position: np.ndarray, attitude: Any) -> dict[str, Any]:
    """Convert a pose to AirSim's map.

    Args:
        position: (3,) position east, north, up of the start, m.
        attitude: (4,) quaternion x, y, z, w, body (FLU) to world (ENU).
    """
    return {
        "position": write_vector(enu_to_ned(position)),
        "orientation": write_quaternion(attitude_to_ned(attitude)),
    }


def attitude_from_airsim(orientation: np.ndarray) -> np.ndarray:
    """Convert a quaternion from AirSim's axes (NED, FRD) to those of this package (ENU, FLU).

    Args:
        orientation: (4,) quaternion x, y, z, w.

    Returns:
        (4,) unit quaternion x, y, z, w.
    """
    attitude = attitude_to_enu(orientation)
    return np.asarray(attitude / math.sqrt(float((attitude * attitude).sum())))


def rotation_from_degrees(roll: float, pitch: float, yaw: float) -> Quat4:
    """Convert AirSim's angles of a camera or sensor on a vehicle to a quaternion in FLU axes.

    Args:
        roll: Angle about the forward axis, degrees.
        pitch: Angle about the right axis, upwards, degrees.
        yaw: Angle about the down axis, clockwise from above, degrees.

    Returns:
        Quaternion x, y, z, w from the axes of the part to those of the vehicle.
    """
    return from_euler(math.radians(roll), -math.radians(pitch), -math.radians(yaw))


def swap_rotation(quaternion: Any) -> Quat4:
    """Convert the rotation of a part of a vehicle from FRD to FLU axes, or back.

    Args:
        quaternion: x, y, z, w.
    """
    x, y, z, w = (float(value) for value in quaternion)
    return x, -y, -z, w


def write_mount(position: np.ndarray, rotation: Quat4) -> dict[str, Any]:
    """Convert the pose of a part of a vehicle to AirSim's map.

    Args:
        position: (3,) forward, left, up, m.
        rotation: Quaternion x, y, z, w from the axes of the part (FLU) to those of the vehicle.
    """
    return {
        "position": write_vector(flu_to_frd(position)),
        "orientation": write_quaternion(swap_rotation(rotation)),
    }


def read_text_list(name: str, value: Any, most: int) -> list[str]:
    """Return a list of strings of a call after validation.

    Raises:
        ValueError: If the value is not a list of at most `most` strings.
    """
    return [check_text(name, one) for one in as_sequence(name, value, most=most)]
