"""Camera images in AirSim's formats: cameras, image types and encodings."""

import io
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from bulletuav.bridges.airsim_cameras import SCENE, AirsimCamera, find_camera
from bulletuav.bridges.airsim_segmentation import SegmentationColours, find_colours
from bulletuav.bridges.airsim_values import check_flag, check_text, write_pose
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import as_int, shown
from bulletuav.geometry.view import CameraMatrices, Picture

MAX_GREY_DEPTH = 100.0
"""Depth that is white in grey-scale depth images, m"""
PLANAR, PERSPECTIVE, GREY, SEGMENTATION = 1, 2, 3, 5
"""Image types of AirSim besides `SCENE`: depth along the view axis, along the pixel's ray, and as a
fraction of `MAX_GREY_DEPTH`; segmentation"""
MAX_FLOATS = 1_500_000
"""Maximum number of pixels of an image of floats, which take 9 bytes each"""


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


class ImageCall(NamedTuple):
    """Parsed call for images.

    Attributes:
        drone: Index of the drone that carries the cameras; None for cameras in the world.
        requests: Image requests, in order.
        is_list: Whether the result is a list of responses, or only the bytes of one image.
    """

    drone: int | None
    requests: list[ImageRequest]
    is_list: bool


class CameraView(NamedTuple):
    """View of a camera at a time.

    Attributes:
        shot: Camera parameters for the renderer.
        field_of_view: Horizontal field of view, rad.
        pose: Position and orientation of the camera in AirSim's format.
        time_stamp: Simulated time, ns.
        colours: Colours of a segmentation image; None for other image types.
    """

    shot: CameraMatrices
    field_of_view: float
    pose: dict[str, Any]
    time_stamp: int
    colours: SegmentationColours | None


class Exposure(NamedTuple):
    """Image request with the camera view at the time of the request; all but the pixels.

    Attributes:
        request: The request.
        view: The view of its camera.
    """

    request: ImageRequest
    view: CameraView

    @property
    def needs_bodies(self) -> bool:
        """Whether the pixels depend on the bodies in the picture, beyond its labels."""
        return self.view.colours is not None


def make_exposures(
    world: AirsimWorld, i: int | None, requests: Sequence[ImageRequest]
) -> list[Exposure]:
    """Record the present views of cameras, to be rendered later.

    Args:
        world: The vehicles.
        i: Index of the drone that carries the cameras; None for cameras that stand in the world.
        requests: Image requests.

    Returns:
        One exposure for each request.

    Raises:
        ValueError: If there is no such camera, or an image of floats is too large.
    """
    return [Exposure(request, _make_view(world, i, request)) for request in requests]


def list_cameras(world: AirsimWorld, i: int | None) -> Mapping[str, AirsimCamera]:
    """Return the cameras of a drone, or those that stand in the world, by name."""
    return world.external_cameras if i is None else list(world.vehicles.values())[i].cameras


def _make_view(world: AirsimWorld, i: int | None, request: ImageRequest) -> CameraView:
    """Return the present view of a camera."""
    camera = find_camera(list_cameras(world, i), request.camera)
    size, view = camera.get_capture(request.kind)
    width, height = size
    if request.as_float and width * height > MAX_FLOATS:
        raise ValueError(
            f"pixels_as_float is true for {width} x {height} pixels: at most {MAX_FLOATS} floats "
            f"are possible; make the image smaller in the settings file"
        )
    # AirSim defines the horizontal field of view, the renderer the vertical one
    angle = math.degrees(2 * math.atan(math.tan(view / 2) * height / width))
    offset, rotation = camera.mount
    shot = world.airspace.shot(i, offset.tolist(), rotation, None, size, angle)
    # AirSim's positions are relative to the start of the vehicle
    if i is None:
        pose = write_pose(offset, rotation)
    else:
        swarm, vehicle = world.airspace.swarm, list(world.vehicles.values())[i]
        position, attitude = camera.compute_pose(swarm.position[i], swarm.quaternion[i])
        pose = write_pose(position - vehicle.start, attitude)
    colours = find_colours(world) if request.kind == SEGMENTATION else None
    return CameraView(shot, view, pose, round(world.time * 1e9), colours)


def make_response(
    exposure: Exposure, picture: Picture, bodies: np.ndarray | None
) -> dict[str, Any]:
    """Convert a rendered picture to AirSim's ImageResponse.

    Args:
        exposure: Request and camera view.
        picture: Rendered picture of that view.
        bodies: (H, W) body at each pixel, if the exposure needs them; see `VisualScene.draw`.

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
            values = values * _compute_ray_ratios(view)
        elif request.kind == GREY:
            values = np.clip(values / MAX_GREY_DEPTH, 0.0, 1.0)
        numbers = values.ravel().astype(float).tolist()
    else:
        # Colours, labels, or depths in shades of grey
        pixels = picture.pixels
        if view.colours is not None:
            assert bodies is not None
            pixels = view.colours.paint(picture.labels, bodies)
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


def _compute_ray_ratios(view: CameraView) -> np.ndarray:
    """Return the ratio of distance along the ray to depth along the view axis, (H, W)."""
    width, height = view.shot.size
    half_width = math.tan(view.field_of_view / 2)
    x = half_width * (2 * (np.arange(width) + 0.5) / width - 1)
    y = half_width * height / width * (2 * (np.arange(height) + 0.5) / height - 1)
    return np.asarray(np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2))
