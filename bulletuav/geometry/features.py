"""Features of convex shapes that face another shape: a face, a flat side, or a line of a round one.

They are written into scratch, in axes of the contact: x and y across the normal, z along it, from
the nearest point on the first shape.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func
from bulletuav.geometry.convex import RIM, ShapeTable
from bulletuav.geometry.minkowski import Turn, turned, turned_back
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, point
from bulletuav.geometry.shapes import BOX, CYLINDER

FLAT = math.sqrt(0.5)
"""Cosine of the largest angle between axis and normal at which a flat side faces the other"""
UPRIGHT = 1e-3
"""Sine of the angle between axis and normal below which body axes place the rim's points"""
FAR = 0.01
"""Share of the radius from which on the other shape lies to one side"""
RIM_COS = np.array([cos(2 * math.pi / RIM * k) for k in range(RIM)])
"""Cosines of the angles of the rim's points"""
RIM_SIN = np.array([sin(2 * math.pi / RIM * k) for k in range(RIM)])
"""Sines of the same"""


@func
def _put(room: np.ndarray, row: int, column: int, axes: Turn, place: Vec3) -> None:
    """Put a place, m from the nearest point on a, into scratch in axes of the contact."""
    room[row, column] = dot(place, axes[0])
    room[row, column + 1] = dot(place, axes[1])
    room[row, column + 2] = dot(place, axes[2])


@func
def _box_face(
    half: Vec3, turn: Turn, d: Vec3, start: Vec3, axes: Turn, room: np.ndarray, column: int
) -> tuple[int, Vec3]:
    """Put the corners of the face of a box that looks most along d; as `put_feature`."""
    local = turned_back(turn, d)
    k = 0
    for m in range(1, 3):
        if abs(local[m]) > abs(local[k]):
            k = m
    i = (k + 1) % 3
    j = (k + 2) % 3
    sign = math.copysign(1.0, local[k])
    middle = plus(start, sign * half[k], turn[k])
    # On the far side the first axis is mirrored, so corners turn left there too
    one = plus(middle, sign * half[i], turn[i])
    other = plus(middle, -sign * half[i], turn[i])
    _put(room, 0, column, axes, plus(one, half[j], turn[j]))
    _put(room, 1, column, axes, plus(other, half[j], turn[j]))
    _put(room, 2, column, axes, plus(other, -half[j], turn[j]))
    _put(room, 3, column, axes, plus(one, -half[j], turn[j]))
    return 4, (sign * turn[k][0], sign * turn[k][1], sign * turn[k][2])


@func
def _hull_face(
    table: ShapeTable,
    s: int,
    turn: Turn,
    d: Vec3,
    start: Vec3,
    axes: Turn,
    room: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Put the corners of the face of a hull that looks most along d; as `put_feature`."""
    local = turned_back(turn, d)
    best = table.planes[s, 0]
    most = -np.inf
    for f in range(table.planes[s, 0], table.planes[s, 1]):
        along = dot(point(table.plane, f), local)
        if along > most:
            most = along
            best = f
    first = table.rings[best, 0]
    count = table.rings[best, 1] - first
    for k in range(count):
        corner = point(table.corner, table.ring[first + k])
        _put(room, k, column, axes, plus(start, 1.0, turned(turn, corner)))
    return count, turned(turn, point(table.plane, best))


@func
def _cylinder_side(
    half: Vec3,
    turn: Turn,
    d: Vec3,
    start: Vec3,
    aside: Vec3,
    axes: Turn,
    room: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Put the flat side or the line of a cylinder that looks along d; as `put_feature`."""
    axis = turn[2]
    along = dot(d, axis)
    radial = plus(d, -along, axis)
    sine = math.sqrt(dot(radial, radial))
    # The deepest point of the rim comes first, or any where all are as deep
    scaled = (radial[0] / sine, radial[1] / sine, radial[2] / sine)
    radial = scaled if sine > UPRIGHT else turn[0]
    if abs(along) < FLAT:
        line = plus(start, half[0], radial)
        _put(room, 0, column, axes, plus(line, half[2], axis))
        _put(room, 1, column, axes, plus(line, -half[2], axis))
        return 2, d
    # What two flat sides share is widest between their middles: chords would cut that off
    beside = plus(aside, -dot(aside, axis), axis)
    far = math.sqrt(dot(beside, beside))
    if far > FAR * half[0]:
        radial = (beside[0] / far, beside[1] / far, beside[2] / far)
    sign = math.copysign(1.0, along)
    outward = (sign * axis[0], sign * axis[1], sign * axis[2])
    middle = plus(start, half[2], outward)
    left = cross(outward, radial)
    for k in range(RIM):
        place = plus(middle, half[0] * RIM_COS[k], radial)
        _put(room, k, column, axes, plus(place, half[0] * RIM_SIN[k], left))
    return RIM, outward


@func
def put_feature(
    table: ShapeTable,
    s: int,
    turn: Turn,
    d: Vec3,
    start: Vec3,
    aside: Vec3,
    axes: Turn,
    room: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Put the corners of the feature of a shape that looks along a direction into scratch.

    Args:
        table: The shapes.
        s: Number of the shape: a box, a cylinder or a hull.
        turn: Axes of the shape.
        d: Unit vector, world axes.
        start: Position of the shape from the nearest point on a, m.
        aside: From the middle of a round shape to that of the other round one, m; zero for none.
        axes: Axes of the contact.
        room: Scratch.
        column: First of the three columns to put them.

    Returns:
        How many there are, 2 for a line, and the outward normal of the face. Corners turn left
        seen from outside.
    """
    half = point(table.half, s)
    if table.kind[s] == BOX:
        return _box_face(half, turn, d, start, axes, room, column)
    if table.kind[s] == CYLINDER:
        return _cylinder_side(half, turn, d, start, aside, axes, room, column)
    return _hull_face(table, s, turn, d, start, axes, room, column)
