"""Geometry of the tiles: where they lie in the engine's frame, and what lies below the drones in each."""

import math

import numpy as np

from bulletuav.geometry.city_grid import meets
from bulletuav.geometry.rotation import to_body, vec3
from bulletuav.kernel import func, kernel

TILE_PITCH = 4096.0  # m; a power of two, larger than any arena
RAY_LENGTH = 1000.0  # m, downwards to the surface


def tile_offset(world: int) -> np.ndarray:
    """(3,) origin of a world in the engine's frame, m: its index on a Morton curve, whatever the number of worlds."""
    column = sum((world >> 2 * bit & 1) << bit for bit in range(16))
    row = sum((world >> 2 * bit + 1 & 1) << bit for bit in range(16))
    return np.array([column * TILE_PITCH, row * TILE_PITCH, 0.0])


@kernel
def localise(place, offset, omega, mask, swarm):
    """Positions and rates of the drones of `mask` in the world's own frame and in body axes, from the engine's."""
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                for k in range(3):
                    swarm.position[w, i, k] = place[w, i, k] - offset[w, 0, k]
                swarm.rates[w, i] = to_body(swarm.quaternion[w, i], omega[w, i])


@func
def _covered(here, obstacle, radius, city_grid, w):
    """Whether an obstacle's bounding sphere or a building's bounding box is in the column of a point."""
    for k in range(radius.shape[0]):
        dx, dy = obstacle[w, k, 0] - here[0], obstacle[w, k, 1] - here[1]
        if dx * dx + dy * dy <= radius[k] * radius[k]:
            return True
    return meets(city_grid, w, (here[0], here[1], -np.inf), (here[0], here[1], np.inf))


@kernel
def columns(position, mask, obstacle, radius, city_grid, surface):
    """Fill `surface` (W, N) with the ground below drones of `mask`, -inf elsewhere, and tell who needs a ray.

    Those are drones with an obstacle (W, K, 3), of bounding `radius` (K,), or a building in their column: (world, drone)
    (M, 2), start and end (M, 3) of their rays.
    """
    found = [(0, 0) for _ in range(0)]
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            surface[w, i] = 0.0 if mask[w, i] else -np.inf
            if mask[w, i] and _covered(vec3(position, w, i), obstacle, radius, city_grid, w):
                found.append((w, i))
    who = np.empty((len(found), 2), np.int64)
    start = np.empty((len(found), 3))
    for m in range(len(found)):
        who[m, 0], who[m, 1] = found[m]
        start[m] = position[found[m]]
    end = start.copy()
    end[:, 2] -= RAY_LENGTH
    return who, start, end


@kernel
def land(surface, who, start, fraction):
    """Put what the rays of `columns` met into `surface`; where they met nothing it stays the ground."""
    for m in range(who.shape[0]):
        if fraction[m] < 1.0:
            surface[who[m, 0], who[m, 1]] = start[m, 2] - RAY_LENGTH * fraction[m]


@kernel
def within_tile(start, end):
    """Rays (M, 3), in their world's own frame, until they leave the tile: ends, and the share (M,) that is left."""
    share, half, last = np.ones(start.shape[0]), 0.5 * TILE_PITCH, end.copy()
    for m in range(start.shape[0]):
        for k in range(2):
            change = end[m, k] - start[m, k]
            if abs(end[m, k]) > half:
                share[m] = max(
                    0.0, min(share[m], (math.copysign(half, change) - start[m, k]) / change)
                )
        if share[m] < 1.0:
            for k in range(3):
                last[m, k] = start[m, k] + share[m] * (end[m, k] - start[m, k])
    return last, share
