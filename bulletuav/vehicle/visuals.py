"""Visual shapes of an airframe, read from its URDF."""

from typing import NamedTuple

import numpy as np

from bulletuav.geometry.shapes import Shape
from bulletuav.parsing import parse_number
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.urdf import UrdfFile

Colour = tuple[float, float, float, float]
IDENTITY_QUATERNION = (0.0, 0.0, 0.0, 1.0)
DEFAULT_COLOUR: Colour = (0.45, 0.47, 0.5, 1.0)
"""Colour of shapes without a colour in the file"""
LOAD_COLOUR: Colour = (0.72, 0.53, 0.30, 1.0)
"""Colour of loads"""


class VisualShape(NamedTuple):
    """One visual shape of an airframe.

    Attributes:
        shape: The shape in its own axes.
        position: (3,) position in body axes, m.
        quaternion: (4,) rotation from its axes to the body's.
        colour: Red, green, blue and opacity, from 0 to 1.
    """

    shape: Shape
    position: np.ndarray
    quaternion: np.ndarray
    colour: Colour


def read_visual_shapes(airframe: Airframe) -> list[VisualShape]:
    """Read the visual shapes of an airframe.

    Args:
        airframe: The airframe. Meshes in formats other than OBJ, such as .stl, are skipped.

    Returns:
        The visual shapes; the collision shape if there are none.
    """
    if airframe.is_load:
        return [collision_part(airframe, LOAD_COLOUR)]
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
            continue  # a format that only the engine reads
    return parts or [collision_part(airframe, DEFAULT_COLOUR)]


def collision_part(airframe: Airframe, colour: Colour) -> VisualShape:
    """Return the collision shape of an airframe as a visual shape."""
    return VisualShape(airframe.shape, np.zeros(3), np.array(IDENTITY_QUATERNION), colour)


def _colour(text: str) -> Colour:
    """Parse a colour of four numbers; return the default colour if it is malformed."""
    try:
        red, green, blue, alpha = map(parse_number, text.split())
    except ValueError:
        return DEFAULT_COLOUR
    return red, green, blue, alpha
