"""Camera matrices in the conventions of OpenGL, for column vectors."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEAR = 0.05
"""Near clipping distance of cameras along the view axis, m."""
FAR = 2000.0
"""Far clipping distance of the drones' cameras along the view axis, m."""

SKY_COLOUR = (206, 224, 240)
"""Colour of the sky: red, green, blue, from 0 to 255."""
SKY, LAND, BUILDING, OBSTACLE, DRONE = range(5)
"""Segmentation labels of pixels."""


class Picture(NamedTuple):
    """A camera image, H pixels high and W wide.

    Attributes:
        pixels: (H, W, 3) uint8, red, green, blue.
        depth: (H, W) float32, distance along the view axis, m; FAR for the sky.
        labels: (H, W) uint8, segmentation: SKY, LAND, BUILDING, OBSTACLE or DRONE.
    """

    pixels: np.ndarray
    depth: np.ndarray
    labels: np.ndarray


class CameraMatrices(NamedTuple):
    """Matrices and image size of a camera, from which an image is rendered.

    Attributes:
        view: (4, 4) matrix from the world's frame to the camera's; see `view_matrix`.
        projection: (4, 4) matrix from the camera to clip space; see `projection_matrix`.
        size: Width and height, pixels.
    """

    view: np.ndarray
    projection: np.ndarray
    size: tuple[int, int]


def view_matrix(
    eye: np.ndarray, target: np.ndarray, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """Compute the view matrix of a camera that looks at a point.

    Args:
        eye: (3,) position of the camera, m.
        target: (3,) point at the centre of the image, m.
        up: Direction that is up in the image.

    Returns:
        (4, 4) matrix from the world to the camera: x right, y up, z backward.
    """
    # The rows of the rotation are the camera's axes in the world.
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def projection_matrix(aspect: float, field_of_view: float) -> np.ndarray:
    """Compute the perspective projection matrix of a camera with depths from NEAR to FAR.

    Args:
        aspect: Width of the image divided by its height.
        field_of_view: Vertical field of view, degrees.

    Returns:
        (4, 4) matrix from the camera to clip space.
    """
    scale = 1 / np.tan(np.radians(field_of_view) / 2)
    matrix = np.diag([scale / aspect, scale, (FAR + NEAR) / (NEAR - FAR), 0.0])
    matrix[2, 3] = 2 * FAR * NEAR / (NEAR - FAR)
    matrix[3, 2] = -1.0
    return matrix


def linearise_depth(buffer: np.ndarray) -> np.ndarray:
    """Convert a depth buffer in [0, 1] of `projection_matrix` to depth, m.

    Depth is the distance along the view axis.
    """
    return NEAR * FAR / (FAR - (FAR - NEAR) * buffer)
