"""Support points of the Minkowski difference of two convex shapes, for GJK and EPA.

The Minkowski difference of a and b is the set of all vectors from a point of b to a point of a. It
is convex, and its distance from the origin is the distance of the shapes. Spheres are represented
by their centres (core shape) with their radius as a margin.

Vectors are in world axes and relative to the positions of the shapes, so that no precision is lost
far from the world's origin. All functions share one scratch array.

References:
    G. van den Bergen, Collision Detection in Interactive 3D Environments (2004).
"""

import numpy as np
from numba import types

from bulletuav.compiled.kernel import func
from bulletuav.geometry.convex import ShapeTable, local_support_point
from bulletuav.geometry.rotation import Vec3, Vec3Like, dot
from bulletuav.geometry.shapes import SPHERE

_VECTOR = types.UniTuple(types.float64, 3)
DISTANCE_RESULT = types.Tuple((types.float64, _VECTOR, _VECTOR, _VECTOR))
"""Numba type of a signed distance, its normal and the closest points"""
Mat3 = tuple[Vec3, Vec3, Vec3]
"""Rotation matrix, body to world, as its three columns; see `rotation.axes`."""
MAX_VERTICES = 64
"""Maximum number of vertices of the EPA polytope"""
MAX_FACES = 2 * MAX_VERTICES
"""Maximum number of triangles of the EPA polytope, for MAX_VERTICES vertices with some reserve"""
SCRATCH_ROWS = MAX_VERTICES + MAX_FACES + 3 * MAX_FACES
"""Rows of the scratch array: vertices, triangles and edges"""
SCRATCH_COLUMNS = 11
"""Columns of the scratch array: a point of the difference, its points on a and on b, its weight and
its new weight
"""


def make_scratch() -> np.ndarray:
    """Make a scratch array (SCRATCH_ROWS, SCRATCH_COLUMNS) for `gjk_distance` and `contact_points`.

    Each thread needs its own array.
    """
    return np.zeros((SCRATCH_ROWS, SCRATCH_COLUMNS))


@func
def rotate_to_world(rotation: Mat3, v: Vec3Like) -> Vec3:
    """Rotate a vector from body axes into world axes."""
    return (
        rotation[0][0] * v[0] + rotation[1][0] * v[1] + rotation[2][0] * v[2],
        rotation[0][1] * v[0] + rotation[1][1] * v[1] + rotation[2][1] * v[2],
        rotation[0][2] * v[0] + rotation[1][2] * v[1] + rotation[2][2] * v[2],
    )


@func
def rotate_to_body(rotation: Mat3, v: Vec3Like) -> Vec3:
    """Rotate a vector from world axes into body axes."""
    return dot(rotation[0], v), dot(rotation[1], v), dot(rotation[2], v)


@func
def support_point(table: ShapeTable, s: int, rotation: Mat3, d: Vec3Like) -> Vec3:
    """Return the support point of a shape: a point that is farthest along a direction.

    Args:
        table: The shapes.
        s: Index of the shape, which is no half-space.
        rotation: Axes of the shape.
        d: Direction, world axes, of any length but 0.

    Returns:
        The point relative to the shape's position, world axes, m. For a sphere it is the centre, to
        which `shape_margin` has to be added along d.
    """
    return rotate_to_world(rotation, local_support_point(table, s, rotate_to_body(rotation, d)))


@func
def shape_margin(table: ShapeTable, s: int) -> float:
    """Return the margin of a shape, m: the radius of a sphere, and 0 for all other shapes."""
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
    """Write the support point of the Minkowski difference along -d to a scratch row.

    Args:
        table: The shapes.
        a: Index of the first shape.
        rotation_a: Axes of the first shape.
        b: Index of the second shape.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, m.
        d: Direction of any length but 0.
        scratch: Scratch array; columns 0 to 8 of the row are written.
        row: Index of the row.

    Returns:
        The support point of the difference, m.
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
    """Return three consecutive columns of a scratch row as a vector, starting at `column`."""
    return scratch[row, column], scratch[row, column + 1], scratch[row, column + 2]
