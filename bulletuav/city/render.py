"""A picture of a city, by the engine's renderer."""

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import FAR, SKY, SKY_COLOUR, projection_matrix, view_matrix
from bulletuav.vehicle.airframes import load_airframe

FIELD_OF_VIEW = 40.0
"""Vertical, degrees"""
DIRECTION = np.array([-0.5, -0.75, 0.6])
"""From where the city is seen"""


def render(
    solids: Solids,
    side: float,
    size: tuple[int, int] = (1200, 800),
) -> np.ndarray:
    """Render a city from the south-west and above; no screen is needed.

    Args:
        solids: Pieces of its buildings.
        side: Of its square, m.
        size: Width and height of the picture, pixels.

    Returns:
        (height, width, 3) uint8.
    """
    # An engine with one world, in which the city stands
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240, layouts=[solids])
    layout = np.zeros(1, dtype=np.int64)
    everywhere = np.ones(1, dtype=bool)
    engine.set_layouts(layout, everywhere)

    # A camera that looks at a point a little below the ground, beyond which the city ends
    eye = 1.5 * side * DIRECTION
    target = np.array([0.0, 0.0, -0.02 * side])
    view = view_matrix(eye, target)
    projection = projection_matrix(size[0] / size[1], FIELD_OF_VIEW, max(FAR, 4 * side))
    picture = engine.picture(0, view, projection, size)
    engine.close()
    picture.pixels[picture.labels == SKY] = SKY_COLOUR
    return picture.pixels
