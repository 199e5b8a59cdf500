"""What an airframe looks like: the visual shapes of its URDF."""

from typing import NamedTuple

import numpy as np

from bulletuav.geometry.shapes import Shape
from bulletuav.parsing import parse_number
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.urdf import UrdfFile

Colour = tuple[float, float, float, float]
IDENTITY_QUATERNION = (0.0, 0.0, 0.0, 1.0)
DEFAULT_COLOUR: Colour = (0.45, 0.47, 0.5, 1.0)
"""Colour of parts whose file tells none"""


class VisualShape(NamedTuple):
    """One visual shape of an airframe.

    Attributes:
        shape: Its form, in axes of its own.
        position: (3,) where it is in body axes, m.
        quaternion: (4,) from its axes to the body's.
        colour: Red, green, blue and opacity, from 0 to 1.
    """

    shape: Shape
    position: np.ndarray
    quaternion: np.ndarray
    colour: Colour


def read_visual_shapes(airframe: Airframe) -> list[VisualShape]:
    """Read the visual shapes of an airframe.

    Args:
        airframe: Its file may name meshes in forms that are not read, such as .stl.

    Returns:
        Those that are read; the collision shape where there are none.
    """
    urdf = UrdfFile(airframe.urdf)
    colours = {
        material.get("name"): _colour(color.get("rgba", ""))
        for material in urdf.root.iter("material")
        for color in material.findall("color")
    }
    parts = []
    for visual in urdf.root.findall("link/visual"):
        material = visual.find("material")
        colour = (
            DEFAULT_COLOUR
            if material is None
            else colours.get(material.get("name"), DEFAULT_COLOUR)
        )
        try:
            parts.append(VisualShape(urdf.shape(visual), *urdf.origin(visual), colour))
        except ValueError:
            continue  # a form that the engine alone reads
    return parts or [
        VisualShape(airframe.shape, np.zeros(3), np.array(IDENTITY_QUATERNION), DEFAULT_COLOUR)
    ]


def _colour(text: str) -> Colour:
    """Read a colour, four numbers."""
    try:
        red, green, blue, alpha = map(parse_number, text.split())
    except ValueError:
        return DEFAULT_COLOUR
    return red, green, blue, alpha
