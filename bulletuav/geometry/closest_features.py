"""Closest features of two convex shapes, and their signed distance, solved directly.

GJK needs some twenty iterations for round shapes. Here an approximate direction, such as that of
an earlier result, selects the features on which the closest points lie. A feature against a face
has a closed form. For edges and rims Newton's method finds the direction. A result is accepted only
if it is proved by bounds: the separation along any direction is a lower bound of the distance, and
the distance of any two points is an upper bound. If the bounds differ, and for hulls, GJK is used.
"""

import math

import numpy as np

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.gjk import DUALITY_GAP, MIN_CORE_DISTANCE, gjk_distance
from bulletuav.geometry.minkowski import (
    DISTANCE_RESULT,
    Mat3,
    rotate_to_body,
    shape_margin,
    support_point,
)
from bulletuav.geometry.normal_refinement import (
    Feature,
    closest_line_parameters,
    newton_step,
    orthogonal_part,
    support_pair,
)
from bulletuav.geometry.rotation import Vec3, cross, dot, minus, plus
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE

MAX_ITERATIONS = 8
"""Maximum number of Newton iterations"""
CONVERGED_STEP = 1e-11
"""Change of the direction after which the next one is exact, as Newton's method converges
quadratically
"""
MAX_STEP = 0.5
"""Change of the direction above which Newton's method is abandoned"""
MIN_FACE_COSINE = 0.9
"""Cosine of the angle between a face's normal and the direction above which the face is tried"""
MAX_EDGE_COSINE = 0.05
"""Cosine of the angle between an edge and the direction below which the edge is tried"""
MIN_CROSS_SQUARED = 1e-12
"""Squared sine of the angle below which edges count as parallel"""
UNKNOWN = -1.0
"""Returned instead of a distance if no result was found"""
ORIGIN = (0.0, 0.0, 0.0)
NOT_FOUND = (UNKNOWN, ORIGIN, ORIGIN, ORIGIN)

DistanceResult = tuple[float, Vec3, Vec3, Vec3]
"""Signed distance or UNKNOWN, unit normal from b to a, closest points relative to a and to b, m.
"""


@func
def _find_face(table: ShapeTable, s: int, rotation: Mat3, d: Vec3) -> tuple[int, Vec3]:
    """Return the axis index and outward normal of the face that faces d; index -1 for none."""
    local = rotate_to_body(rotation, d)
    if table.kind[s] == CYLINDER:
        if abs(local[2]) < MIN_FACE_COSINE:
            return -1, ORIGIN
        return 2, plus(ORIGIN, math.copysign(1.0, local[2]), rotation[2])
    if table.kind[s] == BOX:
        for k in range(3):
            if abs(local[k]) >= MIN_FACE_COSINE:
                axis = rotation[0] if k == 0 else (rotation[1] if k == 1 else rotation[2])
                return k, plus(ORIGIN, math.copysign(1.0, local[k]), axis)
    return -1, ORIGIN


@func
def _is_over_face(table: ShapeTable, s: int, rotation: Mat3, face: int, place: Vec3) -> bool:
    """Return True if the projection of a point onto a face lies inside the face."""
    local = rotate_to_body(rotation, place)
    if table.kind[s] == CYLINDER:
        radius = table.half[s, 0]
        over: bool = local[0] * local[0] + local[1] * local[1] <= radius * radius
        return over
    for k in range(3):
        if k != face and abs(local[k]) > table.half[s, k]:
            return False
    return True


@func
def _solve_face(
    table: ShapeTable,
    s: int,
    rotation: Mat3,
    other: int,
    other_rotation: Mat3,
    offset: Vec3,
    d: Vec3,
) -> tuple[float, Vec3, Vec3]:
    """Compute the distance of a shape from a face of another one.

    Args:
        table: The shapes.
        s: Index of the shape with the face.
        rotation: Axes of that shape.
        other: Index of the other shape.
        other_rotation: Axes of the other shape.
        offset: Position of the other shape minus that of s, m.
        d: Direction from s to the other shape.

    Returns:
        The height above the face, m, or UNKNOWN. The unit normal of the face. The lowest point of
        the other shape relative to the position of s, m.
    """
    face, normal = _find_face(table, s, rotation, d)
    if face < 0:
        return UNKNOWN, ORIGIN, ORIGIN
    low = support_point(table, other, other_rotation, (-normal[0], -normal[1], -normal[2]))
    low = plus(plus(low, 1.0, offset), -shape_margin(table, other), normal)
    height = dot(low, normal) - table.half[s, face]
    if height <= MIN_CORE_DISTANCE or not _is_over_face(table, s, rotation, face, low):
        return UNKNOWN, ORIGIN, ORIGIN
    return height, normal, low


@func
def _find_feature(
    table: ShapeTable, s: int, rotation: Mat3, d: Vec3, edges: bool
) -> tuple[Feature, float]:
    """Return the edge, rim or corner that faces d, and the half length of an edge, m."""
    if table.kind[s] == SPHERE:
        return (True, ORIGIN, ORIGIN, 0.0), 0.0
    local = rotate_to_body(rotation, d)
    if table.kind[s] == CYLINDER:
        along = edges and abs(local[2]) < MAX_EDGE_COSINE
        return (True, rotation[2] if along else ORIGIN, rotation[2], table.half[s, 0]), table.half[
            s, 2
        ]
    k = 0
    for m in range(1, 3):
        if abs(local[m]) < abs(local[k]):
            k = m
    axis = rotation[0] if k == 0 else (rotation[1] if k == 1 else rotation[2])
    if edges and abs(local[k]) < MAX_EDGE_COSINE:
        return (True, axis, ORIGIN, 0.0), table.half[s, k]
    return (True, ORIGIN, ORIGIN, 0.0), 0.0


@func
def _has_edge(feature: Feature) -> bool:
    """Return True if a feature is an edge or a line on the side of a cylinder."""
    result: bool = dot(feature[1], feature[1]) > 0.0
    return result


@func
def _normalise(v: Vec3) -> tuple[float, Vec3]:
    """Return the length of a vector, and its unit vector."""
    size = math.sqrt(dot(v, v))
    return size, (v[0] / size, v[1] / size, v[2] / size)


@func
def _solve_direction(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    one: Feature,
    two: Feature,
    d: Vec3,
) -> tuple[bool, Vec3]:
    """Solve for the direction between two features by Newton's method, starting at d.

    Returns:
        Whether the method did not fail, and the direction.
    """
    # Only the part orthogonal to an edge counts
    edge = one[1] if _has_edge(one) else two[1]
    _, d = _normalise(orthogonal_part(edge, d))
    for _ in range(MAX_ITERATIONS):
        # Support points along d, and the direction between them
        _, _, separation = support_pair(table, a, rotation_a, b, rotation_b, offset, d)
        size, result = _normalise(orthogonal_part(edge, separation))
        if not dot(result, d) > 0.0:
            return False, d
        # Basis of the tangent plane at d, in which a step has two components
        first = cross(d, (1.0, 0.0, 0.0) if abs(d[0]) < 0.7 else (0.0, 1.0, 0.0))
        _, first = _normalise(first)
        second = cross(d, first)
        step_first, step_second = newton_step(one, two, edge, d, result, size, first, second)
        # A step that is too long, or NaN, comes from degenerate rims
        square = step_first * step_first + step_second * step_second
        if not square < MAX_STEP * MAX_STEP:
            return False, d
        _, d = _normalise(
            orthogonal_part(edge, plus(plus(d, step_first, first), step_second, second))
        )
        if square < CONVERGED_STEP * CONVERGED_STEP:
            return True, d
    return True, d


@func
def _move_along_edges(
    one: Feature,
    half_length_a: float,
    two: Feature,
    half_length_b: float,
    on_a: Vec3,
    on_b: Vec3,
    offset: Vec3,
) -> tuple[bool, Vec3, Vec3]:
    """Move points along their edges to where they are closest to each other.

    Returns:
        Whether the points lie within the edges, and the points.
    """
    separation = minus(minus(on_a, on_b), offset)
    if _has_edge(one) and _has_edge(two):
        # Skew lines have unique closest points
        across = cross(one[1], two[1])
        square = dot(across, across)
        if square > MIN_CROSS_SQUARED:
            far_a, far_b = closest_line_parameters(one[1], two[1], square, separation)
            on_a = plus(on_a, far_a, one[1])
            on_b = plus(on_b, far_b, two[1])
        else:
            # Parallel edges: the middle of their common part
            there = dot(offset, one[1])
            low = max(-half_length_a, there - half_length_b)
            high = min(half_length_a, there + half_length_b)
            middle = 0.5 * (low + high)
            on_a = plus(on_a, middle - dot(on_a, one[1]), one[1])
            on_b = plus(on_b, middle - there - dot(on_b, one[1]), one[1])
    elif _has_edge(one):
        on_a = plus(on_a, -dot(separation, one[1]), one[1])
    elif _has_edge(two):
        on_b = plus(on_b, dot(separation, two[1]), two[1])
    # Beyond the ends of an edge a corner is closer
    fits = not _has_edge(one) or abs(dot(on_a, one[1])) <= half_length_a
    fits = fits and (not _has_edge(two) or abs(dot(on_b, two[1])) <= half_length_b)
    return fits, on_a, on_b


@func
def _solve_edges(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    d: Vec3,
    one: Feature,
    half_length_a: float,
    two: Feature,
    half_length_b: float,
) -> DistanceResult:
    """Compute the closest points of two edges, rims or corners; see `solve_closest_features`.

    `half_length_a` and `half_length_b` are the half lengths of edges, m.
    """
    crossing = cross(one[1], two[1])
    if dot(crossing, crossing) > MIN_CROSS_SQUARED:
        _, crossing = _normalise(crossing)
        d = crossing if dot(crossing, d) > 0.0 else plus(ORIGIN, -1.0, crossing)
    else:
        solved, d = _solve_direction(table, a, rotation_a, b, rotation_b, offset, one, two, d)
        if not solved:
            return NOT_FOUND
    on_a, on_b, separation = support_pair(table, a, rotation_a, b, rotation_b, offset, d)
    lower_bound = dot(separation, d)
    fits, on_a, on_b = _move_along_edges(one, half_length_a, two, half_length_b, on_a, on_b, offset)
    separation = minus(minus(on_a, on_b), offset)
    if not (
        fits
        and lower_bound > MIN_CORE_DISTANCE
        and math.sqrt(dot(separation, separation)) - lower_bound <= DUALITY_GAP
    ):
        return NOT_FOUND
    margin_a = shape_margin(table, a)
    margin_b = shape_margin(table, b)
    return lower_bound - margin_a - margin_b, d, plus(on_a, -margin_a, d), plus(on_b, margin_b, d)


@deferred(DISTANCE_RESULT)
@kernel
def solve_closest_features(
    table: ShapeTable, a: int, rotation_a: Mat3, b: int, rotation_b: Mat3, offset: Vec3, d: Vec3
) -> DistanceResult:
    """Compute the signed distance of two shapes from the features that face a given direction.

    Args:
        table: The shapes; a and b are no half-spaces.
        a: Index of the first shape.
        rotation_a: Axes of the first shape.
        b: Index of the second shape.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, world axes, m.
        d: Unit vector from b to a, approximately the normal of the result.

    Returns:
        The result of `gjk_distance`. The distance is UNKNOWN if the shapes overlap, or if no pair
        of features was proved to be the closest.
    """
    if table.kind[a] == HULL or table.kind[b] == HULL:
        return NOT_FOUND
    away = (-offset[0], -offset[1], -offset[2])
    height, normal, low = _solve_face(table, b, rotation_b, a, rotation_a, away, d)
    if height > 0.0:
        return height, normal, plus(low, 1.0, offset), plus(low, -height, normal)
    back = (-d[0], -d[1], -d[2])
    height, normal, low = _solve_face(table, a, rotation_a, b, rotation_b, offset, back)
    if height > 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
        return height, normal, plus(low, height, normal), minus(low, offset)
    # Try edges first, then the corner or rim at the end of one or both
    edge_a, half_length_a = _find_feature(table, a, rotation_a, back, True)
    edge_b, half_length_b = _find_feature(table, b, rotation_b, d, True)
    end_a, _ = _find_feature(table, a, rotation_a, back, False)
    end_b, _ = _find_feature(table, b, rotation_b, d, False)
    result = NOT_FOUND
    for k in range(4):
        one = edge_a if k < 2 else end_a
        two = edge_b if k % 2 == 0 else end_b
        # Without an edge this combination was tried already
        known = (k >= 2 and not _has_edge(edge_a)) or (k % 2 == 1 and not _has_edge(edge_b))
        if result[0] == UNKNOWN and not known:
            result = _solve_edges(
                table,
                a,
                rotation_a,
                b,
                rotation_b,
                offset,
                d,
                one,
                half_length_a,
                two,
                half_length_b,
            )
    return result


@kernel
def closest_features(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    guess: Vec3,
    scratch: np.ndarray,
) -> DistanceResult:
    """Compute the signed distance of two shapes, with a normal that is as accurate as possible.

    The direct solution is tried first, then GJK. Arguments and results are those of `gjk_distance`.
    """
    if table.kind[b] == HALF_SPACE:
        return gjk_distance(table, a, rotation_a, b, rotation_b, offset, guess, scratch)
    d = guess
    if dot(d, d) == 0.0:
        d = (-offset[0], -offset[1], -offset[2])
    square = dot(d, d)
    if square > 0.0:
        _, d = _normalise(d)
        result = solve_closest_features(table, a, rotation_a, b, rotation_b, offset, d)
        if result[0] != UNKNOWN:
            return result
    # From a good guess, GJK's support points on a round side are too close to each other
    if table.kind[a] == CYLINDER or table.kind[b] == CYLINDER:
        guess = ORIGIN
    result = gjk_distance(table, a, rotation_a, b, rotation_b, offset, guess, scratch)
    # The normal of GJK may select the features
    if result[0] > MIN_CORE_DISTANCE:
        better = solve_closest_features(table, a, rotation_a, b, rotation_b, offset, result[1])
        if better[0] != UNKNOWN:
            return better
    return result
