"""Directions of gaps of .1 mm: known ones by hand, and the same in every frame."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bulletuav.geometry.convex import make_shape_table
from bulletuav.geometry.gjk import gjk_distance, make_scratch
from bulletuav.geometry.normal_refinement import refine_normal
from bulletuav.geometry.rotation import axes
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE, Shape

DISC, DRUM, CRATE, BALL, CUBE = range(5)
SHAPES = [
    Shape(CYLINDER, (0.06, 0.06, 0.0125)),
    Shape(CYLINDER, (0.2, 0.2, 0.05)),
    Shape(BOX, (0.1, 0.2, 0.3)),
    Shape(SPHERE, (0.1, 0.1, 0.1)),
    Shape(BOX, (0.1, 0.1, 0.1)),
]
TABLE = make_shape_table(SHAPES)
ROOM = make_scratch()
CLOSE = 1e-4


def direction(a, turn_a, b, turn_b, offset):
    """Return distance, direction and nearest points of two shapes."""
    turn_a, turn_b = axes(tuple(turn_a.as_quat())), axes(tuple(turn_b.as_quat()))
    offset = tuple(float(one) for one in offset)
    distance, *rest = gjk_distance(TABLE, a, turn_a, b, turn_b, offset, (0.0, 0.0, 0.0), ROOM)
    return distance, *map(np.array, refine_normal(TABLE, a, turn_a, b, turn_b, offset, *rest))


def near(a, turn_a, b, turn_b, way):
    """Return the offset along `way` at which two shapes are .1 mm apart."""
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        apart = direction(a, turn_a, b, turn_b, middle * way)[0] > CLOSE
        low, high = (low, middle) if apart else (middle, high)
    return high * way


def test_two_crossed_rims_face_each_other_along_the_line_of_their_nearest_points():
    """Discs at right angles, rim over rim: by symmetry the direction halves the right angle."""
    upright = Rotation.from_euler("y", 90, degrees=True)
    way = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    offset = near(DISC, Rotation.identity(), DISC, upright, way)
    _, normal, on_a, on_b = direction(DISC, Rotation.identity(), DISC, upright, offset)
    np.testing.assert_allclose(normal, -way, atol=1e-12)
    np.testing.assert_allclose(on_a - on_b - offset, -CLOSE * way, atol=1e-12)


@pytest.mark.parametrize("other", [DISC, DRUM, CRATE, BALL])
def test_directions_are_the_same_in_every_frame(other):
    """Turned together, shapes have the turned direction."""
    rng = np.random.default_rng(other)
    errors = []
    for _ in range(60):
        one, two, turn = Rotation.random(3, rng=rng)
        way = rng.normal(size=3)
        offset = near(DISC, one, other, two, way / np.linalg.norm(way))
        _, normal, on_a, on_b = direction(DISC, one, other, two, offset)
        _, turned, *_ = direction(DISC, turn * one, other, turn * two, turn.apply(offset))
        errors.append(np.linalg.norm(turned - turn.apply(normal)))
        # The points are as far apart as the shapes, along the direction
        np.testing.assert_allclose(on_a - on_b - offset, CLOSE * normal, atol=1e-9)
    assert np.max(errors) < 1e-10


def test_where_edges_cross_the_direction_is_across_both():
    turn = Rotation.from_euler("x", 45, degrees=True)
    crossed = Rotation.from_euler("xz", [45, 90], degrees=True)
    offset = near(CUBE, turn, CUBE, crossed, np.array([0.0, 0.0, 1.0]))
    _, normal, on_a, on_b = direction(CUBE, turn, CUBE, crossed, offset)
    np.testing.assert_allclose(normal, (0, 0, -1), atol=1e-14)
    np.testing.assert_allclose(on_a[:2], 0, atol=1e-12)
    np.testing.assert_allclose(on_b[:2], 0, atol=1e-12)


def test_faces_keep_their_direction():
    level = Rotation.identity()
    offset = np.array([0.0, 0.0, 0.05 + 0.0125 + CLOSE])
    _, normal, _, _ = direction(DISC, level, DRUM, level, offset)
    np.testing.assert_allclose(normal, (0, 0, -1), atol=1e-15)
