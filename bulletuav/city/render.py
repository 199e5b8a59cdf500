"""A picture of a city, by the engine's renderer."""

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import AIR, SKY, projection_matrix, view_matrix
from bulletuav.vehicle.airframe import load_airframe

FIELD_OF_VIEW = 40.0
"""Vertical, degrees"""
DIRECTION = np.array([-0.5, -0.75, 0.6])
"""From where the city is seen"""


def render(solids: Solids, side: float, size: tuple[int, int] = (1200, 800)) -> np.ndarray:
    """Render a city from the south-west and above; no screen is needed.

    Args:
        solids: Pieces of its buildings.
        side: Of its square, m.
        size: Width and height of the picture, pixels.

    Returns:
        (height, width, 3) uint8.
    """
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240, layouts=[solids])
    engine.set_layouts(np.zeros(1, dtype=np.int64), np.ones(1, dtype=bool))
    view = view_matrix(1.5 * side * DIRECTION, np.array([0.0, 0.0, -0.02 * side]))
    projection = projection_matrix(size[0] / size[1], FIELD_OF_VIEW)
    picture = engine.picture(0, view, projection, size)
    engine.close()
    picture.pixels[picture.labels == SKY] = AIR
    return picture.pixels
