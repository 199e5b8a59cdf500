"""Signed distance of two convex shapes and their closest points, by GJK and EPA.

For separated shapes this is the algorithm of Gilbert, Johnson and Keerthi (GJK) with Wolfe's
sub-algorithm, which never increases the distance. The penetration depth of overlapping shapes is
computed by EPA. The distance from a half-space has a closed form.

References:
    E. Gilbert, D. Johnson and S. Keerthi, A fast procedure for computing the distance between
    complex objects in three-dimensional space (1988).
    P. Wolfe, Finding the nearest point in a polytope (1976).
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
"""Difference of the upper and the lower bound of the distance at which GJK has converged, m"""
MIN_CORE_DISTANCE = 1e-9
"""Distance of the core shapes below which the closest point does not determine the normal, m"""
MAX_ITERATIONS = 100
"""Maximum number of GJK iterations"""
MAX_WEIGHT = 1e12
"""Barycentric weight above which a simplex counts as degenerate (flat)"""
WEIGHT, NEW_WEIGHT = 9, 10
"""Columns of the scratch array: barycentric weight of a vertex, and its weight before clamping"""


@func
def _line_barycentric(base: Vec3, edge: Vec3) -> float:
    """Return the barycentric coordinate of the point of a line that is closest to the origin."""
    return -dot(base, edge) / dot(edge, edge)


@func
def _plane_barycentric(base: Vec3, one: Vec3, two: Vec3) -> tuple[float, float]:
    """Return the barycentric coordinates of the point of a plane that is closest to the origin.

    The plane is spanned by two edges from one vertex. The longer edge comes first (Gram-Schmidt),
    which keeps thin triangles accurate.
    """
    swap = dot(two, two) > dot(one, one)
    first = two if swap else one
    second = one if swap else two
    # Part of the second edge orthogonal to the first, and the closest point along the first
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
    """Write the barycentric weights of the point closest to the origin, for 2 to 4 vertices.

    The weights are those of the affine hull, so they may be negative.
    """
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    if count == 2:
        scratch[1, NEW_WEIGHT] = _line_barycentric(base, one)
        scratch[0, NEW_WEIGHT] = 1.0 - scratch[1, NEW_WEIGHT]
        return
    two = minus(scratch_vec3(scratch, 2, 0), base)
    rest = 1.0
    if count == 4:
        # The fourth vertex reaches the origin's height over the plane of the other three
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
    for k in range(10):
        scratch[row, k] = scratch[last, k]


@func
def _reduce_simplex(scratch: np.ndarray, count: int) -> int:
    """Move the weights of a simplex closer to the origin, and remove vertices of weight 0 (Wolfe).

    Args:
        scratch: Scratch array; its first rows are the vertices, of which the last has weight 0.
        count: Number of vertices.

    Returns:
        The number of vertices left; 4 if the simplex contains the origin.
    """
    while count > 1:
        _solve_barycentric(scratch, count)
        # A degenerate simplex has no solution: keep the weights, drop a last vertex of weight 0
        if not abs(scratch[0, NEW_WEIGHT]) < MAX_WEIGHT:
            return count - 1 if scratch[count - 1, WEIGHT] == 0.0 else count
        # Step towards the new weights until the first weight becomes 0
        fraction = 1.0
        idle = -1
        for k in range(count):
            now = scratch[k, WEIGHT]
            then = scratch[k, NEW_WEIGHT]
            if then <= 0.0:
                crossing = now / (now - then) if now > 0.0 else 0.0
                if idle < 0 or crossing < fraction:
                    fraction = crossing
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
    """Return True if a point is one of the first rows of the scratch array."""
    for k in range(count):
        if scratch[k, 0] == w[0] and scratch[k, 1] == w[1] and scratch[k, 2] == w[2]:
            return True
    return False


@func
def _interpolate(scratch: np.ndarray, count: int, column: int) -> Vec3:
    """Return the barycentric mean of three columns over the vertices of a simplex."""
    mean = (0.0, 0.0, 0.0)
    for k in range(count):
        mean = plus(mean, scratch[k, WEIGHT], scratch_vec3(scratch, k, column))
    return mean


@func
def _search_direction(scratch: np.ndarray, count: int, v: Vec3) -> Vec3:
    """Return the direction of the simplex's closest point, accurate even close to the origin.

    Rounding errors change the direction of a short v. The normal of the line or plane through the
    vertices is known much more accurately.

    Args:
        scratch: Scratch array; its first rows are the vertices.
        count: Number of vertices, at most 3.
        v: The point of the simplex that is closest to the origin, m.

    Returns:
        The search direction, of any length.
    """
    if count == 1:
        return v
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    if count == 2:
        return plus(v, -dot(v, one) / dot(one, one), one)
    # The two edges opposite the longest one determine the plane most accurately
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
    """Return the result of `gjk_distance` if b is a half-space, across its z axis."""
    up = rotation_b[2]
    # The lowest point of a sphere is its centre minus the margin
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
    """Compute the signed distance of two convex shapes, its normal and the closest points.

    Args:
        table: The shapes.
        a: Index of the first shape, which is no half-space.
        rotation_a: Axes of the first shape.
        b: Index of the second shape.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, world axes, m.
        guess: Unit normal of an earlier result as the first search direction (warm start), or
            zeros.
        scratch: Scratch array of `make_scratch`.

    Returns:
        The signed distance, m, negative for the penetration depth of an overlap. The unit normal
        from b to a, along which a separates from b. The closest points on a and b, each relative to
        the position of its shape. All in world axes.
    """
    if table.kind[b] == HALF_SPACE:
        return _half_space_distance(table, a, rotation_a, rotation_b, offset)
    # First search direction: the guess, or the line between the centres
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
        # The supporting plane through w is a lower bound of the distance
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
        # For touching shapes the points of GJK are more accurate
        if abs(distance) > MIN_CORE_DISTANCE:
            on_a = found[2]
            on_b = found[3]
        # Move both points by half the error, so that they differ by the distance along the normal
        error = plus(minus(minus(on_a, on_b), offset), -distance, normal)
        on_a = plus(on_a, -0.5, error)
        on_b = plus(on_b, 0.5, error)
    # Apply the margins: spheres were represented by their centres
    on_a = plus(on_a, -margin_a, normal)
    on_b = plus(on_b, margin_b, normal)
    return distance - margin_a - margin_b, normal, on_a, on_b
