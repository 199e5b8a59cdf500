"""Values of AirSim's calls: maps of numbers, in north, east, down from a vehicle's own start."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.earth import attitude_to_enu, attitude_to_ned, enu_to_ned
from bulletuav.errors import finite, shown

MOST = 1e5
"""Greatest size of a coordinate (m) or velocity (m/s) in a call"""
LONGEST = 1e9
"""Durations and timeouts beyond it are cut to it, s; clients send 3e38 for ever"""


def number(name: str, value: Any, most: float = MOST) -> float:
    """Check a number of a call.

    Raises:
        ValueError: It is none, or beyond the bound.
    """
    return finite(name, value, -most, most)


def duration(name: str, value: Any) -> float:
    """Check a duration of a call, s; very long ones are cut.

    Raises:
        ValueError: It is no number, or below 0.
    """
    return min(finite(name, value, 0.0), LONGEST)


def flag(name: str, value: Any) -> bool:
    """Check a truth value of a call.

    Raises:
        ValueError: It is none; numbers and texts are not taken for one.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: true or false is needed")
    return value


def words(name: str, value: Any) -> str:
    """Check a text of a call.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(value, str):
        raise ValueError(f"{name} is {shown(value)}: a text is needed")
    return value


def vector(array: Any) -> dict[str, float]:
    """Write (3,) as a map."""
    return {f"{axis}_val": float(one) for axis, one in zip("xyz", array, strict=True)}


def quaternion(array: Any) -> dict[str, float]:
    """Write (4,) x, y, z, w as a map."""
    return {f"{axis}_val": float(one) for axis, one in zip("xyzw", array, strict=True)}


def numbers_in(name: str, value: Any, keys: str) -> np.ndarray:
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
    found = [value.get(f"{key}_val") for key in keys] if isinstance(value, Mapping) else [None]
    if not all(isinstance(one, int | float) for one in found):
        wanted = ", ".join(f"{key}_val" for key in keys)
        raise ValueError(f"{name} is {shown(value)}: a map of numbers {wanted} is needed")
    return np.array([math.nan if one != one else number(name, one) for one in found])


def vector_in(name: str, value: Any) -> np.ndarray:
    """Read a map of x, y, z.

    Raises:
        ValueError: It is none, or a number is not finite.
    """
    array = numbers_in(name, value, "xyz")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {shown(value)}: finite numbers are needed")
    return array


def pose_in(value: Any) -> tuple[np.ndarray, np.ndarray]:
    """Read a pose: (3,) and (4,) x, y, z, w; what is NaN is to stay as it is.

    Raises:
        ValueError: It is no pose, or its orientation has no length.
    """
    if not isinstance(value, Mapping):
        raise ValueError(f"pose is {shown(value)}: a map of position and orientation is needed")
    place = numbers_in("position", value.get("position"), "xyz")
    turn = numbers_in("orientation", value.get("orientation"), "xyzw")
    length = math.sqrt(float((turn * turn).sum()))
    if length < 1e-3:
        raise ValueError("orientation has no length: a unit quaternion is needed")
    return place, turn / length


def yaw_in(degrees: float) -> float:
    """Convert a yaw, clockwise from north in degrees, into one counter-clockwise from east, rad."""
    return math.remainder(math.pi / 2 - math.radians(degrees), math.tau)


def yaw_out(yaw: float) -> float:
    """Convert a yaw, counter-clockwise from east in rad, into one clockwise from north, degrees."""
    return math.degrees(math.remainder(math.pi / 2 - yaw, math.tau))


def pose_of(position: np.ndarray, attitude: Any) -> dict[str, Any]:
    """Write a pose.

    Args:
        position: (3,) east, north, up of the start, m.
        attitude: (4,) body to world, here.
    """
    return {
        "position": vector(enu_to_ned(position)),
        "orientation": quaternion(attitude_to_ned(attitude)),
    }


def attitude_of(turn: np.ndarray) -> np.ndarray:
    """Convert an orientation of AirSim into an attitude here, both (4,) x, y, z, w."""
    attitude = attitude_to_enu(turn)
    return np.asarray(attitude / math.sqrt(float((attitude * attitude).sum())))
