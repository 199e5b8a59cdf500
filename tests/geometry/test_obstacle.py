"""Shapes of obstacles and of tables, by hand."""

import math

import numpy as np
import pytest

from bulletuav.geometry.convex import bounding_radius, inscribed_radius
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.shapes import BOX, CYLINDER, HULL, SPHERE

TETRAHEDRON = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.0, 3.0))


@pytest.mark.parametrize(
    ("obstacle", "kind", "half", "radius"),
    [
        (Obstacle("box", (2.0, 4.0, 4.0)), BOX, (1, 2, 2), 3),
        (Obstacle("sphere", (1.5,)), SPHERE, (1.5, 1.5, 1.5), 1.5),
        (Obstacle("cylinder", (3.0, 8.0)), CYLINDER, (3, 3, 4), 5),
        (Obstacle("hull", corners=TETRAHEDRON), HULL, (3, 3, 3), 3),
    ],
)
def test_shapes_of_obstacles(obstacle, kind, half, radius):
    assert obstacle.shape.kind == kind
    assert obstacle.shape.half == half
    assert obstacle.radius == bounding_radius(obstacle.shape) == radius
    hash(obstacle)


def test_a_hull_keeps_the_corners_that_stick_out():
    points = np.array([*TETRAHEDRON, (0.5, 0.5, 0.5)])
    hull = Obstacle("hull", corners=points)
    assert sorted(hull.corners) == sorted(TETRAHEDRON)
    assert hull == Obstacle("hull", corners=hull.corners)


def test_balls_within_shapes():
    """The mean of the tetrahedron's corners is (3/4, 3/4, 3/4); its slant is at x + y + z = 3."""
    slant = (3 - 9 / 4) / math.sqrt(3)
    assert inscribed_radius(Obstacle("hull", corners=TETRAHEDRON).shape) == pytest.approx(slant)
    assert inscribed_radius(Obstacle("cylinder", (3.0, 2.0)).shape) == 1
