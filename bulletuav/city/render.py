"""Rendered image of a city."""

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import FAR, CameraMatrices, projection_matrix, view_matrix
from bulletuav.vehicle.airframes import load_airframe

FIELD_OF_VIEW = 40.0
"""Vertical field of view, degrees"""
DIRECTION = np.array([-0.5, -0.75, 0.6])
"""Direction of the camera from the city"""


def render(solids: Solids, side: float, size: tuple[int, int] = (1200, 800)) -> np.ndarray:
    """Render a city from the south-west and above; no display is needed.

    Args:
        solids: Pieces of its buildings.
        side: Side of the city's square, m.
        size: Width and height of the image, pixels.

    Returns:
        (height, width, 3) uint8.
    """
    # An engine with one world that contains the city
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240, layouts=[solids])
    layout = np.zeros(1, dtype=np.int64)
    everywhere = np.ones(1, dtype=bool)
    engine.set_layouts(layout, everywhere)

    # The camera looks at a point slightly below the ground, which centres the city
    eye = 1.5 * side * DIRECTION
    target = np.array([0.0, 0.0, -0.02 * side])
    view = view_matrix(eye, target)
    projection = projection_matrix(size[0] / size[1], FIELD_OF_VIEW)
    shot = CameraMatrices(view, projection, size)
    pixels = engine.picture(0, shot, far=max(FAR, 4 * side)).pixels
    engine.close()
    return pixels
