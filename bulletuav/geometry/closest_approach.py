"""Distances, and how close two points come that both move straight."""

import math

import numpy as np

from bulletuav.geometry.rotation import dot
from bulletuav.kernel import func, kernel


@func
def offset(position, w, i, j):
    """From point i to point j of world w of `position` (W, N, 3), as a tuple."""
    return (
        position[w, j, 0] - position[w, i, 0],
        position[w, j, 1] - position[w, i, 1],
        position[w, j, 2] - position[w, i, 2],
    )


@func
def keep_nearest(near, distance, found, j, gap):
    """Insert j at `gap` into the first `found` of near and distance, nearest first, if there is room; how many there are."""
    if found == near.size and gap >= distance[found - 1]:
        return found
    found = min(found + 1, near.size)
    slot = found - 1
    while slot > 0 and distance[slot - 1] > gap:
        near[slot], distance[slot] = near[slot - 1], distance[slot - 1]
        slot -= 1
    near[slot], distance[slot] = j, gap
    return found


@kernel
def distances(one, two):
    """(W, N) distances between points (W, N, 3) of the same index; faster than numpy where there are few."""
    result = np.empty(one.shape[:2])
    for w in range(one.shape[0]):
        for i in range(one.shape[1]):
            square = 0.0
            for k in range(3):
                square += (two[w, i, k] - one[w, i, k]) ** 2
            result[w, i] = math.sqrt(square)
    return result


@func
def closest_squared(gap, later):
    """Squared distance at the start, and least, of two points whose offset moves straight from `gap` to `later`."""
    change = (later[0] - gap[0], later[1] - gap[1], later[2] - gap[2])
    along, square, start = dot(gap, change), dot(change, change), dot(gap, gap)
    least = start
    if along < 0.0:
        time = min(1.0, -along / square)
        least = max(0.0, start + 2.0 * time * along + time * time * square)
    return start, least
