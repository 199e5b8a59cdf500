"""Tiles of worlds: conversion to and from Bullet's frame, and surfaces below drones.

Each world has its own square tile of the ground, and its own frame with the origin at the centre of
the tile. Functions with `first` and `last` process the worlds from `first` to before `last`.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.city_grid import overlaps_piece
from bulletuav.geometry.rotation import Vec3Like, quat4, to_body, to_world, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

TILE_PITCH = 4096.0
"""Distance between the centres of adjacent tiles, m: a power of two, larger than any arena"""
RAY_LENGTH = 1000.0
"""Length of the vertical rays to the surface, m"""


def tile_offset(world: int) -> np.ndarray:
    """Compute the origin of a world's frame, by the world's index on a Morton curve.

    The origin does not depend on the number of worlds.

    Args:
        world: Number of the world.

    Returns:
        (3,) origin of the world in Bullet's frame, m.
    """
    column = sum((world >> 2 * bit & 1) << bit for bit in range(16))
    row = sum((world >> 2 * bit + 1 & 1) << bit for bit in range(16))
    return np.array([column * TILE_PITCH, row * TILE_PITCH, 0.0])


@kernel
def localise(
    place: np.ndarray,
    offset: np.ndarray,
    mask: np.ndarray,
    swarm: Swarm,
    first: int,
    last: int,
) -> None:
    """Convert positions from Bullet's frame, and write them into a swarm.

    Args:
        place: (W, N, 3) positions in Bullet's frame, m.
        offset: (W, 1, 3) origins of the tiles, m.
        mask: (W, N) bool, drones to write.
        swarm: The swarm.
        first: The first world.
        last: The world after the last one.
    """
    for w in range(first, last):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                for k in range(3):
                    swarm.position[w, i, k] = place[w, i, k] - offset[w, 0, k]


@kernel
def localise_velocities(
    velocity: np.ndarray, omega: np.ndarray, mask: np.ndarray, swarm: Swarm
) -> None:
    """Convert velocities from Bullet, and write them into a swarm.

    Args:
        velocity: (W, N, 3) velocities, world axes, m/s.
        omega: (W, N, 3) angular velocities, world axes, rad/s.
        mask: (W, N) bool, drones to write.
        swarm: Swarm with up-to-date quaternions; velocities and body rates are written.
    """
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                rates = to_body(quat4(swarm.quaternion, w, i), vec3(omega, w, i))
                for k in range(3):
                    swarm.velocity[w, i, k] = velocity[w, i, k]
                    swarm.rates[w, i, k] = rates[k]


@kernel
def globalise(
    place: np.ndarray,
    offset: np.ndarray,
    velocity: np.ndarray,
    omega: np.ndarray,
    mask: np.ndarray,
    swarm: Swarm,
    first: int,
    last: int,
) -> None:
    """Convert positions and velocities of a swarm to Bullet's frame.

    Args:
        place: (W, N, 3) positions in Bullet's frame, m; written.
        offset: (W, 1, 3) origins of the tiles, m.
        velocity: (W, N, 3) velocities, world axes, m/s; written.
        omega: (W, N, 3) angular velocities, world axes, rad/s; written.
        mask: (W, N) bool, drones to write.
        swarm: The states.
        first: The first world.
        last: The world after the last one.
    """
    for w in range(first, last):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                # Back to world axes, and to the world's tile
                spin = to_world(quat4(swarm.quaternion, w, i), vec3(swarm.rates, w, i))
                for k in range(3):
                    place[w, i, k] = swarm.position[w, i, k] + offset[w, 0, k]
                    velocity[w, i, k] = swarm.velocity[w, i, k]
                    omega[w, i, k] = spin[k]


@func
def _is_covered(here: Vec3Like, scenery: Scenery, w: int) -> bool:
    """Check whether a body or a building may be above or below a point.

    The check uses the bounding spheres of bodies and the bounding boxes of buildings.
    """
    for r in range(scenery.other.shape[0]):
        # Horizontal distance to the centre of the bounding sphere
        dx = scenery.place[w, r, 0] - here[0]
        dy = scenery.place[w, r, 1] - here[1]
        radius = scenery.table.radius[scenery.first_body + r]
        if dx * dx + dy * dy <= radius * radius:
            return True
    # Infinite vertical line through the point
    low = (here[0], here[1], -np.inf)
    high = (here[0], here[1], np.inf)
    return overlaps_piece(scenery.city_grid, w, low, high)


@kernel
def cover(
    position: np.ndarray,
    mask: np.ndarray,
    scenery: Scenery,
    surface: np.ndarray,
    first: int,
    last: int,
) -> int:
    """Find the drones whose surface height requires a ray.

    Those are drones with a body or a building above or below. Below other drones is the ground.

    Args:
        position: (W, N, 3) positions of the drones, m.
        mask: (W, N) bool, drones to find the surface for.
        scenery: Bodies and buildings of each world.
        surface: (W, N) heights, m; written: NaN for drones that need a ray, 0 for the other drones
            of `mask`, -inf for drones outside `mask`.
        first: The first world.
        last: The world after the last one.

    Returns:
        Number of drones that need a ray.
    """
    count = 0
    for w in range(first, last):
        for i in range(mask.shape[1]):
            # The ground is flat, so it needs no ray
            surface[w, i] = 0.0 if mask[w, i] else -np.inf
            if mask[w, i] and _is_covered(vec3(position, w, i), scenery, w):
                surface[w, i] = np.nan
                count += 1
    return count


@allocating
def vertical_rays(
    position: np.ndarray, surface: np.ndarray, count: int, first: int, last: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the downward rays of the drones that `cover` marked by NaN.

    Args:
        position: (W, N, 3) positions of the drones, m.
        surface: (W, N) heights, as written by `cover`, m.
        count: Number of marked drones M.
        first: The first world.
        last: The world after the last one.

    Returns:
        World and drone (M, 2) of each ray; starts and ends (M, 3) of the rays, m.
    """
    drone = np.empty((count, 2), np.int64)
    start, end = np.empty((count, 3)), np.empty((count, 3))
    m = 0
    for w in range(first, last):
        for i in range(surface.shape[1]):
            if np.isnan(surface[w, i]):
                drone[m, 0], drone[m, 1] = w, i
                for k in range(3):
                    start[m, k] = end[m, k] = position[w, i, k]
                end[m, 2] -= RAY_LENGTH
                m += 1
    return drone, start, end


@kernel
def write_surface(
    surface: np.ndarray, drone: np.ndarray, start: np.ndarray, fraction: np.ndarray
) -> None:
    """Write the heights at which the rays of `vertical_rays` hit; 0, the ground, without a hit.

    Args:
        surface: (W, N) heights, m; written.
        drone: (M, 2) world and drone of each ray.
        start: (M, 3) starts of the rays, m.
        fraction: (M,) fraction of each ray before its hit, 1 without a hit.
    """
    for m in range(drone.shape[0]):
        met = fraction[m] < 1.0
        height = start[m, 2] - RAY_LENGTH * fraction[m] if met else 0.0
        surface[drone[m, 0], drone[m, 1]] = height


@allocating
def within_tile(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clip rays at the edge of their tile, beyond which are other worlds.

    Args:
        start: (M, 3) starts of the rays in their world's own frame, m.
        end: (M, 3) ends of the rays, m.

    Returns:
        Ends (M, 3) of the clipped rays, m, and the fraction (M,) of each ray that remains.
    """
    share = np.ones(start.shape[0])
    half = 0.5 * TILE_PITCH
    last = end.copy()
    for m in range(start.shape[0]):
        # The ray ends at the first of the four edges that it crosses.
        for k in range(2):
            change = end[m, k] - start[m, k]
            if abs(end[m, k]) > half:
                crossed = (math.copysign(half, change) - start[m, k]) / change
                share[m] = max(0.0, min(share[m], crossed))
        if share[m] < 1.0:
            for k in range(3):
                last[m, k] = start[m, k] + share[m] * (end[m, k] - start[m, k])
    return last, share
