"""Contact points of two convex shapes (contact manifold) by clipping of their facing features.

The feature of a shape is the face, the cap or the line on a cylinder's side that faces the other
shape. The two features are projected along the normal and clipped against each other
(Sutherland-Hodgman). The corners of the clipped polygon are the contact points.

Features are in the contact frame: x and y are tangential, z is along the normal, and the origin is
the closest point on a.

References:
    I. Sutherland and G. Hodgman, Reentrant polygon clipping (1974).
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.features import write_feature
from bulletuav.geometry.minkowski import Mat3, rotate_to_world, scratch_vec3
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus, point
from bulletuav.geometry.shapes import CYLINDER, HALF_SPACE, SPHERE

MAX_POINTS = 20
"""Maximum number of contact points of a pair"""
MERGE_DISTANCE = 1e-6
"""Distance below which two contact points are merged, m"""
LINE_TOLERANCE = 0.05
"""Maximum tangential distance of the facing lines of two cylinders, as a fraction of the smaller
radius; also the sine of the angle above which two lines cross
"""
A_COLUMN, B_COLUMN, SPARE_COLUMN = 0, 3, 6
"""First scratch columns of the feature of a, of the feature of b, and of the clipped polygon"""
HEIGHT = 9
"""Scratch column of the other shape's height at a corner, m"""


@func
def _contact_frame(normal: Vec3Like) -> Mat3:
    """Return the axes of the contact frame: two tangential unit vectors and the normal."""
    # Cross product of the normal and the world's x or z axis, whichever is not close to it
    steep = abs(normal[2]) >= 0.8
    first = (0.0, -normal[2], normal[1]) if steep else (-normal[1], normal[0], 0.0)
    scale = 1.0 / math.sqrt(dot(first, first))
    first = (scale * first[0], scale * first[1], scale * first[2])
    return first, cross(normal, first), (normal[0], normal[1], normal[2])


@func
def _clip_by_line(
    scratch: np.ndarray,
    count: int,
    source: int,
    target: int,
    corner: tuple[float, float],
    inward: tuple[float, float],
) -> int:
    """Clip a polygon by a half-plane; return the number of corners left."""
    kept = 0
    last = count - 1
    there = (scratch[last, source] - corner[0]) * inward[0]
    there += (scratch[last, source + 1] - corner[1]) * inward[1]
    for k in range(count):
        here = (scratch[k, source] - corner[0]) * inward[0]
        here += (scratch[k, source + 1] - corner[1]) * inward[1]
        # The edge from the previous corner crosses the line
        if (here >= 0.0) != (there >= 0.0):
            fraction = there / (there - here)
            for m in range(3):
                before = scratch[last, source + m]
                scratch[kept, target + m] = before + fraction * (scratch[k, source + m] - before)
            kept += 1
        if here >= 0.0:
            for m in range(3):
                scratch[kept, target + m] = scratch[k, source + m]
            kept += 1
        last = k
        there = here
    return kept


@func
def _clip_polygon(
    scratch: np.ndarray, count: int, column: int, sides: int, others: int, sign: float
) -> tuple[int, int]:
    """Clip a polygon or line by all edges of another polygon (Sutherland-Hodgman).

    Args:
        scratch: Scratch array.
        count: Number of corners of the polygon to clip.
        column: First column of its corners.
        sides: Number of corners of the clipping polygon.
        others: First column of its corners.
        sign: 1 if the clipping polygon is counterclockwise in the contact frame, -1 if clockwise.

    Returns:
        The number of corners left, and their first column.
    """
    source = column
    target = SPARE_COLUMN
    last = sides - 1
    for k in range(sides):
        corner = (scratch[last, others], scratch[last, others + 1])
        east = scratch[k, others] - corner[0]
        north = scratch[k, others + 1] - corner[1]
        count = _clip_by_line(scratch, count, source, target, corner, (-sign * north, sign * east))
        source, target = target, source
        last = k
    return count, source


@func
def _clip_lines(scratch: np.ndarray, max_offset: float) -> int:
    """Clip the line of a by the extent of the line of b; return the number of end points left.

    Args:
        scratch: Scratch array with both lines. The clipped line stays in the columns of a.
        max_offset: Maximum tangential distance of the lines, m.
    """
    start = (scratch[0, B_COLUMN], scratch[0, B_COLUMN + 1])
    ahead = (scratch[1, B_COLUMN] - start[0], scratch[1, B_COLUMN + 1] - start[1])
    end = (scratch[1, B_COLUMN], scratch[1, B_COLUMN + 1])
    square = ahead[0] * ahead[0] + ahead[1] * ahead[1]
    # Crossing lines touch at the closest points only
    across = (
        scratch[1, A_COLUMN] - scratch[0, A_COLUMN],
        scratch[1, A_COLUMN + 1] - scratch[0, A_COLUMN + 1],
    )
    turned_by = ahead[0] * across[1] - ahead[1] * across[0]
    length = across[0] * across[0] + across[1] * across[1]
    if turned_by * turned_by > LINE_TOLERANCE * LINE_TOLERANCE * square * length:
        return 0
    count = _clip_by_line(scratch, 2, A_COLUMN, SPARE_COLUMN, start, ahead)
    count = _clip_by_line(scratch, count, SPARE_COLUMN, A_COLUMN, end, (-ahead[0], -ahead[1]))
    low = scratch[0, B_COLUMN + 2]
    rise = scratch[1, B_COLUMN + 2] - low
    kept = 0
    for k in range(count):
        east = scratch[k, A_COLUMN] - start[0]
        north = scratch[k, A_COLUMN + 1] - start[1]
        aside = ahead[0] * north - ahead[1] * east
        # With a large tangential offset, round sides do not face each other
        if aside * aside <= max_offset * max_offset * square:
            fraction = (ahead[0] * east + ahead[1] * north) / square
            for m in range(3):
                scratch[kept, A_COLUMN + m] = scratch[k, A_COLUMN + m]
            scratch[kept, HEIGHT] = low + fraction * rise
            kept += 1
    return kept


@func
def _write_heights(
    scratch: np.ndarray, count: int, source: int, corner: Vec3, normal: Vec3, axes: Mat3
) -> None:
    """Write the height of a face at the corners of a polygon to the scratch array."""
    along = dot(normal, axes[2])
    east = -dot(normal, axes[0]) / along
    north = -dot(normal, axes[1]) / along
    for k in range(count):
        x = scratch[k, source] - corner[0]
        y = scratch[k, source + 1] - corner[1]
        scratch[k, HEIGHT] = corner[2] + east * x + north * y


@func
def _is_new_point(points: np.ndarray, count: int, place: Vec3) -> bool:
    """Return True if no contact point exists within MERGE_DISTANCE of a position."""
    for m in range(count):
        offset = minus(place, point(points, m))
        if dot(offset, offset) <= MERGE_DISTANCE * MERGE_DISTANCE:
            return False
    return True


@func
def _clip_features(
    scratch: np.ndarray, count_a: int, count_b: int, face_a: Vec3, face_b: Vec3, axes: Mat3
) -> tuple[int, int, float]:
    """Clip two features against each other, at least one of which is a polygon.

    Returns:
        The number of corners left, their first column, and 1 if they lie on a, -1 if on b.
    """
    if count_b > 2:
        count, source = _clip_polygon(scratch, count_a, A_COLUMN, count_b, B_COLUMN, 1.0)
        _write_heights(scratch, count, source, scratch_vec3(scratch, 0, B_COLUMN), face_b, axes)
        return count, source, 1.0
    # The face of a is clockwise in the contact frame
    count, source = _clip_polygon(scratch, count_b, B_COLUMN, count_a, A_COLUMN, -1.0)
    _write_heights(scratch, count, source, scratch_vec3(scratch, 0, A_COLUMN), face_a, axes)
    return count, source, -1.0


@func
def _add_point(points: np.ndarray, count: int, place: Vec3, distance: float) -> int:
    """Add a contact point unless it exists already; return the number of points."""
    if not _is_new_point(points, count, place):
        return count
    for m in range(3):
        points[count, m] = place[m]
    points[count, 3] = distance
    return count + 1


@func
def _add_clipped_points(
    scratch: np.ndarray,
    count: int,
    source: int,
    sign: float,
    axes: Mat3,
    on_a: Vec3Like,
    max_distance: float,
    points: np.ndarray,
) -> int:
    """Add clipped corners within the maximum distance as contact points; return their number.

    All points lie in the plane of the first one. Otherwise no motion of the shapes could bring all
    points to rest.
    """
    middle = -0.5 * points[0, 3]
    near = 0
    for k in range(count):
        if sign * (scratch[k, source + 2] - scratch[k, HEIGHT]) <= max_distance:
            for m in range(3):
                scratch[near, source + m] = scratch[k, source + m]
            scratch[near, HEIGHT] = scratch[k, HEIGHT]
            near += 1
    # If there are too many corners, select evenly spaced ones
    taken = min(near, min(MAX_POINTS, points.shape[0]) - 1)
    found = 1
    for m in range(taken):
        k = m * near // taken
        height = scratch[k, source + 2]
        other = scratch[k, HEIGHT]
        local = (scratch[k, source], scratch[k, source + 1], middle)
        place = plus(on_a, 1.0, rotate_to_world(axes, local))
        found = _add_point(points, found, place, sign * (height - other))
    return found


@kernel
def contact_points(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    normal: Vec3,
    on_a: Vec3,
    on_b: Vec3,
    max_distance: float,
    points: np.ndarray,
    scratch: np.ndarray,
) -> int:
    """Compute the contact points of two convex shapes, the deepest one first.

    Args:
        table: The shapes.
        a: Index of the first shape, which is no half-space.
        rotation_a: Axes of the first shape.
        b: Index of the second shape.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, world axes, m.
        normal: Unit normal from b to a, as returned by `gjk_distance`.
        on_a: Closest point on a, relative to its position, m.
        on_b: Closest point on b, relative to its position, m.
        max_distance: Maximum signed distance of the shapes at a contact point, m. The closest
            points are a contact point in any case.
        points: (M, 4) position relative to a, in the plane across the normal midway between the
            closest points, and signed distance along the normal there, m. MAX_POINTS rows hold all
            points. Written in place.
        scratch: Scratch array of `make_scratch`.

    Returns:
        The number of contact points.
    """
    # The closest points are a contact point, whatever the features are
    distance = dot(minus(minus(on_a, on_b), offset), normal)
    found = _add_point(points, 0, plus(on_a, -0.5 * distance, normal), distance)
    if table.kind[a] == SPHERE or table.kind[b] == SPHERE:
        return found
    axes = _contact_frame(normal)
    start_a = (-on_a[0], -on_a[1], -on_a[2])
    against = (-normal[0], -normal[1], -normal[2])
    aside = (0.0, 0.0, 0.0)
    if table.kind[a] == CYLINDER and table.kind[b] == CYLINDER:
        aside = (offset[0], offset[1], offset[2])
    count, face_a = write_feature(
        table, a, rotation_a, against, start_a, aside, axes, scratch, A_COLUMN
    )
    if table.kind[b] == HALF_SPACE:
        for k in range(count):
            scratch[k, HEIGHT] = -distance
        return _add_clipped_points(scratch, count, A_COLUMN, 1.0, axes, on_a, max_distance, points)
    start_b = minus(offset, on_a)
    aside = (-aside[0], -aside[1], -aside[2])
    count_b, face_b = write_feature(
        table, b, rotation_b, normal, start_b, aside, axes, scratch, B_COLUMN
    )
    if count == 2 and count_b == 2:
        max_offset = LINE_TOLERANCE * min(table.half[a, 0], table.half[b, 0])
        count = _clip_lines(scratch, max_offset)
        return _add_clipped_points(scratch, count, A_COLUMN, 1.0, axes, on_a, max_distance, points)
    count, source, sign = _clip_features(scratch, count, count_b, face_a, face_b, axes)
    return _add_clipped_points(scratch, count, source, sign, axes, on_a, max_distance, points)
