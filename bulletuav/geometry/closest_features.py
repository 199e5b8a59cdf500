"""Nearest points of two shapes, solved for directly where they lie on faces, edges or rims.

GJK takes some twenty steps to the nearest points of round shapes. Here the direction of an earlier
answer tells on which features they lie. A feature against a face has a closed form; for edges and
rims Newton's method finds the direction. What is found counts only if it is proved: no two shapes
are nearer than the planes across a direction, nor farther than two of their points. Where these
differ, and for hulls, GJK is asked.
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
"""Most steps of Newton's method"""
CONVERGED_STEP = 1e-11
"""Change of a direction after which the next one is exact, as errors are squared"""
MAX_STEP = 0.5
"""Change of a direction beyond which Newton's method is not trusted"""
MIN_FACE_COSINE = 0.9
"""Cosine of the angle between a face and a direction up to which the face is tried"""
MAX_EDGE_COSINE = 0.05
"""Cosine of the angle between an edge and a direction below which the edge is tried"""
MIN_CROSS_SQUARED = 1e-12
"""Square of the sine of the angle below which edges count as parallel"""
UNKNOWN = -1.0
"""Instead of a distance: not found"""
ORIGIN = (0.0, 0.0, 0.0)
NOT_FOUND = (UNKNOWN, ORIGIN, ORIGIN, ORIGIN)

DistanceResult = tuple[float, Vec3, Vec3, Vec3]
"""Distance or UNKNOWN, unit normal from b to a, nearest points from the positions of a and b, m."""


@func
def _find_face(table: ShapeTable, s: int, rotation: Mat3, d: Vec3) -> tuple[int, Vec3]:
    """Return the number of the axis across the face that looks along d, and it; -1 for none."""
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
    """Tell whether a place from the position of a shape lies over one of its faces."""
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
    """Measure a shape over a face of another one.

    Args:
        table: The shapes.
        s: Number of the shape with the face.
        turn: Its axes.
        other: Number of the other one.
        other_turn: Its axes.
        offset: Position of the other less that of s, m.
        d: Direction from s to the other.

    Returns:
        Height above the face, m, or UNKNOWN. The unit normal of the face. The lowest point of the
        other from the position of s, m.
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
    """Return the edge, rim or corner that looks along d, and half the length of an edge, m."""
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
    """Tell whether a feature is an edge or the side of a cylinder."""
    result: bool = dot(feature[1], feature[1]) > 0.0
    return result


@func
def _normalise(v: Vec3) -> tuple[float, Vec3]:
    """Return the length of a vector, and its direction."""
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
    """Find the direction that two features have from each other, by Newton's method from d on."""
    # Along an edge the way does not count
    edge = one[1] if _has_edge(one) else two[1]
    _, d = _normalise(orthogonal_part(edge, d))
    for _ in range(MAX_ITERATIONS):
        # Where the points lie that are farthest along d, and how far that is from d
        _, _, separation = support_pair(table, a, rotation_a, b, rotation_b, offset, d)
        size, result = _normalise(orthogonal_part(edge, separation))
        if not dot(result, d) > 0.0:
            return False, d
        # Two axes across d, in which a step is two numbers
        first = cross(d, (1.0, 0.0, 0.0) if abs(d[0]) < 0.7 else (0.0, 1.0, 0.0))
        _, first = _normalise(first)
        second = cross(d, first)
        step_first, step_second = newton_step(one, two, edge, d, result, size, first, second)
        # A step too long, or NaN, comes from rims without a sure direction
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
    """Move points along their edges to where they are nearest; tells whether that is on them."""
    separation = minus(minus(on_a, on_b), offset)
    if _has_edge(one) and _has_edge(two):
        # Two lines that cross at an angle are nearest at one point each
        across = cross(one[1], two[1])
        square = dot(across, across)
        if square > MIN_CROSS_SQUARED:
            far_a, far_b = closest_line_parameters(one[1], two[1], square, separation)
            on_a = plus(on_a, far_a, one[1])
            on_b = plus(on_b, far_b, two[1])
        else:
            # In the middle of where one is beside the other
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
    # Beyond the ends of an edge a corner is nearer
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
    """Solve for the nearest points of two edges, rims or corners about a direction; see `solve_closest_features`.

    `half_length_a` and `half_length_b` are half the lengths of edges.
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
    """Return what `gjk_distance` does, if a direction leads to it at once.

    Args:
        table: The shapes; a and b are no half spaces.
        a: Number of the first shape.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, world axes, m.
        d: Unit vector from b to a, about the answer's.

    Returns:
        The answer of `gjk_distance`. UNKNOWN comes instead of a distance if the shapes overlap, or nothing
        was found.
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
    # Edges first, then what is at the end of one or both
    edge_a, half_length_a = _find_feature(table, a, rotation_a, back, True)
    edge_b, half_length_b = _find_feature(table, b, rotation_b, d, True)
    end_a, _ = _find_feature(table, a, rotation_a, back, False)
    end_b, _ = _find_feature(table, b, rotation_b, d, False)
    result = NOT_FOUND
    for k in range(4):
        one = edge_a if k < 2 else end_a
        two = edge_b if k % 2 == 0 else end_b
        # Without an edge its end was tried already
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
    """Return the signed distance of two shapes as `gjk_distance` does, its direction as exact as can be.

    It takes what `gjk_distance` takes.
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
    # From a good guess on, GJK's points on a round side lie too close to each other
    if table.kind[a] == CYLINDER or table.kind[b] == CYLINDER:
        guess = ORIGIN
    result = gjk_distance(table, a, rotation_a, b, rotation_b, offset, guess, scratch)
    # What it knows of the direction may lead on
    if result[0] > MIN_CORE_DISTANCE:
        better = solve_closest_features(table, a, rotation_a, b, rotation_b, offset, result[1])
        if better[0] != UNKNOWN:
            return better
    return result
