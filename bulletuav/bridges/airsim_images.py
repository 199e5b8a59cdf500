"""Pictures as AirSim's clients ask for them: cameras, kinds, and bytes."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from bulletuav.bridges.airsim_values import flag, pose_of, words
from bulletuav.bridges.airsim_world import World
from bulletuav.errors import as_int, shown, unknown
from bulletuav.geometry.rotation import Quat4, from_euler, product, to_world
from bulletuav.geometry.view import CameraMatrices, Picture

SIZE = (256, 144)
"""Width and height, pixels, as in AirSim's default settings"""
WIDTH_ANGLE = math.radians(90)
"""Horizontal field of view"""
FARTHEST = 100.0
"""Depth that is white where depths are grey, m"""
SCENE, PLANAR, PERSPECTIVE, GREY, SEGMENTATION = 0, 1, 2, 3, 5
COLOURS = np.array(
    [(135, 206, 235), (80, 120, 60), (150, 150, 150), (220, 60, 50), (60, 90, 220)], dtype=np.uint8
)
"""Colours of the labels sky, land, building, obstacle, drone"""
YAWS = {
    "front_center": 0.0,
    "front_right": -30.0,
    "front_left": 30.0,
    "bottom_center": None,
    "back_center": 180.0,
}
"""Cameras, with the yaw in which they look, degrees to the left; None for down"""
NUMBERS = {str(k): name for k, name in enumerate(YAWS)}
"""Their numbers, as older clients call them"""


def mount(
    world: World,
    i: int,
    camera: str,
) -> tuple[np.ndarray, Quat4]:
    """Tell where a camera is on a drone.

    Args:
        world: The vehicles.
        i: Index of the drone.
        camera: Name or number.

    Returns:
        Position (3,), m, and quaternion, both in body axes.

    Raises:
        ValueError: There is no such camera.
    """
    name, frame = NUMBERS.get(camera, camera), world.airspace.airframes[i]
    if name not in YAWS:
        raise unknown("camera", camera, [*YAWS, *NUMBERS])
    yaw, out = YAWS[name], frame.collision_radius
    if yaw is None:
        # Up in the picture is ahead.
        return np.array((0.0, 0.0, -frame.standing_height)), from_euler(0.0, math.pi / 2, 0.0)
    angle = math.radians(yaw)
    return np.array((out * math.cos(angle), out * math.sin(angle), 0.0)), from_euler(0, 0, angle)


class Request:
    """One picture that is asked for.

    Attributes:
        camera: Name or number.
        kind: Number of the image type.
        as_float: Whether pixels are to be numbers.
        compress: Whether bytes are to be a PNG.
    """

    def __init__(self, given: Any) -> None:
        """Read a request.

        Raises:
            ValueError: It is none, or of a kind that there is not.
        """
        if not isinstance(given, Mapping):
            raise ValueError(f"image request is {shown(given)}: a map is needed")
        self.camera = words("camera_name", given.get("camera_name"))
        self.kind = as_int("image_type", given.get("image_type"), 0, 11)
        self.as_float = flag("pixels_as_float", given.get("pixels_as_float", False))
        self.compress = flag("compress", given.get("compress", False))
        if self.kind not in (SCENE, PLANAR, PERSPECTIVE, GREY, SEGMENTATION):
            raise ValueError(
                f"image_type is {self.kind}: there are 0 (scene), 1, 2, 3 (depth) and 5 "
                f"(segmentation)"
            )
        if self.as_float and self.kind in (SCENE, SEGMENTATION):
            raise ValueError("pixels_as_float is for depths: ask for image_type 1, 2 or 3")


class Sight(NamedTuple):
    """What a camera sees at a time.

    Attributes:
        shot: What is to be drawn.
        pose: Position and orientation of the camera, as AirSim writes them.
        time_stamp: ns.
    """

    shot: CameraMatrices
    pose: dict[str, Any]
    time_stamp: int


class Exposure(NamedTuple):
    """Everything about a picture except its pixels.

    Attributes:
        request: What is asked for.
        sight: What the camera sees.
    """

    request: Request
    sight: Sight


def expose(world: World, i: int, requests: Sequence[Request]) -> list[Exposure]:
    """Note what cameras see now, to be drawn later.

    Args:
        world: The vehicles.
        i: Index of the drone that carries the cameras.
        requests: What is asked for.

    Raises:
        ValueError: There is no such camera.
    """
    cameras = dict.fromkeys(one.camera for one in requests)
    sights = {camera: _sight(world, i, camera) for camera in cameras}
    return [Exposure(one, sights[one.camera]) for one in requests]


def _sight(world: World, i: int, camera: str) -> Sight:
    """Note what a camera sees now."""
    place, turn = mount(world, i, camera)
    # AirSim tells the angle across the picture; `picture` takes the one up and down
    width, height = SIZE
    angle = math.degrees(2 * math.atan(math.tan(WIDTH_ANGLE / 2) * height / width))
    shot = world.airspace.shot(i, place.tolist(), turn, None, SIZE, angle)
    # Places are told from where the vehicle started
    swarm = world.airspace.swarm
    body = swarm.quaternion[i]
    start = list(world.vehicles.values())[i].start
    where = swarm.position[i] + to_world(body, place) - start
    return Sight(shot, pose_of(where, product(body, turn)), round(world.time * 1e9))


def response(exposure: Exposure, picture: Picture) -> dict[str, Any]:
    """Write a picture as AirSim does.

    Args:
        exposure: What was asked for.
        picture: What was drawn of it.

    Returns:
        The map of an ImageResponse.
    """
    request, sight = exposure
    width, height = sight.shot.size
    # Depths in m, as numbers
    numbers: list[float] = []
    content = b""
    if request.as_float:
        values = picture.depth
        # From distances along the axis to those along each pixel's ray
        if request.kind == PERSPECTIVE:
            values = values * _stretch()
        elif request.kind == GREY:
            values = np.clip(values / FARTHEST, 0.0, 1.0)
        numbers = values.ravel().astype(float).tolist()
    else:
        # Colours, labels, or depths as shades of grey
        pixels = picture.pixels
        if request.kind == SEGMENTATION:
            pixels = COLOURS[picture.labels]
        elif request.kind != SCENE:
            grey = np.clip(255 * picture.depth / FARTHEST, 0, 255).astype(np.uint8)
            pixels = np.repeat(grey[:, :, None], 3, axis=2)
        # Uncompressed pixels are blue, green, red, as Unreal writes them
        content = png(pixels) if request.compress else pixels[:, :, ::-1].tobytes()
    # Names and types that AirSim's own clients unpack
    return {
        "image_data_uint8": content,
        "image_data_float": numbers,
        "camera_name": request.camera,
        "camera_position": sight.pose["position"],
        "camera_orientation": sight.pose["orientation"],
        "time_stamp": sight.time_stamp,
        "message": "",
        "pixels_as_float": request.as_float,
        "compress": request.compress,
        "width": width,
        "height": height,
        "image_type": request.kind,
    }


def png(pixels: np.ndarray) -> bytes:
    """Write pixels (H, W, 3) uint8 as a PNG."""
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, "PNG")
    return file.getvalue()


def _stretch() -> np.ndarray:
    """Tell how much longer the ray of each pixel is than its depth along the view axis, (H, W)."""
    width, height = SIZE
    reach = math.tan(WIDTH_ANGLE / 2)
    x = reach * (2 * (np.arange(width) + 0.5) / width - 1)
    y = reach * height / width * (2 * (np.arange(height) + 0.5) / height - 1)
    return np.asarray(np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2))
