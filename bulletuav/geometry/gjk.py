"""Signed distance of two convex shapes, with the points where they are nearest.

Shapes that are apart: GJK (E. Gilbert, D. Johnson and S. Keerthi, 1988) with the inner step of
P. Wolfe, Finding the nearest point in a polytope (1976), which never moves away from the answer.
Shapes that overlap: EPA. A half space is met in closed form.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.epa import epa_penetration
from bulletuav.geometry.minkowski import Mat3 as Mat3
from bulletuav.geometry.minkowski import make_scratch as make_scratch
from bulletuav.geometry.minkowski import (
    minkowski_support,
    scratch_vec3,
    shape_margin,
    support_point,
)
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus
from bulletuav.geometry.shapes import HALF_SPACE

DUALITY_GAP = 1e-13
"""Difference of the bounds of a distance at which GJK is done, m"""
MIN_CORE_DISTANCE = 1e-9
"""Distance below which a direction is no longer known from the nearest point, m"""
MAX_ITERATIONS = 100
"""Most points that GJK looks at"""
MAX_WEIGHT = 1e12
"""Weight beyond which points are taken to lie in one plane"""
WEIGHT, NEW_WEIGHT = 9, 10
"""Columns of scratch: the weight of a point, and the one that it would have without bounds"""


@func
def _line_barycentric(base: Vec3, edge: Vec3) -> float:
    """Return the share of an edge at which its line is nearest to the origin."""
    return -dot(base, edge) / dot(edge, edge)


@func
def _plane_barycentric(base: Vec3, one: Vec3, two: Vec3) -> tuple[float, float]:
    """Return the shares of two edges from one point at which their plane is nearest to the origin.

    The longer edge comes first (Gram and Schmidt), which keeps thin triangles exact.
    """
    swap = dot(two, two) > dot(one, one)
    first = two if swap else one
    second = one if swap else two
    # What of the second edge is across the first, and where the first comes nearest
    square = dot(first, first)
    slope = dot(first, second) / square
    height = plus(second, -slope, first)
    near = -dot(base, first) / square
    foot = plus(base, near, first)
    fraction = -dot(foot, height) / dot(height, height)
    along = near - slope * fraction
    return (fraction, along) if swap else (along, fraction)


@func
def _solve_barycentric(scratch: np.ndarray, count: int) -> None:
    """Find the weights, of any sign, with which 2 to 4 points come nearest to the origin."""
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    if count == 2:
        scratch[1, NEW_WEIGHT] = _line_barycentric(base, one)
        scratch[0, NEW_WEIGHT] = 1.0 - scratch[1, NEW_WEIGHT]
        return
    two = minus(scratch_vec3(scratch, 2, 0), base)
    rest = 1.0
    if count == 4:
        # Four points reach the origin itself; three of them the rest of the way
        three = minus(scratch_vec3(scratch, 3, 0), base)
        normal = cross(one, two)
        fraction = -dot(base, normal) / dot(three, normal)
        scratch[3, NEW_WEIGHT] = fraction
        base = plus(base, fraction, three)
        rest -= fraction
    first, second = _plane_barycentric(base, one, two)
    scratch[1, NEW_WEIGHT] = first
    scratch[2, NEW_WEIGHT] = second
    scratch[0, NEW_WEIGHT] = rest - first - second


@func
def _replace_vertex(scratch: np.ndarray, row: int, last: int) -> None:
    """Put the last point of a simplex into the row of one that leaves."""
    for k in range(10):
        scratch[row, k] = scratch[last, k]


@func
def _reduce_simplex(scratch: np.ndarray, count: int) -> int:
    """Move the weights of a simplex to where it is nearer to the origin, and drop idle points.

    Args:
        room: Scratch; its first rows are the points, of which the last has weight 0.
        count: Number of points.

    Returns:
        The number of points left; 4 where the origin is among them.
    """
    while count > 1:
        _solve_barycentric(scratch, count)
        # A flat simplex gives no answer: stay here, without a last point that bears nothing
        if not abs(scratch[0, NEW_WEIGHT]) < MAX_WEIGHT:
            return count - 1 if scratch[count - 1, WEIGHT] == 0.0 else count
        # Go as far towards the new weights as all stay positive
        fraction = 1.0
        idle = -1
        for k in range(count):
            now = scratch[k, WEIGHT]
            then = scratch[k, NEW_WEIGHT]
            if then <= 0.0:
                reach = now / (now - then) if now > 0.0 else 0.0
                if idle < 0 or reach < fraction:
                    fraction = reach
                    idle = k
        if idle < 0:
            for k in range(count):
                scratch[k, WEIGHT] = scratch[k, NEW_WEIGHT]
            return count
        if fraction > 0.0:
            for k in range(count):
                weight = scratch[k, WEIGHT]
                scratch[k, WEIGHT] = max(weight + fraction * (scratch[k, NEW_WEIGHT] - weight), 0.0)
        count -= 1
        _replace_vertex(scratch, idle, count)
    scratch[0, WEIGHT] = 1.0
    return count


@func
def _is_in_simplex(scratch: np.ndarray, count: int, w: Vec3) -> bool:
    """Return whether a point is one of the first rows of scratch."""
    for k in range(count):
        if scratch[k, 0] == w[0] and scratch[k, 1] == w[1] and scratch[k, 2] == w[2]:
            return True
    return False


@func
def _interpolate(scratch: np.ndarray, count: int, column: int) -> Vec3:
    """Return the weighted mean of the points of a simplex, of three columns from one on."""
    mean = (0.0, 0.0, 0.0)
    for k in range(count):
        mean = plus(mean, scratch[k, WEIGHT], scratch_vec3(scratch, k, column))
    return mean


@func
def _search_direction(scratch: np.ndarray, count: int, v: Vec3) -> Vec3:
    """Return the direction of the nearest point of a simplex, also where it is almost the origin.

    Rounding bends a short v. The line or plane that it is across is known much better.

    Args:
        room: Scratch; its first rows are the points.
        count: Number of points, at most 3.
        v: The nearest point, m.

    Returns:
        The direction, of any length.
    """
    if count == 1:
        return v
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    if count == 2:
        return plus(v, -dot(v, one) / dot(one, one), one)
    # Two sides from the corner opposite the longest one span the plane best
    two = minus(scratch_vec3(scratch, 2, 0), base)
    third = minus(two, one)
    long_one = dot(one, one)
    long_two = dot(two, two)
    if dot(third, third) < max(long_one, long_two):
        one = third if long_one > long_two else one
        two = two if long_one > long_two else third
    across = cross(one, two)
    if dot(across, v) < 0.0:
        return -across[0], -across[1], -across[2]
    return across


@func
def _half_space_distance(
    table: ShapeTable, a: int, rotation_a: Mat3, rotation_b: Mat3, offset: Vec3Like
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Return `gjk_distance` above the half space below the plane across the third axis of b."""
    up = rotation_b[2]
    # The lowest point of a sphere is a radius below its centre
    lowest = support_point(table, a, rotation_a, (-up[0], -up[1], -up[2]))
    lowest = plus(lowest, -shape_margin(table, a), up)
    above = minus(lowest, offset)
    height = dot(above, up)
    return height, up, lowest, plus(above, -height, up)


@kernel
def gjk_distance(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    guess: Vec3,
    scratch: np.ndarray,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Return the signed distance of two shapes, its direction and the nearest points.

    Args:
        table: The shapes.
        a: Number of the first shape, no half space.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, world axes, m.
        guess: Unit normal of an earlier answer, or zeros.
        room: Scratch of `make_scratch`.

    Returns:
        The distance, m, negative for the depth of an overlap. The unit normal from b to a, along
        which a parts from b. The nearest points on a and b, each from its shape's position, m.
        All in world axes.
    """
    if table.kind[b] == HALF_SPACE:
        return _half_space_distance(table, a, rotation_a, rotation_b, offset)
    # Begin with the guess, or from centre to centre
    d = guess
    if dot(d, d) == 0.0:
        d = (-offset[0], -offset[1], -offset[2])
    if dot(d, d) == 0.0:
        d = (0.0, 0.0, 1.0)
    v = minkowski_support(table, a, rotation_a, b, rotation_b, offset, d, scratch, 0)
    scratch[0, WEIGHT] = 1.0
    count = 1
    square = dot(v, v)
    for _ in range(MAX_ITERATIONS):
        if square <= MIN_CORE_DISTANCE * MIN_CORE_DISTANCE:
            break
        d = _search_direction(scratch, count, v)
        size = math.sqrt(dot(d, d))
        w = minkowski_support(table, a, rotation_a, b, rotation_b, offset, d, scratch, count)
        # The plane through w bounds the distance from below
        if dot(d, v) - dot(d, w) <= DUALITY_GAP * size or _is_in_simplex(scratch, count, w):
            break
        scratch[count, WEIGHT] = 0.0
        count = _reduce_simplex(scratch, count + 1)
        before = square
        v = _interpolate(scratch, count, 0)
        square = dot(v, v)
        if count == 4 or square >= before:
            break
    margin_a = shape_margin(table, a)
    margin_b = shape_margin(table, b)
    distance = math.sqrt(square)
    on_a = _interpolate(scratch, count, 3)
    on_b = _interpolate(scratch, count, 6)
    if distance > MIN_CORE_DISTANCE and count < 4:
        normal = _search_direction(scratch, count, v)
        size = math.sqrt(dot(normal, normal))
        normal = (normal[0] / size, normal[1] / size, normal[2] / size)
    else:
        found = epa_penetration(table, a, rotation_a, b, rotation_b, offset, count, scratch)
        distance = found[0]
        normal = found[1]
        # Where shapes touch, the points of GJK are the better ones
        if abs(distance) > MIN_CORE_DISTANCE:
            on_a = found[2]
            on_b = found[3]
        # Move both points, half way each, to lie the distance apart along the normal
        error = plus(minus(minus(on_a, on_b), offset), -distance, normal)
        on_a = plus(on_a, -0.5, error)
        on_b = plus(on_b, 0.5, error)
    # Spheres are their centres so far
    on_a = plus(on_a, -margin_a, normal)
    on_b = plus(on_b, margin_b, normal)
    return distance - margin_a - margin_b, normal, on_a, on_b
