"""Camera matrices in the conventions of OpenGL, row by column, for column vectors."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEAR = 0.05
"""Distance along the view axis at which cameras begin to see, m."""
FAR = 2000.0
"""Distance along the view axis to which cameras of drones see, m."""

SKY_COLOUR = (206, 224, 240)
"""Colour of the sky: red, green, blue, from 0 to 255."""
SKY, LAND, BUILDING, OBSTACLE, DRONE = range(5)
"""Labels of what a pixel shows."""


class Picture(NamedTuple):
    """An image of a camera, H pixels high and W wide.

    Attributes:
        pixels: (H, W, 3) uint8, red, green, blue.
        depth: (H, W) float32, distance along the view axis, m; FAR where nothing is.
        labels: (H, W) uint8, what each pixel shows: SKY, LAND, BUILDING, OBSTACLE or DRONE.
    """

    pixels: np.ndarray
    depth: np.ndarray
    labels: np.ndarray


class CameraMatrices(NamedTuple):
    """What a camera sees, before anything is drawn.

    Attributes:
        view: (4, 4) matrix from the world's own frame to the camera's; see `view_matrix`.
        projection: (4, 4) matrix of the camera; see `projection_matrix`.
        size: Width and height, pixels.
    """

    view: np.ndarray
    projection: np.ndarray
    size: tuple[int, int]


def view_matrix(
    eye: np.ndarray, target: np.ndarray, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """Return the view matrix of a camera that looks at a point.

    Args:
        eye: (3,) where the camera is, m.
        target: (3,) where it looks, m.
        up: Direction that is up in the image.

    Returns:
        (4, 4) matrix from the world to the camera: x right, y up, z backward.
    """
    # The camera's axes in the world are the rows of its rotation.
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def projection_matrix(aspect: float, field_of_view: float, far: float = FAR) -> np.ndarray:
    """Return the perspective projection from NEAR on.

    Args:
        aspect: Width of the image over its height.
        field_of_view: Vertical angle of view, degrees.
        far: Distance along the view axis to which the camera sees, m. `linearise_depth` is for FAR.

    Returns:
        (4, 4) matrix from the camera to clip space.
    """
    scale = 1 / np.tan(np.radians(field_of_view) / 2)
    matrix = np.diag([scale / aspect, scale, (far + NEAR) / (NEAR - far), 0.0])
    matrix[2, 3] = 2 * far * NEAR / (NEAR - far)
    matrix[3, 2] = -1.0
    return matrix


def rescale_depth(depth: np.ndarray, far: float) -> np.ndarray:
    """Correct depths that `linearise_depth` gave for a projection that sees to `far`, m."""
    buffer = (FAR - NEAR * FAR / depth) / (FAR - NEAR)
    return NEAR * far / (far - (far - NEAR) * buffer)


def linearise_depth(buffer: np.ndarray) -> np.ndarray:
    """Turn a depth buffer in [0, 1], of a projection to FAR, into depth along the view axis, m."""
    return NEAR * FAR / (FAR - (FAR - NEAR) * buffer)
