"""Values of AirSim's calls: maps of numbers, in north, east, down from a vehicle's own start."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.earth import attitude_to_enu, attitude_to_ned, enu_to_ned
from bulletuav.errors import finite, shown

MAX_VALUE = 1e5
"""Greatest size of a coordinate (m) or velocity (m/s) in a call"""
MAX_DURATION = 1e9
"""Durations and timeouts beyond it are cut to it, s; clients send 3e38 for ever"""


def check_number(name: str, value: Any, max_value: float = MAX_VALUE) -> float:
    """Check a number of a call.

    Raises:
        ValueError: It is none, or beyond the bound.
    """
    return finite(name, value, -max_value, max_value)


def check_duration(name: str, value: Any) -> float:
    """Check a duration of a call, s; very long ones are cut.

    Raises:
        ValueError: It is no number, or below 0.
    """
    return min(finite(name, value, 0.0), MAX_DURATION)


def check_flag(name: str, value: Any) -> bool:
    """Check a truth value of a call.

    Raises:
        ValueError: It is none; numbers and texts are not taken for one.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: true or false is needed")
    return value


def check_text(name: str, value: Any) -> str:
    """Check a text of a call.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(value, str):
        raise ValueError(f"{name} is {shown(value)}: a text is needed")
    return value


def write_vector(array: Any) -> dict[str, float]:
    """Write (3,) as a map."""
    return {f"{axis}_val": float(value) for axis, value in zip("xyz", array, strict=True)}


def write_quaternion(array: Any) -> dict[str, float]:
    """Write (4,) x, y, z, w as a map."""
    return {f"{axis}_val": float(value) for axis, value in zip("xyzw", array, strict=True)}


def read_axes(name: str, value: Any, keys: str) -> np.ndarray:
    """Read a map with an entry for each axis; those that are NaN stay so.

    Args:
        name: What it is, for the message.
        value: What was sent.
        keys: Axes, such as "xyz".

    Returns:
        One number an axis.

    Raises:
        ValueError: It is no map of numbers, or a number is too large.
    """
    values = [value.get(f"{key}_val") for key in keys] if isinstance(value, Mapping) else [None]
    if not all(isinstance(number, int | float) for number in values):
        names = ", ".join(f"{key}_val" for key in keys)
        raise ValueError(f"{name} is {shown(value)}: a map of numbers {names} is needed")
    return np.array(
        [math.nan if number != number else check_number(name, number) for number in values]
    )


def read_vector(name: str, value: Any) -> np.ndarray:
    """Read a map of x, y, z.

    Raises:
        ValueError: It is none, or a number is not finite.
    """
    array = read_axes(name, value, "xyz")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {shown(value)}: finite numbers are needed")
    return array


def read_pose(value: Any) -> tuple[np.ndarray, np.ndarray]:
    """Read a pose: (3,) and (4,) x, y, z, w; what is NaN is to stay as it is.

    Raises:
        ValueError: It is no pose, or its orientation has no length.
    """
    if not isinstance(value, Mapping):
        raise ValueError(f"pose is {shown(value)}: a map of position and orientation is needed")
    position = read_axes("position", value.get("position"), "xyz")
    orientation = read_axes("orientation", value.get("orientation"), "xyzw")
    length = math.sqrt(float((orientation * orientation).sum()))
    if length < 1e-3:
        raise ValueError("orientation has no length: a unit quaternion is needed")
    return position, orientation / length


def yaw_from_airsim(degrees: float) -> float:
    """Convert a yaw, clockwise from north in degrees, into one counter-clockwise from east, rad."""
    return math.remainder(math.pi / 2 - math.radians(degrees), math.tau)


def yaw_to_airsim(yaw: float) -> float:
    """Convert a yaw, counter-clockwise from east in rad, into one clockwise from north, degrees."""
    return math.degrees(math.remainder(math.pi / 2 - yaw, math.tau))


def write_pose(position: np.ndarray, attitude: Any) -> dict[str, Any]:
    """Write a pose.

    Args:
        position: (3,) east, north, up of the start, m.
        attitude: (4,) body to world, here.
    """
    return {
        "position": write_vector(enu_to_ned(position)),
        "orientation": write_quaternion(attitude_to_ned(attitude)),
    }


def attitude_from_airsim(orientation: np.ndarray) -> np.ndarray:
    """Convert an orientation of AirSim into an attitude here, both (4,) x, y, z, w."""
    attitude = attitude_to_enu(orientation)
    return np.asarray(attitude / math.sqrt(float((attitude * attitude).sum())))
