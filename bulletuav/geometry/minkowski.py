"""Points of the difference of two convex shapes, for GJK and EPA.

The difference of a and b is every vector from a point of b to a point of a. It is convex, and its
distance from the origin is the distance of the shapes (G. van den Bergen, Collision Detection in
Interactive 3D Environments, 2004). Spheres count as their centres here.

Vectors are in world axes and relative to the positions of the shapes, so they keep their digits
far from the world's origin. Scratch is an array of rows, the same for all functions.
"""

import numpy as np
from numba import types

from bulletuav.compiled.kernel import func
from bulletuav.geometry.convex import ShapeTable, local_support_point
from bulletuav.geometry.rotation import Vec3, Vec3Like, dot
from bulletuav.geometry.shapes import SPHERE

_VECTOR = types.UniTuple(types.float64, 3)
DISTANCE_RESULT = types.Tuple((types.float64, _VECTOR, _VECTOR, _VECTOR))
"""Numba's type of a signed distance, its direction and the nearest points"""
Mat3 = tuple[Vec3, Vec3, Vec3]
"""Columns of a rotation matrix, body to world, as `rotation.axes` gives."""
MAX_VERTICES = 64
"""Most points of a difference that EPA collects"""
MAX_FACES = 2 * MAX_VERTICES
"""Triangles that so many points span, and some to spare"""
SCRATCH_ROWS = MAX_VERTICES + MAX_FACES + 3 * MAX_FACES
"""Rows of scratch: points, triangles, edges"""
SCRATCH_COLUMNS = 11
"""Columns of scratch: a point, where it is on a and on b, its weight and the one to come"""


def make_scratch() -> np.ndarray:
    """Make scratch (ROWS, COLUMNS) for `gap` and `contact_points`; threads need one each."""
    return np.zeros((SCRATCH_ROWS, SCRATCH_COLUMNS))


@func
def rotate_to_world(rotation: Mat3, v: Vec3Like) -> Vec3:
    """Turn a vector from body axes into world axes."""
    return (
        rotation[0][0] * v[0] + rotation[1][0] * v[1] + rotation[2][0] * v[2],
        rotation[0][1] * v[0] + rotation[1][1] * v[1] + rotation[2][1] * v[2],
        rotation[0][2] * v[0] + rotation[1][2] * v[1] + rotation[2][2] * v[2],
    )


@func
def rotate_to_body(rotation: Mat3, v: Vec3Like) -> Vec3:
    """Turn a vector from world axes into body axes."""
    return dot(rotation[0], v), dot(rotation[1], v), dot(rotation[2], v)


@func
def support_point(table: ShapeTable, s: int, rotation: Mat3, d: Vec3Like) -> Vec3:
    """Return a point of a shape that is farthest along a direction, both in world axes."""
    return rotate_to_world(rotation, local_support_point(table, s, rotate_to_body(rotation, d)))


@func
def shape_margin(table: ShapeTable, s: int) -> float:
    """Return the radius of a sphere, and 0 for other shapes, m."""
    return table.half[s, 0] if table.kind[s] == SPHERE else 0.0


@func
def minkowski_support(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3Like,
    d: Vec3Like,
    scratch: np.ndarray,
    row: int,
) -> Vec3:
    """Put the point of the difference that is farthest against a direction into a row of scratch.

    Args:
        table: The shapes.
        a: Number of the first shape.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, m.
        d: Direction of any length but 0.
        room: Scratch; columns 0 to 8 of the row are written.
        row: The row.

    Returns:
        The point, m.
    """
    on_a = support_point(table, a, rotation_a, (-d[0], -d[1], -d[2]))
    on_b = support_point(table, b, rotation_b, d)
    w = (
        on_a[0] - (on_b[0] + offset[0]),
        on_a[1] - (on_b[1] + offset[1]),
        on_a[2] - (on_b[2] + offset[2]),
    )
    for k in range(3):
        scratch[row, k] = w[k]
        scratch[row, 3 + k] = on_a[k]
        scratch[row, 6 + k] = on_b[k]
    return w


@func
def scratch_vec3(scratch: np.ndarray, row: int, column: int) -> Vec3:
    """Return three columns of a row of scratch, from one on."""
    return scratch[row, column], scratch[row, column + 1], scratch[row, column + 2]
