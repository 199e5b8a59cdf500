"""Common axes and order of rotors of all quadrotors, for policies that command rotors.

In these axes the rotors are at the front right, back right, back left and front left, and the front
right one spins counterclockwise seen from above, as in `cf2x`. Any quadrotor whose neighbouring
rotors spin in opposite directions has such axes: they are its body axes, rotated about z by up to
90 degrees, such as by 45 degrees if its rotors are on its x and y axes.
"""

import math
from typing import NamedTuple

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.vehicle.airframe import Airframe

TURNS = (-1, 1, -1, 1)
"""Reaction torques of the rotors about z: front right, back right, back left, front left"""
_ANGLES = (-math.pi / 4, -3 * math.pi / 4, 3 * math.pi / 4, math.pi / 4)
"""Angles of the rotors from the x axis, rad"""
_DIGITS = 9
"""Decimals of a yaw in rad, so that axes of symmetric airframes are equal"""


class RotorAxes(NamedTuple):
    """Common axes of a quadrotor.

    Attributes:
        yaw: Angle from the body axes to the common axes, about z, rad.
        order: Index of each rotor of the common order in the airframe.
    """

    yaw: float
    order: tuple[int, ...]


def find_rotor_axes(airframe: Airframe) -> RotorAxes:
    """Find the common axes of a quadrotor, those closest to its body axes.

    Args:
        airframe: The quadrotor.

    Raises:
        ValueError: If the airframe has another number of rotors, or neighbouring rotors spin in the
            same direction.
    """
    rotors = airframe.rotors
    if len(rotors) != 4:
        raise ValueError(
            f"airframe {airframe.name!r} has {len(rotors)} rotors, and this policy flies 4: choose "
            f"another airframe, or train a policy for this one"
        )
    angles = [float(atan2(y, x)) for x, y, _ in rotors]
    clockwise = sorted(range(4), key=lambda k: -angles[k])
    found = []
    for first in range(4):
        order = tuple(clockwise[(first + k) % 4] for k in range(4))
        if tuple(rotors[k][2] for k in order) != TURNS:
            continue
        turned = [angles[k] - angle for k, angle in zip(order, _ANGLES, strict=True)]
        mean = float(atan2(sum(map(float, map(sin, turned))), sum(map(float, map(cos, turned)))))
        found.append(RotorAxes(round(mean, _DIGITS), order))
    if not found:
        raise ValueError(
            f"neighbouring rotors of airframe {airframe.name!r} spin in the same direction, and "
            f"this policy flies quadrotors with alternating directions: train a policy for this one"
        )
    # Of opposite axes at 90 degrees, those to the left
    return min(found, key=lambda one: (abs(one.yaw), -one.yaw))
