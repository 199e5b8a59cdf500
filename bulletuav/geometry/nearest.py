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
from bulletuav.geometry.direction import Feature, along_crossing, ends, newton_step, off
from bulletuav.geometry.gjk import DUALITY_GAP, TOUCH_CORE, gap
from bulletuav.geometry.minkowski import ANSWER, Turn, far_point, swell, turned_back
from bulletuav.geometry.rotation import Vec3, cross, dot, minus, plus
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE

MOST_STEPS = 8
"""Most steps of Newton's method"""
SHARP = 1e-11
"""Change of a direction after which the next one is exact, as errors are squared"""
FAR = 0.5
"""Change of a direction beyond which Newton's method is not trusted"""
FACING = 0.9
"""Cosine of the angle between a face and a direction up to which the face is tried"""
ALONG = 0.05
"""Cosine of the angle between an edge and a direction below which the edge is tried"""
PARALLEL = 1e-12
"""Square of the sine of the angle below which edges count as parallel"""
UNKNOWN = -1.0
"""Instead of a distance: not found"""
ORIGIN = (0.0, 0.0, 0.0)
NOTHING = (UNKNOWN, ORIGIN, ORIGIN, ORIGIN)

Answer = tuple[float, Vec3, Vec3, Vec3]
"""Distance or UNKNOWN, unit normal from b to a, nearest points from the positions of a and b, m."""


@func
def _face_along(table: ShapeTable, s: int, turn: Turn, d: Vec3) -> tuple[int, Vec3]:
    """Return the number of the axis across the face that looks along d, and it; -1 for none."""
    local = turned_back(turn, d)
    if table.kind[s] == CYLINDER:
        if abs(local[2]) < FACING:
            return -1, ORIGIN
        return 2, plus(ORIGIN, math.copysign(1.0, local[2]), turn[2])
    if table.kind[s] == BOX:
        for k in range(3):
            if abs(local[k]) >= FACING:
                axis = turn[0] if k == 0 else (turn[1] if k == 1 else turn[2])
                return k, plus(ORIGIN, math.copysign(1.0, local[k]), axis)
    return -1, ORIGIN


@func
def _is_beside(table: ShapeTable, s: int, turn: Turn, face: int, place: Vec3) -> bool:
    """Tell whether a place from the position of a shape lies over one of its faces."""
    local = turned_back(turn, place)
    if table.kind[s] == CYLINDER:
        radius = table.half[s, 0]
        over: bool = local[0] * local[0] + local[1] * local[1] <= radius * radius
        return over
    for k in range(3):
        if k != face and abs(local[k]) > table.half[s, k]:
            return False
    return True


@func
def _over_face(
    table: ShapeTable, s: int, turn: Turn, other: int, other_turn: Turn, offset: Vec3, d: Vec3
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
    face, normal = _face_along(table, s, turn, d)
    if face < 0:
        return UNKNOWN, ORIGIN, ORIGIN
    low = far_point(table, other, other_turn, (-normal[0], -normal[1], -normal[2]))
    low = plus(plus(low, 1.0, offset), -swell(table, other), normal)
    height = dot(low, normal) - table.half[s, face]
    if height <= TOUCH_CORE or not _is_beside(table, s, turn, face, low):
        return UNKNOWN, ORIGIN, ORIGIN
    return height, normal, low


@func
def _feature_along(
    table: ShapeTable, s: int, turn: Turn, d: Vec3, edges: bool
) -> tuple[Feature, float]:
    """Return the edge, rim or corner that looks along d, and half the length of an edge, m."""
    if table.kind[s] == SPHERE:
        return (True, ORIGIN, ORIGIN, 0.0), 0.0
    local = turned_back(turn, d)
    if table.kind[s] == CYLINDER:
        along = edges and abs(local[2]) < ALONG
        return (True, turn[2] if along else ORIGIN, turn[2], table.half[s, 0]), table.half[s, 2]
    k = 0
    for m in range(1, 3):
        if abs(local[m]) < abs(local[k]):
            k = m
    axis = turn[0] if k == 0 else (turn[1] if k == 1 else turn[2])
    if edges and abs(local[k]) < ALONG:
        return (True, axis, ORIGIN, 0.0), table.half[s, k]
    return (True, ORIGIN, ORIGIN, 0.0), 0.0


@func
def _has_edge(feature: Feature) -> bool:
    """Tell whether a feature is an edge or the side of a cylinder."""
    found: bool = dot(feature[1], feature[1]) > 0.0
    return found


@func
def _scaled(v: Vec3) -> tuple[float, Vec3]:
    """Return the length of a vector, and its direction."""
    size = math.sqrt(dot(v, v))
    return size, (v[0] / size, v[1] / size, v[2] / size)


@func
def _towards(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3,
    one: Feature,
    two: Feature,
    d: Vec3,
) -> tuple[bool, Vec3]:
    """Find the direction that two features have from each other, by Newton's method from d on."""
    # Along an edge the way does not count
    edge = one[1] if _has_edge(one) else two[1]
    _, d = _scaled(off(edge, d))
    for _ in range(MOST_STEPS):
        # Where the points lie that are farthest along d, and how far that is from d
        _, _, way = ends(table, a, turn_a, b, turn_b, offset, d)
        size, found = _scaled(off(edge, way))
        if not dot(found, d) > 0.0:
            return False, d
        # Two axes across d, in which a step is two numbers
        first = cross(d, (1.0, 0.0, 0.0) if abs(d[0]) < 0.7 else (0.0, 1.0, 0.0))
        _, first = _scaled(first)
        second = cross(d, first)
        step_first, step_second = newton_step(one, two, edge, d, found, size, first, second)
        # A step too long, or NaN, comes from rims without a sure direction
        square = step_first * step_first + step_second * step_second
        if not square < FAR * FAR:
            return False, d
        _, d = _scaled(off(edge, plus(plus(d, step_first, first), step_second, second)))
        if square < SHARP * SHARP:
            return True, d
    return True, d


@func
def _along_edges(
    one: Feature, long_a: float, two: Feature, long_b: float, on_a: Vec3, on_b: Vec3, offset: Vec3
) -> tuple[bool, Vec3, Vec3]:
    """Move points along their edges to where they are nearest; tells whether that is on them."""
    way = minus(minus(on_a, on_b), offset)
    if _has_edge(one) and _has_edge(two):
        # Two lines that cross at an angle are nearest at one point each
        across = cross(one[1], two[1])
        square = dot(across, across)
        if square > PARALLEL:
            far_a, far_b = along_crossing(one[1], two[1], square, way)
            on_a = plus(on_a, far_a, one[1])
            on_b = plus(on_b, far_b, two[1])
        else:
            # In the middle of where one is beside the other
            there = dot(offset, one[1])
            low = max(-long_a, there - long_b)
            high = min(long_a, there + long_b)
            middle = 0.5 * (low + high)
            on_a = plus(on_a, middle - dot(on_a, one[1]), one[1])
            on_b = plus(on_b, middle - there - dot(on_b, one[1]), one[1])
    elif _has_edge(one):
        on_a = plus(on_a, -dot(way, one[1]), one[1])
    elif _has_edge(two):
        on_b = plus(on_b, dot(way, two[1]), two[1])
    # Beyond the ends of an edge a corner is nearer
    fits = not _has_edge(one) or abs(dot(on_a, one[1])) <= long_a
    fits = fits and (not _has_edge(two) or abs(dot(on_b, two[1])) <= long_b)
    return fits, on_a, on_b


@func
def _between(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3,
    d: Vec3,
    one: Feature,
    long_a: float,
    two: Feature,
    long_b: float,
) -> Answer:
    """Solve for the nearest points of two edges, rims or corners about a direction; see `direct`.

    `long_a` and `long_b` are half the lengths of edges.
    """
    crossing = cross(one[1], two[1])
    if dot(crossing, crossing) > PARALLEL:
        _, crossing = _scaled(crossing)
        d = crossing if dot(crossing, d) > 0.0 else plus(ORIGIN, -1.0, crossing)
    else:
        solved, d = _towards(table, a, turn_a, b, turn_b, offset, one, two, d)
        if not solved:
            return NOTHING
    on_a, on_b, way = ends(table, a, turn_a, b, turn_b, offset, d)
    least = dot(way, d)
    fits, on_a, on_b = _along_edges(one, long_a, two, long_b, on_a, on_b, offset)
    way = minus(minus(on_a, on_b), offset)
    if not (fits and least > TOUCH_CORE and math.sqrt(dot(way, way)) - least <= DUALITY_GAP):
        return NOTHING
    swell_a = swell(table, a)
    swell_b = swell(table, b)
    return least - swell_a - swell_b, d, plus(on_a, -swell_a, d), plus(on_b, swell_b, d)


@deferred(ANSWER)
@kernel
def direct(
    table: ShapeTable, a: int, turn_a: Turn, b: int, turn_b: Turn, offset: Vec3, d: Vec3
) -> Answer:
    """Return what `gap` does, if a direction leads to it at once.

    Args:
        table: The shapes; a and b are no half spaces.
        a: Number of the first shape.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, world axes, m.
        d: Unit vector from b to a, about the answer's.

    Returns:
        The answer of `gap`. UNKNOWN comes instead of a distance if the shapes overlap, or nothing
        was found.
    """
    if table.kind[a] == HULL or table.kind[b] == HULL:
        return NOTHING
    away = (-offset[0], -offset[1], -offset[2])
    height, normal, low = _over_face(table, b, turn_b, a, turn_a, away, d)
    if height > 0.0:
        return height, normal, plus(low, 1.0, offset), plus(low, -height, normal)
    back = (-d[0], -d[1], -d[2])
    height, normal, low = _over_face(table, a, turn_a, b, turn_b, offset, back)
    if height > 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
        return height, normal, plus(low, height, normal), minus(low, offset)
    # Edges first, then what is at the end of one or both
    edge_a, long_a = _feature_along(table, a, turn_a, back, True)
    edge_b, long_b = _feature_along(table, b, turn_b, d, True)
    end_a, _ = _feature_along(table, a, turn_a, back, False)
    end_b, _ = _feature_along(table, b, turn_b, d, False)
    found = NOTHING
    for k in range(4):
        one = edge_a if k < 2 else end_a
        two = edge_b if k % 2 == 0 else end_b
        # Without an edge its end was tried already
        known = (k >= 2 and not _has_edge(edge_a)) or (k % 2 == 1 and not _has_edge(edge_b))
        if found[0] == UNKNOWN and not known:
            found = _between(table, a, turn_a, b, turn_b, offset, d, one, long_a, two, long_b)
    return found


@kernel
def nearest(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3,
    guess: Vec3,
    room: np.ndarray,
) -> Answer:
    """Return the signed distance of two shapes as `gap` does, its direction as exact as can be.

    It takes what `gap` takes.
    """
    if table.kind[b] == HALF_SPACE:
        return gap(table, a, turn_a, b, turn_b, offset, guess, room)
    d = guess
    if dot(d, d) == 0.0:
        d = (-offset[0], -offset[1], -offset[2])
    square = dot(d, d)
    if square > 0.0:
        _, d = _scaled(d)
        found = direct(table, a, turn_a, b, turn_b, offset, d)
        if found[0] != UNKNOWN:
            return found
    # From a good guess on, GJK's points on a round side lie too close to each other
    if table.kind[a] == CYLINDER or table.kind[b] == CYLINDER:
        guess = ORIGIN
    found = gap(table, a, turn_a, b, turn_b, offset, guess, room)
    # What it knows of the direction may lead on
    if found[0] > TOUCH_CORE:
        better = direct(table, a, turn_a, b, turn_b, offset, found[1])
        if better[0] != UNKNOWN:
            return better
    return found
