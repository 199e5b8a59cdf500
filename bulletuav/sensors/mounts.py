"""Mounts of the drones' cameras: direction, position and gimbal."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import as_sequence, finite, shown, unknown
from bulletuav.geometry.rotation import Quat4, from_euler

MAX_CAMERAS = 16
"""Maximum number of cameras of a drone"""
MAX_OFFSET = 10.0
"""Maximum distance of a camera from the centre of mass along each axis, m"""


@dataclasses.dataclass(frozen=True)
class Mount:
    """Mount of a camera on a drone. Angles of 0 look along the drone's x axis.

    Attributes:
        pitch: Angle above the drone's xy plane, degrees; -90 looks down. Signs are those of
            MAVLink's gimbals.
        yaw: Angle to the left, degrees.
        roll: Rotation about the view axis, degrees; the right side of the camera goes down.
        offset: Position (3,) in body axes, m; None for the front of the drone, its collision radius
            ahead of the centre of mass.
        stabilized: Whether a gimbal levels the camera: angles are relative to the drone's heading
            and the horizon. The position stays fixed to the body.
    """

    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0
    offset: tuple[float, float, float] | None = None
    stabilized: bool = False

    def __post_init__(self) -> None:
        for name, most in {"pitch": 90.0, "yaw": 180.0, "roll": 180.0}.items():
            angle = finite(f"camera_mounts: {name}", getattr(self, name), -most, most)
            object.__setattr__(self, name, angle)
        if self.offset is not None:
            label = "camera_mounts: offset"
            given = as_sequence(label, self.offset, 3)
            offset = tuple(finite(label, one, -MAX_OFFSET, MAX_OFFSET) for one in given)
            object.__setattr__(self, "offset", offset)
        if not isinstance(self.stabilized, bool):
            raise ValueError(
                f"camera_mounts: stabilized is {shown(self.stabilized)}: True or False is needed"
            )

    @property
    def quaternion(self) -> Quat4:
        """Attitude of the camera relative to the drone."""
        roll, pitch, yaw = map(math.radians, (self.roll, self.pitch, self.yaw))
        return from_euler(roll, -pitch, yaw)


FORWARD = Mount()
"""A camera that looks forward from the front of the drone"""
Mounts = Mount | tuple[Mount, ...]
"""One camera, or several, whose pictures get a dimension of their own"""


def as_mounts(value: Any) -> Mounts:
    """Convert the option `camera_mounts`: None, a dict of `Mount`'s attributes, or several dicts.

    Raises:
        ValueError: If a name or a value is invalid.
    """
    if value is None:
        return FORWARD
    if isinstance(value, Mapping):
        known = [one.name for one in dataclasses.fields(Mount)]
        for name in value:
            if name not in known:
                raise unknown("camera_mounts: name", name, known)
        return Mount(**value)
    mounts = as_sequence("camera_mounts", value, most=MAX_CAMERAS)
    if not mounts:
        raise ValueError("camera_mounts is empty: leave it out for a camera that looks forward")
    return tuple(_as_mount(one) for one in mounts)


def _as_mount(value: Any) -> Mount:
    """Convert the mount of one of several cameras."""
    mount = as_mounts(value) if isinstance(value, Mapping) else None
    if not isinstance(mount, Mount):
        raise ValueError(
            f"camera_mounts has {shown(value)}: a dict such as {{'pitch': -90}} is needed"
        )
    return mount
