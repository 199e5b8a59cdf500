"""Distances of points, and the closest approach of two points that move in straight lines."""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.lanes import is_any, where
from bulletuav.geometry.rotation import Vec3, Vec3Like, dot, minus, vec3


@func
def offset(position: np.ndarray, w: int, i: int, j: int) -> Vec3:
    """Return the vector from point i to point j of world w of `position` (W, N, 3)."""
    return minus(vec3(position, w, j), vec3(position, w, i))


@func
def insert_nearest(
    near: np.ndarray, distance: np.ndarray, found: int, j: int, new_distance: float
) -> int:
    """Insert a point into a sorted list of the nearest ones, if it is near enough.

    Points at the same distance are sorted by index, so that the result does not depend on the order
    in which points are inserted.

    Args:
        near: (K,) indices of the nearest points so far, nearest first; changed in place.
        distance: (K,) their distances, m; changed in place.
        found: Number of entries in use.
        j: Index of the new point.
        new_distance: Its distance, m.

    Returns:
        The number of entries in use now, at most K.
    """
    if found == near.size:
        last = found - 1
        if found == 0 or new_distance > distance[last]:
            return found
        if new_distance == distance[last] and j > near[last]:
            return found
    found = min(found + 1, near.size)
    # Shift the farther points by one slot; the last one drops out of a full list.
    slot = found - 1
    while slot > 0 and (
        distance[slot - 1] > new_distance
        or (distance[slot - 1] == new_distance and near[slot - 1] > j)
    ):
        near[slot] = near[slot - 1]
        distance[slot] = distance[slot - 1]
        slot -= 1
    near[slot] = j
    distance[slot] = new_distance
    return found


@allocating
def paired_distances(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Compute the distances (W, N), m, between points (W, N, 3) of the same index.

    Faster than NumPy for few points.
    """
    result = np.empty(one.shape[:2])
    fill_paired_distances(one, two, result)
    return result


@kernel
def fill_paired_distances(one: np.ndarray, two: np.ndarray, result: np.ndarray) -> None:
    """Write the result of `paired_distances` to `result` (W, N)."""
    for w in range(one.shape[0]):
        for i in range(one.shape[1]):
            square = 0.0
            for k in range(3):
                square += (two[w, i, k] - one[w, i, k]) ** 2
            result[w, i] = math.sqrt(square)


@kernel
def min_separation(position: np.ndarray) -> float:
    """Return the minimum distance of two points (W, N, 3) of one world, m; inf for one point."""
    smallest = np.inf
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            for j in range(i):
                # Squared distances; one square root at the end
                difference = offset(position, w, i, j)
                smallest = min(smallest, dot(difference, difference))
    return math.sqrt(smallest)


@func
def closest_squared_distances(start_offset: Vec3Like, end_offset: Vec3Like) -> tuple[float, float]:
    """Compute how close two points come while both move in a straight line; also for lanes.

    Args:
        start_offset: Offset of the points at the start, m.
        end_offset: Their offset at the end, m.

    Returns:
        The squared distance at the start, and the minimum squared distance during the motion, m^2.
    """
    change = minus(end_offset, start_offset)
    along = dot(start_offset, change)
    square = dot(change, change)
    start = dot(start_offset, start_offset)
    smallest = start
    # The squared distance is a parabola in time; its vertex counts if it lies in the interval.
    if is_any(along < 0.0):
        time = min(1.0, -along / square)
        vertex = max(0.0, start + 2.0 * time * along + time * time * square)
        smallest = where(along < 0.0, vertex, start)
    return start, smallest
