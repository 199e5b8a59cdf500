"""Cameras of AirSim's vehicles: names, poses, image sizes and fields of view."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_settings import CameraSettings, Capture, MountPose
from bulletuav.bridges.airsim_values import rotation_from_degrees
from bulletuav.errors import shown, unknown
from bulletuav.geometry.rotation import Quat4, product, to_world
from bulletuav.vehicle.airframe import Airframe

CAMERA_YAWS = {
    "front_center": 0.0,
    "front_right": 30.0,
    "front_left": -30.0,
    "bottom_center": None,
    "back_center": 180.0,
}
"""Yaw of each camera, degrees clockwise from forward; None for the camera that looks down"""
CAMERA_NUMBERS = {str(k): name for k, name in enumerate(CAMERA_YAWS)}
"""Names of the cameras by the numbers that older clients use"""
SCENE = 0
"""AirSim's image type of colours"""


class AirsimCamera:
    """Camera of a vehicle, or one that stands in the world.

    Attributes:
        mount: Pose on the vehicle, or in the world.
    """

    def __init__(self, mount: MountPose, captures: Mapping[int, Capture]) -> None:
        """Create a camera.

        Args:
            mount: Pose on the vehicle, or in the world.
            captures: Settings by image type.
        """
        self.mount, self._captures = mount, dict(captures)

    def get_capture(self, kind: int) -> Capture:
        """Return the settings of an image type."""
        return self._captures.get(kind, Capture())

    def set_field_of_view(self, angle: float) -> None:
        """Set the horizontal field of view of all image types, rad."""
        for kind in range(12):
            self._captures[kind] = self.get_capture(kind)._replace(field_of_view=angle)

    def compute_pose(self, position: Any, attitude: Any) -> tuple[np.ndarray, Quat4]:
        """Return the pose of the camera in the world, given that of its vehicle.

        Args:
            position: (3,) position of the vehicle, m.
            attitude: (4,) quaternion x, y, z, w of the vehicle, body to world.

        Returns:
            Position (3,), m, and quaternion, camera (FLU) to world.
        """
        offset, rotation = self.mount
        return position + to_world(attitude, offset), product(attitude, rotation)

    def compute_projection(self) -> list[list[float]]:
        """Return the projection matrix of the scene, as AirSim's `ProjectionMatrix`.

        Returns:
            (4, 4) matrix from the camera's axes north (forward), east (right), down to clip space,
            with an infinite far plane and reversed depth, as Unreal's renderer has it.
        """
        (width, height), angle = self.get_capture(SCENE)
        scale = 1 / math.tan(angle / 2)
        near = 0.1
        return [
            [0.0, scale, 0.0, 0.0],
            [0.0, 0.0, -scale * width / height, 0.0],
            [0.0, 0.0, 0.0, near],
            [1.0, 0.0, 0.0, 0.0],
        ]


def make_cameras(
    airframe: Airframe, defaults: CameraSettings, own: Mapping[str, CameraSettings]
) -> dict[str, AirsimCamera]:
    """Return the cameras of a vehicle: AirSim's five, and those of the settings.

    Args:
        airframe: Airframe of the vehicle.
        defaults: Settings of cameras that the vehicle does not list.
        own: Settings of the vehicle's cameras by name or number.

    Raises:
        ValueError: If two names are those of the same camera.
    """
    listed: dict[str, CameraSettings] = {}
    for given, one in own.items():
        name = resolve_name(given)
        if name in listed:
            raise ValueError(
                f"camera {shown(given)} is listed twice, as it is {shown(name)}: leave one out"
            )
        listed[name] = one
    return {
        name: _make_camera(airframe, CAMERA_YAWS.get(name, 0.0), listed.get(name, defaults))
        for name in dict.fromkeys([*CAMERA_YAWS, *listed])
    }


def resolve_name(name: str) -> str:
    """Return the name of a camera: numbers and dashes are other names of AirSim's five."""
    plain = name.replace("-", "_")
    plain = CAMERA_NUMBERS.get(plain, plain)
    return plain if plain in CAMERA_YAWS else name


def make_external_cameras(settings: Mapping[str, CameraSettings]) -> dict[str, AirsimCamera]:
    """Return cameras that stand in the world; by default at its origin, and look north."""
    cameras = {}
    for name, one in settings.items():
        north, east, down = np.nan_to_num(np.array(one.position)).tolist()
        roll, pitch, yaw = np.nan_to_num(np.array(one.angles)).tolist()
        # An attitude of yaw 0 faces north, whose yaw is 90 degrees here
        rotation = rotation_from_degrees(roll, pitch, yaw - 90.0)
        cameras[name] = AirsimCamera(
            MountPose(np.array((east, north, -down)), rotation), one.captures
        )
    return cameras


def _make_camera(airframe: Airframe, yaw: float | None, settings: CameraSettings) -> AirsimCamera:
    """Return a camera of a vehicle.

    Args:
        airframe: Airframe of the vehicle.
        yaw: Default yaw, degrees clockwise from forward; None to look down.
        settings: Settings of the camera.
    """
    if yaw is None:
        # The top of the image points forward
        position, angles = np.array((0.0, 0.0, -airframe.standing_height)), (0.0, -90.0, 0.0)
    else:
        radius, angle = airframe.collision_radius, math.radians(yaw)
        position = np.array((radius * math.cos(angle), -radius * math.sin(angle), 0.0))
        angles = (0.0, 0.0, yaw)
    given = np.array(settings.position) * (1.0, -1.0, -1.0)
    position = np.where(np.isfinite(given), given, position)
    chosen = np.where(np.isfinite(settings.angles), settings.angles, angles).tolist()
    return AirsimCamera(MountPose(position, rotation_from_degrees(*chosen)), settings.captures)


def find_camera(cameras: Mapping[str, AirsimCamera], name: str) -> AirsimCamera:
    """Return a camera by its name or number; dashes also stand for underscores.

    Raises:
        ValueError: If there is no such camera.
    """
    # Names of external cameras are those of the file, and may be numbers
    names = (name, name.replace("-", "_"), resolve_name(name))
    found = next((cameras[one] for one in names if one in cameras), None)
    if found is None:
        if not cameras:
            raise ValueError(
                f"camera {shown(name)} does not stand in the world: list it as one of "
                f"ExternalCameras in the settings file, or leave external out"
            )
        numbers = [number for number, known in CAMERA_NUMBERS.items() if known in cameras]
        raise unknown("camera", name, [*cameras, *numbers])
    return found
