"""Camera matrices in the conventions of OpenGL, row by column, for column vectors."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

NEAR, FAR = 0.05, 2000.0  # m, what cameras see


AIR = (206, 224, 240)
"""Colour of the sky"""
SKY, LAND, BUILDING, OBSTACLE, DRONE = range(5)
"""What a pixel shows"""


class Picture(NamedTuple):
    """pixels (H, W, 3) uint8; depth (H, W) float32, m along the view axis, FAR where nothing is; labels (H, W) uint8."""

    pixels: np.ndarray
    depth: np.ndarray
    labels: np.ndarray


def view_matrix(
    eye: np.ndarray, target: np.ndarray, up: Sequence[float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """(4, 4) from the world to a camera at `eye` looking at `target`, m: x right, y up, z backward."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def projection_matrix(aspect: float, field_of_view: float) -> np.ndarray:
    """(4, 4) perspective; aspect is width over height, the field of view vertical, degrees."""
    scale = 1 / np.tan(np.radians(field_of_view) / 2)
    matrix = np.diag([scale / aspect, scale, (FAR + NEAR) / (NEAR - FAR), 0.0])
    matrix[2, 3], matrix[3, 2] = 2 * FAR * NEAR / (NEAR - FAR), -1.0
    return matrix


def metres(buffer: np.ndarray) -> np.ndarray:
    """Depth along the view axis, m, from a depth buffer in [0, 1]."""
    return NEAR * FAR / (FAR - (FAR - NEAR) * buffer)
