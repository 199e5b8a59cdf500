"""Pursuit guidance: constant bearing navigation, and the shared face of two Voronoi cells."""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus, point, vec3

MIN_NORM = 1e-9
"""Minimum length of a vector that has a direction, m"""
NUM_FACES = 6
"""Number of faces of a box"""
NUM_CORNERS = 4
"""Number of corners of the initial square of a face"""


@func
def direction(vector: Vec3Like) -> Vec3:
    """Normalise a vector; return east for a zero vector."""
    length = math.sqrt(dot(vector, vector))
    if length < MIN_NORM:
        return 1.0, 0.0, 0.0
    return vector[0] / length, vector[1] / length, vector[2] / length


@func
def constant_bearing(offset: Vec3Like, other: Vec3Like, speed: float) -> Vec3:
    """Compute the velocity that intercepts a target with constant velocity as soon as possible.

    The component perpendicular to the line of sight equals that of the target, so that the bearing
    stays constant; the rest of the speed closes the distance (parallel navigation). If the
    perpendicular speed of the target exceeds the speed of the drone, the drone flies straight at
    the target.

    References:
        N. Shneydor, Missile Guidance and Pursuit (1998), section 4.2.

    Args:
        offset: Offset from the drone to the target, m.
        other: Velocity of the target, m/s.
        speed: Speed of the drone, m/s.

    Returns:
        The velocity with norm `speed`, m/s.
    """
    # Component of the target velocity perpendicular to the line of sight
    ahead = direction(offset)
    across = plus(other, -dot(other, ahead), ahead)
    square = speed * speed - dot(across, across)
    # The perpendicular speed of the target exceeds the speed of the drone
    if square <= 0.0:
        return plus((0.0, 0.0, 0.0), speed, ahead)
    return plus(across, math.sqrt(square), ahead)


@kernel
def _clip(polygon: np.ndarray, count: int, normal: Vec3, bound: float, out: np.ndarray) -> int:
    """Clip a convex polygon by the half-space normal . x <= bound.

    References:
        I. Sutherland, G. Hodgman, Reentrant polygon clipping (1974).

    Args:
        polygon: (M, 3) corners in order, in the first `count` rows.
        count: Number of corners.
        normal: Normal of the plane.
        bound: Bound of the plane.
        out: (M, 3) corners of the clipped polygon, written.

    Returns:
        The number of corners of the clipped polygon.
    """
    left = 0
    for k in range(count):
        m = (k + 1) % count
        here = point(polygon, k)
        there = point(polygon, m)
        depth, later = dot(normal, here) - bound, dot(normal, there) - bound
        # Keep corners inside the half-space
        if depth <= 0.0:
            for axis in range(3):
                out[left, axis] = here[axis]
            left += 1
        # The edge crosses the plane: add the intersection
        if (depth <= 0.0) != (later <= 0.0):
            meeting = plus(here, depth / (depth - later), minus(there, here))
            for axis in range(3):
                out[left, axis] = meeting[axis]
            left += 1
    return left


@kernel
def _centroid(polygon: np.ndarray, count: int) -> Vec3:
    """Compute the area-weighted centroid of a convex polygon."""
    total, result = 0.0, (0.0, 0.0, 0.0)
    first = point(polygon, 0)
    for k in range(1, count - 1):
        # Triangle fan from the first corner; twice the areas, as the factor cancels out
        one = minus(point(polygon, k), first)
        two = minus(point(polygon, k + 1), first)
        normal = cross(one, two)
        area = math.sqrt(dot(normal, normal))
        total += area
        result = plus(plus(result, area / 3.0, one), area / 3.0, two)
    # Degenerate polygon: a line or a point
    if total < MIN_NORM * MIN_NORM:
        return first
    return plus(first, 1.0 / total, result)


@allocating
def shared_face(
    place: np.ndarray, others: np.ndarray, k: int, low: np.ndarray, high: np.ndarray
) -> tuple[bool, Vec3]:
    """Find the face between the Voronoi cells of a point and of one of other points, in a box.

    Args:
        place: (3,) the point, m.
        others: (M, 3) the other points, m.
        k: Index of the other point.
        low: (3,) lower corner of the box, m.
        high: (3,) upper corner of the box, m.

    Returns:
        Whether the cells share a face, and the centroid of the face, m.
    """
    here = (place[0], place[1], place[2])
    other = point(others, k)
    polygon = np.empty((NUM_CORNERS + NUM_FACES + others.shape[0], 3))
    scratch = np.empty_like(polygon)
    # Square in the bisecting plane, larger than the box.
    ahead = direction(minus(other, here))
    middle = plus(here, 0.5, minus(other, here))
    aside = (0.0, 0.0, 1.0) if abs(ahead[2]) < 0.7 else (1.0, 0.0, 0.0)
    one = direction(cross(ahead, aside))
    two = cross(ahead, one)
    size = 0.0
    for axis in range(3):
        size += high[axis] - low[axis]
    for corner in range(NUM_CORNERS):
        x = size if corner in (0, 3) else -size
        y = size if corner < 2 else -size
        at = plus(plus(middle, x, one), y, two)
        for axis in range(3):
            polygon[corner, axis] = at[axis]
    count = NUM_CORNERS
    # Clip to the box.
    for axis in range(3):
        up = (1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2))
        down = (-up[0], -up[1], -up[2])
        count = _clip(polygon, count, up, high[axis], scratch)
        count = _clip(scratch, count, down, -low[axis], polygon)
    # Clip to the points that are nearer to these two points than to any other.
    for j in range(others.shape[0]):
        if j != k:
            away = minus(point(others, j), here)
            bound = dot(away, plus(here, 0.5, away))
            count = _clip(polygon, count, away, bound, scratch)
            polygon, scratch = scratch, polygon
    if count < 3:
        return False, middle
    return True, _centroid(polygon, count)


@allocating
def interception(
    place: np.ndarray, goal: np.ndarray, goal_velocity: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    """Compute `constant_bearing` for all drones.

    Args:
        place: (W, N, 3) positions of the drones, m.
        goal: (W, N, 3) positions of the targets, m.
        goal_velocity: (W, N, 3) velocities of the targets, m/s.
        speed: (N,) speeds of the drones, m/s.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(place.shape)
    for w in range(place.shape[0]):
        for i in range(place.shape[1]):
            offset = minus(vec3(goal, w, i), vec3(place, w, i))
            wanted = constant_bearing(offset, vec3(goal_velocity, w, i), speed[i])
            for axis in range(3):
                result[w, i, axis] = wanted[axis]
    return result
