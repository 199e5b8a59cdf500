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
from bulletuav.geometry.convex import ShapeTable, support
from bulletuav.geometry.rotation import Vec3, Vec3Like, dot
from bulletuav.geometry.shapes import SPHERE

_VECTOR = types.UniTuple(types.float64, 3)
ANSWER = types.Tuple((types.float64, _VECTOR, _VECTOR, _VECTOR))
"""Numba's type of a signed distance, its direction and the nearest points"""
Turn = tuple[Vec3, Vec3, Vec3]
"""Columns of a rotation matrix, body to world, as `rotation.axes` gives."""
MOST_VERTICES = 64
"""Most points of a difference that EPA collects"""
MOST_FACES = 2 * MOST_VERTICES
"""Triangles that so many points span, and some to spare"""
ROWS = MOST_VERTICES + MOST_FACES + 3 * MOST_FACES
"""Rows of scratch: points, triangles, edges"""
COLUMNS = 11
"""Columns of scratch: a point, where it is on a and on b, its weight and the one to come"""


def make_room() -> np.ndarray:
    """Make scratch (ROWS, COLUMNS) for `gap` and `contact_points`; threads need one each."""
    return np.zeros((ROWS, COLUMNS))


@func
def turned(turn: Turn, v: Vec3Like) -> Vec3:
    """Turn a vector from body axes into world axes."""
    return (
        turn[0][0] * v[0] + turn[1][0] * v[1] + turn[2][0] * v[2],
        turn[0][1] * v[0] + turn[1][1] * v[1] + turn[2][1] * v[2],
        turn[0][2] * v[0] + turn[1][2] * v[1] + turn[2][2] * v[2],
    )


@func
def turned_back(turn: Turn, v: Vec3Like) -> Vec3:
    """Turn a vector from world axes into body axes."""
    return dot(turn[0], v), dot(turn[1], v), dot(turn[2], v)


@func
def far_point(table: ShapeTable, s: int, turn: Turn, d: Vec3Like) -> Vec3:
    """Return a point of a shape that is farthest along a direction, both in world axes."""
    return turned(turn, support(table, s, turned_back(turn, d)))


@func
def swell(table: ShapeTable, s: int) -> float:
    """Return the radius of a sphere, and 0 for other shapes, m."""
    return table.half[s, 0] if table.kind[s] == SPHERE else 0.0


@func
def put_difference(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3Like,
    d: Vec3Like,
    room: np.ndarray,
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
    on_a = far_point(table, a, turn_a, (-d[0], -d[1], -d[2]))
    on_b = far_point(table, b, turn_b, d)
    w = (
        on_a[0] - (on_b[0] + offset[0]),
        on_a[1] - (on_b[1] + offset[1]),
        on_a[2] - (on_b[2] + offset[2]),
    )
    for k in range(3):
        room[row, k] = w[k]
        room[row, 3 + k] = on_a[k]
        room[row, 6 + k] = on_b[k]
    return w


@func
def row_point(room: np.ndarray, row: int, column: int) -> Vec3:
    """Return three columns of a row of scratch, from one on."""
    return room[row, column], room[row, column + 1], room[row, column + 2]
