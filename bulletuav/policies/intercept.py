"""Formulas of pursuit: constant bearing, and the face that two Voronoi cells share."""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus, point, vec3

NO_LENGTH = 1e-9
"""Length below which a vector has no direction, m"""
SIDES = 6
"""Sides of a box"""
PIECE = 4
"""Corners of the square from which a face is cut"""


@func
def direction(vector: Vec3Like) -> Vec3:
    """Shorten a vector to length 1; east where it has none."""
    length = math.sqrt(dot(vector, vector))
    if length < NO_LENGTH:
        return 1.0, 0.0, 0.0
    return vector[0] / length, vector[1] / length, vector[2] / length


@func
def constant_bearing(way: Vec3Like, other: Vec3Like, speed: float) -> Vec3:
    """Compute the velocity that meets a target which flies straight on, as soon as possible.

    Across the line of sight it is the target's own, so that the bearing stays; what is left of the
    speed is along it: parallel navigation, N. Shneydor, Missile Guidance and Pursuit (1998),
    section 4.2. Straight at a target that is too fast across it for that.

    Args:
        way: From the drone to the target, m.
        other: Velocity of the target, m/s.
        speed: That of the drone, m/s.

    Returns:
        The velocity, m/s, of that norm.
    """
    # Part of the target's velocity across the line of sight
    ahead = direction(way)
    across = plus(other, -dot(other, ahead), ahead)
    square = speed * speed - dot(across, across)
    # It is faster across than the drone can fly
    if square <= 0.0:
        return plus((0.0, 0.0, 0.0), speed, ahead)
    return plus(across, math.sqrt(square), ahead)


@kernel
def _cut(polygon: np.ndarray, count: int, normal: Vec3, bound: float, out: np.ndarray) -> int:
    """Cut off what of a convex polygon lies beyond normal . x = bound.

    I. Sutherland, G. Hodgman, Reentrant polygon clipping (1974).

    Args:
        polygon: (M, 3) its corners in turn, in the first `count` rows.
        count: How many there are.
        normal: Of the plane.
        bound: Of the plane.
        out: (M, 3) the corners that are left, written.

    Returns:
        How many are left.
    """
    left = 0
    for k in range(count):
        # From this corner to the next: the corner if it stays, and where the edge meets the plane.
        m = (k + 1) % count
        here = point(polygon, k)
        there = point(polygon, m)
        depth, later = dot(normal, here) - bound, dot(normal, there) - bound
        # Corners on this side stay
        if depth <= 0.0:
            for axis in range(3):
                out[left, axis] = here[axis]
            left += 1
        # The edge changes sides: its share up to the plane
        if (depth <= 0.0) != (later <= 0.0):
            meeting = plus(here, depth / (depth - later), minus(there, here))
            for axis in range(3):
                out[left, axis] = meeting[axis]
            left += 1
    return left


@kernel
def _middle(polygon: np.ndarray, count: int) -> Vec3:
    """Compute the centroid of a convex polygon: that of its triangles, by their areas."""
    total, result = 0.0, (0.0, 0.0, 0.0)
    first = point(polygon, 0)
    for k in range(1, count - 1):
        # A fan of triangles from the first corner; twice their areas, as that cancels out
        one = minus(point(polygon, k), first)
        two = minus(point(polygon, k + 1), first)
        normal = cross(one, two)
        area = math.sqrt(dot(normal, normal))
        total += area
        result = plus(plus(result, area / 3.0, one), area / 3.0, two)
    # No area: a line or a point
    if total < NO_LENGTH * NO_LENGTH:
        return first
    return plus(first, 1.0 / total, result)


@allocating
def shared_face(
    place: np.ndarray, others: np.ndarray, k: int, low: np.ndarray, high: np.ndarray
) -> tuple[bool, Vec3]:
    """Find the face that the Voronoi cells of a point and of one of some others share, in a box.

    Args:
        place: (3,) the point, m.
        others: (M, 3) m.
        k: Index of the other one.
        low: (3,) lower corner of the box, m.
        high: (3,) its upper corner, m.

    Returns:
        Whether there is such a face, and its centroid, m.
    """
    here = (place[0], place[1], place[2])
    other = point(others, k)
    polygon = np.empty((PIECE + SIDES + others.shape[0], 3))
    spare = np.empty_like(polygon)
    # A square on the plane half-way, larger than the box from wherever in it.
    ahead = direction(minus(other, here))
    middle = plus(here, 0.5, minus(other, here))
    aside = (0.0, 0.0, 1.0) if abs(ahead[2]) < 0.7 else (1.0, 0.0, 0.0)
    one = direction(cross(ahead, aside))
    two = cross(ahead, one)
    size = 0.0
    for axis in range(3):
        size += high[axis] - low[axis]
    for corner in range(PIECE):
        x = size if corner in (0, 3) else -size
        y = size if corner < 2 else -size
        at = plus(plus(middle, x, one), y, two)
        for axis in range(3):
            polygon[corner, axis] = at[axis]
    count = PIECE
    # Within the box.
    for axis in range(3):
        up = (1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2))
        down = (-up[0], -up[1], -up[2])
        count = _cut(polygon, count, up, high[axis], spare)
        count = _cut(spare, count, down, -low[axis], polygon)
    # Nearer to the two than to any other.
    for j in range(others.shape[0]):
        if j != k:
            away = minus(point(others, j), here)
            bound = dot(away, plus(here, 0.5, away))
            count = _cut(polygon, count, away, bound, spare)
            polygon, spare = spare, polygon
    if count < 3:
        return False, middle
    return True, _middle(polygon, count)


@allocating
def interception(
    place: np.ndarray, goal: np.ndarray, goal_velocity: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    """Compute `constant_bearing` for all drones.

    Args:
        place: (W, N, 3) where they are, m.
        goal: (W, N, 3) where their targets are, m.
        goal_velocity: (W, N, 3) how these fly, m/s.
        speed: (N,) how fast the drones fly, m/s.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(place.shape)
    for w in range(place.shape[0]):
        for i in range(place.shape[1]):
            way = minus(vec3(goal, w, i), vec3(place, w, i))
            wanted = constant_bearing(way, vec3(goal_velocity, w, i), speed[i])
            for axis in range(3):
                result[w, i, axis] = wanted[axis]
    return result
