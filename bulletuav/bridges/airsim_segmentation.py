"""Segmentation ids of the objects of AirSim's scene, and the colours of segmentation images."""

from typing import NamedTuple

import numpy as np

from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE
from bulletuav.vehicle.swarm import CITY, GROUND

LABEL_COLOURS = np.array(
    [(135, 206, 235), (80, 120, 60), (150, 150, 150), (220, 60, 50), (60, 90, 220)], dtype=np.uint8
)
"""RGB colours of the labels sky, land, building, obstacle, drone, for objects without an id"""


class SegmentationColours(NamedTuple):
    """Colours of segmentation images.

    Attributes:
        labels: (5, 3) uint8 RGB colours of labels, for sky, ground and buildings.
        bodies: (N + R, 3) uint8 RGB colours of drones, and of the pieces of obstacles and bodies.
    """

    labels: np.ndarray
    bodies: np.ndarray

    def paint(self, labels: np.ndarray, bodies: np.ndarray) -> np.ndarray:
        """Return the pixels (H, W, 3) uint8 of an image.

        Args:
            labels: (H, W) label of each pixel.
            bodies: (H, W) body of each pixel, -1 for none; see `VisualScene.draw`.
        """
        pixels: np.ndarray = self.labels[labels]
        is_body = bodies >= 0
        pixels[is_body] = self.bodies[bodies[is_body]]
        return pixels


def make_label_colour(number: int) -> np.ndarray:
    """Return the colour of a segmentation id, as PASCAL VOC defines it.

    Args:
        number: The id, from 0 to 255.

    Returns:
        (3,) uint8, red, green, blue.
    """
    colour = np.zeros(3, dtype=np.uint8)
    # The lowest bits of the id are the highest ones of red, green and blue
    for bit in range(8):
        colour[bit % 3] |= (number >> bit & 1) << (7 - bit // 3)
    return colour


def find_colours(world: AirsimWorld) -> SegmentationColours:
    """Return the present colours of all objects."""
    labels = LABEL_COLOURS.copy()
    for label, other in ((LAND, GROUND), (BUILDING, CITY)):
        labels[label] = _find_colour(world, other, label)
    pieces = world.airspace.world.engine.scenery.other.tolist()
    bodies = [_find_colour(world, i, DRONE) for i in range(len(world.vehicles))]
    # A body of several pieces has one id
    of_other = {other: _find_colour(world, other, OBSTACLE) for other in dict.fromkeys(pieces)}
    bodies += [of_other[other] for other in pieces]
    return SegmentationColours(labels, np.array(bodies))


def _find_colour(world: AirsimWorld, other: int, label: int) -> np.ndarray:
    """Return the colour of an object by its number in `Contacts`, (3,) uint8."""
    number = world.segmentation_ids.get(world.object_name(other))
    return LABEL_COLOURS[label] if number is None else make_label_colour(number)
