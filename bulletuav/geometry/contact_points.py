"""Points where two convex shapes touch or nearly do: their facing features, clipped.

The feature of a shape is the face, the flat side or the line of its round side that looks at the
other shape. Two features are laid over each other across the normal and clipped (I. Sutherland and
G. Hodgman, Reentrant polygon clipping, 1974). Corners of what is left are the points.

Features are in axes of the contact: x and y across the normal, z along it, from the nearest point
on a.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.features import put_feature
from bulletuav.geometry.minkowski import Turn, row_point, turned
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus, point
from bulletuav.geometry.shapes import CYLINDER, HALF_SPACE, SPHERE

MOST_POINTS = 20
"""Most points of a pair"""
SAME = 1e-6
"""Distance within which two points count as one, m"""
BESIDE = 0.05
"""How far two lines of round sides may lie beside each other, as a share of the lesser radius; and
sine of the angle from which on they cross"""
A_COLUMN, B_COLUMN, SPARE_COLUMN = 0, 3, 6
"""First columns of scratch of the feature of a, of that of b, and of clipping"""
HEIGHT = 9
"""Column of scratch: how high the other shape is at a corner, m"""


@func
def _across(normal: Vec3Like) -> Turn:
    """Return the axes of the contact: two across a unit vector, and itself."""
    # Cross the normal with the world's axis x or z, whichever is far from it
    steep = abs(normal[2]) >= 0.8
    first = (0.0, -normal[2], normal[1]) if steep else (-normal[1], normal[0], 0.0)
    scale = 1.0 / math.sqrt(dot(first, first))
    first = (scale * first[0], scale * first[1], scale * first[2])
    return first, cross(normal, first), (normal[0], normal[1], normal[2])


@func
def _cut(
    room: np.ndarray,
    count: int,
    source: int,
    target: int,
    corner: tuple[float, float],
    inward: tuple[float, float],
) -> int:
    """Keep the part of a polygon on one side of a line; return how many corners it has."""
    kept = 0
    last = count - 1
    there = (room[last, source] - corner[0]) * inward[0]
    there += (room[last, source + 1] - corner[1]) * inward[1]
    for k in range(count):
        here = (room[k, source] - corner[0]) * inward[0]
        here += (room[k, source + 1] - corner[1]) * inward[1]
        # The side from the corner before crosses the line
        if (here >= 0.0) != (there >= 0.0):
            share = there / (there - here)
            for m in range(3):
                before = room[last, source + m]
                room[kept, target + m] = before + share * (room[k, source + m] - before)
            kept += 1
        if here >= 0.0:
            for m in range(3):
                room[kept, target + m] = room[k, source + m]
            kept += 1
        last = k
        there = here
    return kept


@func
def _clip(
    room: np.ndarray, count: int, column: int, sides: int, others: int, sign: float
) -> tuple[int, int]:
    """Keep the part of a polygon or line over or under another polygon.

    Args:
        room: Scratch.
        count: Number of corners of the first.
        column: First column of its corners.
        sides: Number of corners of the other.
        others: First column of its corners.
        sign: 1 where the other turns left in axes of the contact, -1 where it turns right.

    Returns:
        How many corners there are, and their first column.
    """
    source = column
    target = SPARE_COLUMN
    last = sides - 1
    for k in range(sides):
        corner = (room[last, others], room[last, others + 1])
        east = room[k, others] - corner[0]
        north = room[k, others + 1] - corner[1]
        count = _cut(room, count, source, target, corner, (-sign * north, sign * east))
        source, target = target, source
        last = k
    return count, source


@func
def _lines_meet(room: np.ndarray, beside: float) -> int:
    """Keep the part of the line of a that lies beside that of b; return how many ends it has.

    Args:
        room: Scratch with both lines. What is left of that of a stays in its columns.
        beside: How far the lines may be from each other across the normal, m.
    """
    start = (room[0, B_COLUMN], room[0, B_COLUMN + 1])
    ahead = (room[1, B_COLUMN] - start[0], room[1, B_COLUMN + 1] - start[1])
    end = (room[1, B_COLUMN], room[1, B_COLUMN + 1])
    square = ahead[0] * ahead[0] + ahead[1] * ahead[1]
    # Where they cross, they touch at the nearest points alone
    across = (room[1, A_COLUMN] - room[0, A_COLUMN], room[1, A_COLUMN + 1] - room[0, A_COLUMN + 1])
    turned_by = ahead[0] * across[1] - ahead[1] * across[0]
    length = across[0] * across[0] + across[1] * across[1]
    if turned_by * turned_by > BESIDE * BESIDE * square * length:
        return 0
    count = _cut(room, 2, A_COLUMN, SPARE_COLUMN, start, ahead)
    count = _cut(room, count, SPARE_COLUMN, A_COLUMN, end, (-ahead[0], -ahead[1]))
    low = room[0, B_COLUMN + 2]
    rise = room[1, B_COLUMN + 2] - low
    kept = 0
    for k in range(count):
        east = room[k, A_COLUMN] - start[0]
        north = room[k, A_COLUMN + 1] - start[1]
        aside = ahead[0] * north - ahead[1] * east
        # Round sides are no longer opposite each other off to a side
        if aside * aside <= beside * beside * square:
            share = (ahead[0] * east + ahead[1] * north) / square
            for m in range(3):
                room[kept, A_COLUMN + m] = room[k, A_COLUMN + m]
            room[kept, HEIGHT] = low + share * rise
            kept += 1
    return kept


@func
def _heights(
    room: np.ndarray, count: int, source: int, corner: Vec3, normal: Vec3, axes: Turn
) -> None:
    """Put how high a face is at the corners of a polygon into scratch."""
    along = dot(normal, axes[2])
    east = -dot(normal, axes[0]) / along
    north = -dot(normal, axes[1]) / along
    for k in range(count):
        x = room[k, source] - corner[0]
        y = room[k, source + 1] - corner[1]
        room[k, HEIGHT] = corner[2] + east * x + north * y


@func
def _is_new(points: np.ndarray, count: int, place: Vec3) -> bool:
    """Return whether a place is none of those that are already there."""
    for m in range(count):
        way = minus(place, point(points, m))
        if dot(way, way) <= SAME * SAME:
            return False
    return True


@func
def _overlay(
    room: np.ndarray, count_a: int, count_b: int, face_a: Vec3, face_b: Vec3, axes: Turn
) -> tuple[int, int, float]:
    """Clip two features against each other, of which one at least is a polygon.

    Returns:
        How many corners are left, their first column, and 1 where they lie on a, -1 where on b.
    """
    if count_b > 2:
        count, source = _clip(room, count_a, A_COLUMN, count_b, B_COLUMN, 1.0)
        _heights(room, count, source, row_point(room, 0, B_COLUMN), face_b, axes)
        return count, source, 1.0
    # The face of a is seen from its back
    count, source = _clip(room, count_b, B_COLUMN, count_a, A_COLUMN, -1.0)
    _heights(room, count, source, row_point(room, 0, A_COLUMN), face_a, axes)
    return count, source, -1.0


@func
def _put_point(points: np.ndarray, count: int, place: Vec3, distance: float) -> int:
    """Add a point unless it is already there; return how many there are."""
    if not _is_new(points, count, place):
        return count
    for m in range(3):
        points[count, m] = place[m]
    points[count, 3] = distance
    return count + 1


@func
def _collect(
    room: np.ndarray,
    count: int,
    source: int,
    sign: float,
    axes: Turn,
    on_a: Vec3Like,
    most: float,
    points: np.ndarray,
) -> int:
    """Add the corners that are left and near to the points; return how many there are.

    All lie in the plane of the first, or else no motion of the shapes could leave all at rest.
    """
    middle = -0.5 * points[0, 3]
    near = 0
    for k in range(count):
        if sign * (room[k, source + 2] - room[k, HEIGHT]) <= most:
            for m in range(3):
                room[near, source + m] = room[k, source + m]
            room[near, HEIGHT] = room[k, HEIGHT]
            near += 1
    # Of too many, take some from all around
    taken = min(near, min(MOST_POINTS, points.shape[0]) - 1)
    found = 1
    for m in range(taken):
        k = m * near // taken
        height = room[k, source + 2]
        other = room[k, HEIGHT]
        local = (room[k, source], room[k, source + 1], middle)
        place = plus(on_a, 1.0, turned(axes, local))
        found = _put_point(points, found, place, sign * (height - other))
    return found


@kernel
def contact_points(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3,
    normal: Vec3,
    on_a: Vec3,
    on_b: Vec3,
    most: float,
    points: np.ndarray,
    room: np.ndarray,
) -> int:
    """Find points that stand for the contact of two shapes, the nearest ones first.

    Args:
        table: The shapes.
        a: Number of the first shape, no half space.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, world axes, m.
        normal: Unit normal from b to a, as `gap` gives.
        on_a: Nearest point on a from its position, m.
        on_b: Nearest point on b from its position, m.
        most: Largest distance of the shapes at a point, m; the nearest points count in any case.
        points: (M, 4) place from the position of a, in the plane across the normal midway between
            the nearest points, and the signed distance along the normal there, m; MOST_POINTS rows
            hold all. Filled in place.
        room: Scratch of `make_room`.

    Returns:
        How many points there are.
    """
    # The nearest points are a contact whatever the features are
    distance = dot(minus(minus(on_a, on_b), offset), normal)
    found = _put_point(points, 0, plus(on_a, -0.5 * distance, normal), distance)
    if table.kind[a] == SPHERE or table.kind[b] == SPHERE:
        return found
    axes = _across(normal)
    start_a = (-on_a[0], -on_a[1], -on_a[2])
    against = (-normal[0], -normal[1], -normal[2])
    aside = (0.0, 0.0, 0.0)
    if table.kind[a] == CYLINDER and table.kind[b] == CYLINDER:
        aside = (offset[0], offset[1], offset[2])
    count, face_a = put_feature(table, a, turn_a, against, start_a, aside, axes, room, A_COLUMN)
    if table.kind[b] == HALF_SPACE:
        for k in range(count):
            room[k, HEIGHT] = -distance
        return _collect(room, count, A_COLUMN, 1.0, axes, on_a, most, points)
    start_b = minus(offset, on_a)
    aside = (-aside[0], -aside[1], -aside[2])
    count_b, face_b = put_feature(table, b, turn_b, normal, start_b, aside, axes, room, B_COLUMN)
    if count == 2 and count_b == 2:
        beside = BESIDE * min(table.half[a, 0], table.half[b, 0])
        count = _lines_meet(room, beside)
        return _collect(room, count, A_COLUMN, 1.0, axes, on_a, most, points)
    count, source, sign = _overlay(room, count, count_b, face_a, face_b, axes)
    return _collect(room, count, source, sign, axes, on_a, most, points)
