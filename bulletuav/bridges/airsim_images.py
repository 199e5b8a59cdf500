"""Camera images in AirSim's formats: cameras, image types and encodings."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from bulletuav.bridges.airsim_values import check_flag, check_text, write_pose
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import as_int, shown, unknown
from bulletuav.geometry.rotation import Quat4, from_euler, product, to_world
from bulletuav.geometry.view import CameraMatrices, Picture

IMAGE_SIZE = (256, 144)
"""Width and height, pixels, as in AirSim's default settings"""
HORIZONTAL_FOV = math.radians(90)
"""Horizontal field of view, rad"""
MAX_GREY_DEPTH = 100.0
"""Depth that is white in grey-scale depth images, m"""
SCENE, PLANAR, PERSPECTIVE, GREY, SEGMENTATION = 0, 1, 2, 3, 5
"""Image types of AirSim: colour; depth along the view axis, along the pixel's ray, and as a
fraction of `MAX_GREY_DEPTH`; segmentation"""
LABEL_COLOURS = np.array(
    [(135, 206, 235), (80, 120, 60), (150, 150, 150), (220, 60, 50), (60, 90, 220)], dtype=np.uint8
)
"""RGB colours of the labels sky, land, building, obstacle, drone"""
CAMERA_YAWS = {
    "front_center": 0.0,
    "front_right": -30.0,
    "front_left": 30.0,
    "bottom_center": None,
    "back_center": 180.0,
}
"""Yaw of each camera, degrees counter-clockwise from forward; None for the camera that looks
down"""
CAMERA_NUMBERS = {str(k): name for k, name in enumerate(CAMERA_YAWS)}
"""Names of the cameras by the numbers that older clients use"""


def get_camera_pose(world: AirsimWorld, i: int, camera: str) -> tuple[np.ndarray, Quat4]:
    """Return the pose of a camera on a drone.

    Args:
        world: The vehicles.
        i: Index of the drone.
        camera: Name or number of the camera.

    Returns:
        Position (3,), m, and quaternion x, y, z, w, both in body axes (FLU).

    Raises:
        ValueError: If there is no such camera.
    """
    name, airframe = CAMERA_NUMBERS.get(camera, camera), world.airspace.airframes[i]
    if name not in CAMERA_YAWS:
        raise unknown("camera", camera, [*CAMERA_YAWS, *CAMERA_NUMBERS])
    yaw, radius = CAMERA_YAWS[name], airframe.collision_radius
    if yaw is None:
        # The top of the image points forward
        return np.array((0.0, 0.0, -airframe.standing_height)), from_euler(0.0, math.pi / 2, 0.0)
    angle = math.radians(yaw)
    return np.array((radius * math.cos(angle), radius * math.sin(angle), 0.0)), from_euler(
        0, 0, angle
    )


class ImageRequest:
    """Request for one image.

    Attributes:
        camera: Name or number of the camera.
        kind: AirSim's image type.
        as_float: Whether pixels are returned as floats.
        compress: Whether pixels are compressed as PNG.
    """

    def __init__(self, given: Any) -> None:
        """Read a request from AirSim's map.

        Raises:
            ValueError: If the request is malformed, or its image type is not supported.
        """
        if not isinstance(given, Mapping):
            raise ValueError(f"image request is {shown(given)}: a map is needed")
        self.camera = check_text("camera_name", given.get("camera_name"))
        self.kind = as_int("image_type", given.get("image_type"), 0, 11)
        self.as_float = check_flag("pixels_as_float", given.get("pixels_as_float", False))
        self.compress = check_flag("compress", given.get("compress", False))
        if self.kind not in (SCENE, PLANAR, PERSPECTIVE, GREY, SEGMENTATION):
            raise ValueError(
                f"image_type is {self.kind}: the types are 0 (scene), 1, 2, 3 (depth) and 5 "
                f"(segmentation)"
            )
        if self.as_float and self.kind in (SCENE, SEGMENTATION):
            raise ValueError("pixels_as_float is for depths: ask for image_type 1, 2 or 3")


class CameraView(NamedTuple):
    """View of a camera at a time.

    Attributes:
        shot: Camera parameters for the renderer.
        pose: Position and orientation of the camera in AirSim's format.
        time_stamp: Simulated time, ns.
    """

    shot: CameraMatrices
    pose: dict[str, Any]
    time_stamp: int


class Exposure(NamedTuple):
    """Image request with the camera view at the time of the request; all but the pixels.

    Attributes:
        request: The request.
        view: The view of its camera.
    """

    request: ImageRequest
    view: CameraView


def make_exposures(world: AirsimWorld, i: int, requests: Sequence[ImageRequest]) -> list[Exposure]:
    """Record the present views of cameras, to be rendered later.

    Args:
        world: The vehicles.
        i: Index of the drone that carries the cameras.
        requests: Image requests.

    Returns:
        One exposure for each request.

    Raises:
        ValueError: If there is no such camera.
    """
    cameras = dict.fromkeys(request.camera for request in requests)
    views = {camera: _make_view(world, i, camera) for camera in cameras}
    return [Exposure(request, views[request.camera]) for request in requests]


def _make_view(world: AirsimWorld, i: int, camera: str) -> CameraView:
    """Return the present view of a camera of drone `i`."""
    offset, rotation = get_camera_pose(world, i, camera)
    # AirSim defines the horizontal field of view, the renderer the vertical one
    width, height = IMAGE_SIZE
    angle = math.degrees(2 * math.atan(math.tan(HORIZONTAL_FOV / 2) * height / width))
    shot = world.airspace.shot(i, offset.tolist(), rotation, None, IMAGE_SIZE, angle)
    # AirSim's positions are relative to the start of the vehicle
    swarm = world.airspace.swarm
    attitude = swarm.quaternion[i]
    start = list(world.vehicles.values())[i].start
    position = swarm.position[i] + to_world(attitude, offset) - start
    return CameraView(
        shot, write_pose(position, product(attitude, rotation)), round(world.time * 1e9)
    )


def make_response(exposure: Exposure, picture: Picture) -> dict[str, Any]:
    """Convert a rendered picture to AirSim's ImageResponse.

    Args:
        exposure: Request and camera view.
        picture: Rendered picture of that view.

    Returns:
        The map of an ImageResponse.
    """
    request, view = exposure
    width, height = view.shot.size
    # Depths in m
    numbers: list[float] = []
    content = b""
    if request.as_float:
        values = picture.depth
        # From depth along the view axis to distance along the ray of each pixel
        if request.kind == PERSPECTIVE:
            values = values * _compute_ray_ratios()
        elif request.kind == GREY:
            values = np.clip(values / MAX_GREY_DEPTH, 0.0, 1.0)
        numbers = values.ravel().astype(float).tolist()
    else:
        # Colours, labels, or depths in shades of grey
        pixels = picture.pixels
        if request.kind == SEGMENTATION:
            pixels = LABEL_COLOURS[picture.labels]
        elif request.kind != SCENE:
            grey = np.clip(255 * picture.depth / MAX_GREY_DEPTH, 0, 255).astype(np.uint8)
            pixels = np.repeat(grey[:, :, None], 3, axis=2)
        # Uncompressed pixels are in the order blue, green, red, as Unreal writes them
        content = encode_png(pixels) if request.compress else pixels[:, :, ::-1].tobytes()
    # Names and types that AirSim's own clients unpack
    return {
        "image_data_uint8": content,
        "image_data_float": numbers,
        "camera_name": request.camera,
        "camera_position": view.pose["position"],
        "camera_orientation": view.pose["orientation"],
        "time_stamp": view.time_stamp,
        "message": "",
        "pixels_as_float": request.as_float,
        "compress": request.compress,
        "width": width,
        "height": height,
        "image_type": request.kind,
    }


def encode_png(pixels: np.ndarray) -> bytes:
    """Encode pixels (H, W, 3) uint8 as a PNG."""
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(file, "PNG")
    return file.getvalue()


def _compute_ray_ratios() -> np.ndarray:
    """Return the ratio of distance along the ray to depth along the view axis, (H, W)."""
    width, height = IMAGE_SIZE
    half_width = math.tan(HORIZONTAL_FOV / 2)
    x = half_width * (2 * (np.arange(width) + 0.5) / width - 1)
    y = half_width * height / width * (2 * (np.arange(height) + 0.5) / height - 1)
    return np.asarray(np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2))
