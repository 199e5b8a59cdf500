"""Features of convex shapes that face another shape: a face, a cap, or a line on a round side.

Features are written to the scratch array in the contact frame: x and y are tangential, z is along
the normal, and the origin is the closest point on the first shape.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func
from bulletuav.geometry.convex import NUM_RIM_POINTS, ShapeTable
from bulletuav.geometry.minkowski import Mat3, rotate_to_body, rotate_to_world
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, point
from bulletuav.geometry.shapes import BOX, CYLINDER

MIN_CAP_COSINE = math.sqrt(0.5)
"""Cosine of the largest angle between a cylinder's axis and the normal at which its cap faces the
other shape
"""
MIN_RIM_SINE = 1e-3
"""Sine of the angle between axis and normal below which the body's x axis orients the rim points"""
MIN_OFFSET_FRACTION = 0.01
"""Tangential offset of two cylinders, as a fraction of the radius, above which it orients the rim
points
"""
RIM_COS = np.array([cos(2 * math.pi / NUM_RIM_POINTS * k) for k in range(NUM_RIM_POINTS)])
"""Cosines of the angles of the rim points"""
RIM_SIN = np.array([sin(2 * math.pi / NUM_RIM_POINTS * k) for k in range(NUM_RIM_POINTS)])
"""Sines of the angles of the rim points"""


@func
def _write_corner(scratch: np.ndarray, row: int, column: int, axes: Mat3, place: Vec3) -> None:
    """Write a point, m from the closest point on a, to the scratch array in the contact frame."""
    scratch[row, column] = dot(place, axes[0])
    scratch[row, column + 1] = dot(place, axes[1])
    scratch[row, column + 2] = dot(place, axes[2])


@func
def _write_box_face(
    half: Vec3, rotation: Mat3, d: Vec3, start: Vec3, axes: Mat3, scratch: np.ndarray, column: int
) -> tuple[int, Vec3]:
    """Write the corners of the box face whose normal is closest to d; see `write_feature`."""
    local = rotate_to_body(rotation, d)
    k = 0
    for m in range(1, 3):
        if abs(local[m]) > abs(local[k]):
            k = m
    i = (k + 1) % 3
    j = (k + 2) % 3
    sign = math.copysign(1.0, local[k])
    middle = plus(start, sign * half[k], rotation[k])
    # On the negative side the first axis is mirrored, which keeps the corners counterclockwise
    one = plus(middle, sign * half[i], rotation[i])
    other = plus(middle, -sign * half[i], rotation[i])
    _write_corner(scratch, 0, column, axes, plus(one, half[j], rotation[j]))
    _write_corner(scratch, 1, column, axes, plus(other, half[j], rotation[j]))
    _write_corner(scratch, 2, column, axes, plus(other, -half[j], rotation[j]))
    _write_corner(scratch, 3, column, axes, plus(one, -half[j], rotation[j]))
    return 4, (sign * rotation[k][0], sign * rotation[k][1], sign * rotation[k][2])


@func
def _write_hull_face(
    table: ShapeTable,
    s: int,
    rotation: Mat3,
    d: Vec3,
    start: Vec3,
    axes: Mat3,
    scratch: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Write the corners of the hull face whose normal is closest to d; see `write_feature`."""
    local = rotate_to_body(rotation, d)
    best = table.face_range[s, 0]
    most = -np.inf
    for f in range(table.face_range[s, 0], table.face_range[s, 1]):
        along = dot(point(table.face_planes, f), local)
        if along > most:
            most = along
            best = f
    first = table.face_vertex_range[best, 0]
    count = table.face_vertex_range[best, 1] - first
    for k in range(count):
        corner = point(table.vertices, table.face_vertices[first + k])
        _write_corner(scratch, k, column, axes, plus(start, 1.0, rotate_to_world(rotation, corner)))
    return count, rotate_to_world(rotation, point(table.face_planes, best))


@func
def _write_cylinder_feature(
    half: Vec3,
    rotation: Mat3,
    d: Vec3,
    start: Vec3,
    centre_offset: Vec3,
    axes: Mat3,
    scratch: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Write points on the rim of a cap, or the ends of a line on the side; see `write_feature`."""
    axis = rotation[2]
    along = dot(d, axis)
    radial = plus(d, -along, axis)
    sine = math.sqrt(dot(radial, radial))
    # The deepest point of the rim comes first, or any point if all are equally deep
    scaled = (radial[0] / sine, radial[1] / sine, radial[2] / sine)
    radial = scaled if sine > MIN_RIM_SINE else rotation[0]
    if abs(along) < MIN_CAP_COSINE:
        line = plus(start, half[0], radial)
        _write_corner(scratch, 0, column, axes, plus(line, half[2], axis))
        _write_corner(scratch, 1, column, axes, plus(line, -half[2], axis))
        return 2, d
    # Two caps overlap most along the line of their centres: place a rim point there
    tangential = plus(centre_offset, -dot(centre_offset, axis), axis)
    distance = math.sqrt(dot(tangential, tangential))
    if distance > MIN_OFFSET_FRACTION * half[0]:
        radial = (tangential[0] / distance, tangential[1] / distance, tangential[2] / distance)
    sign = math.copysign(1.0, along)
    outward = (sign * axis[0], sign * axis[1], sign * axis[2])
    middle = plus(start, half[2], outward)
    left = cross(outward, radial)
    for k in range(NUM_RIM_POINTS):
        place = plus(middle, half[0] * RIM_COS[k], radial)
        _write_corner(scratch, k, column, axes, plus(place, half[0] * RIM_SIN[k], left))
    return NUM_RIM_POINTS, outward


@func
def write_feature(
    table: ShapeTable,
    s: int,
    rotation: Mat3,
    d: Vec3,
    start: Vec3,
    centre_offset: Vec3,
    axes: Mat3,
    scratch: np.ndarray,
    column: int,
) -> tuple[int, Vec3]:
    """Write the corners of the feature of a shape that faces a direction to the scratch array.

    Args:
        table: The shapes.
        s: Index of the shape: a box, a cylinder or a hull.
        rotation: Axes of the shape.
        d: Direction that the feature faces, unit vector, world axes.
        start: Position of the shape relative to the closest point on a, m.
        centre_offset: Vector from the centre of this cylinder to that of the other cylinder, m;
            zero unless both shapes are cylinders.
        axes: Axes of the contact frame.
        scratch: Scratch array.
        column: First of the three columns to write.

    Returns:
        The number of corners, 2 for a line, and the outward normal of the face. Corners are
        counterclockwise seen from outside.
    """
    half = point(table.half, s)
    if table.kind[s] == BOX:
        return _write_box_face(half, rotation, d, start, axes, scratch, column)
    if table.kind[s] == CYLINDER:
        return _write_cylinder_feature(
            half, rotation, d, start, centre_offset, axes, scratch, column
        )
    return _write_hull_face(table, s, rotation, d, start, axes, scratch, column)
