"""Geometry of the tiles: places of worlds in Bullet's frame, and surfaces below drones.

All worlds share one Bullet client. Each has a square tile of the ground to itself, and its own
frame with the origin at the middle of its tile.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.city_grid import meets
from bulletuav.geometry.rotation import Vec3Like, quat4, to_body, to_world, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

TILE_PITCH = 4096.0
"""Distance of neighbouring tiles, m: a power of two, larger than any arena"""
RAY_LENGTH = 1000.0
"""Length of the rays downwards to the surface, m"""


def tile_offset(world: int) -> np.ndarray:
    """Compute where a world's frame lies: at its index on a Morton curve.

    It does not depend on the number of worlds.

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
    place: np.ndarray, offset: np.ndarray, omega: np.ndarray, mask: np.ndarray, swarm: Swarm
) -> None:
    """Write positions and body rates of drones, given in Bullet's frame, into a swarm.

    Args:
        place: (W, N, 3) positions in Bullet's frame, m.
        offset: (W, 1, 3) origins of the tiles, m.
        omega: (W, N, 3) angular velocities, world axes, rad/s.
        mask: (W, N) bool, drones to write.
        swarm: Whose positions and rates are written, and whose quaternions turn to body axes.
    """
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                for k in range(3):
                    # Each world has a tile of Bullet's plane, and its own origin
                    swarm.position[w, i, k] = place[w, i, k] - offset[w, 0, k]
                # Bullet tells angular velocities in world axes
                rates = to_body(quat4(swarm.quaternion, w, i), vec3(omega, w, i))
                for k in range(3):
                    swarm.rates[w, i, k] = rates[k]


@kernel
def globalise(
    place: np.ndarray, offset: np.ndarray, omega: np.ndarray, mask: np.ndarray, swarm: Swarm
) -> None:
    """Write where the drones of a swarm are in Bullet's frame: the reverse of `localise`.

    Args:
        place: (W, N, 3) positions in Bullet's frame, m, which are written.
        offset: (W, 1, 3) origins of the tiles, m.
        omega: (W, N, 3) angular velocities, world axes, rad/s, which are written.
        mask: (W, N) bool, drones to write.
        swarm: The states.
    """
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                # Back to world axes, and to the world's tile
                spin = to_world(quat4(swarm.quaternion, w, i), vec3(swarm.rates, w, i))
                for k in range(3):
                    place[w, i, k] = swarm.position[w, i, k] + offset[w, 0, k]
                    omega[w, i, k] = spin[k]


@func
def _is_covered(here: Vec3Like, scenery: Scenery, w: int) -> bool:
    """Tell whether a body or a building may stand above or below a point.

    It goes by the bounding spheres of bodies and the bounding boxes of buildings.
    """
    for r in range(scenery.other.shape[0]):
        # From above a sphere is a disc
        dx = scenery.place[w, r, 0] - here[0]
        dy = scenery.place[w, r, 1] - here[1]
        radius = scenery.table.radius[scenery.first_body + r]
        if dx * dx + dy * dy <= radius * radius:
            return True
    # A column without end over the point
    low = (here[0], here[1], -np.inf)
    high = (here[0], here[1], np.inf)
    return meets(scenery.city_grid, w, low, high)


@kernel
def cover(position: np.ndarray, mask: np.ndarray, scenery: Scenery, surface: np.ndarray) -> int:
    """Find the drones whose surface below takes a ray to find.

    Those are drones with a body or a building in their column. Below others lies the ground.

    Args:
        position: (W, N, 3) of the drones, m.
        mask: (W, N) bool, drones that are asked for.
        scenery: What stands in each world.
        surface: (W, N) heights, m, which are written: NaN for drones that need a ray, 0 for others
            of `mask`, -inf for those that are not asked for.

    Returns:
        How many need a ray.
    """
    count = 0
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            # The ground is flat, so it needs no ray
            surface[w, i] = 0.0 if mask[w, i] else -np.inf
            if mask[w, i] and _is_covered(vec3(position, w, i), scenery, w):
                surface[w, i] = np.nan
                count += 1
    return count


@allocating
def vertical_rays(
    position: np.ndarray, surface: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make the rays of the drones that `cover` found.

    Args:
        position: (W, N, 3) of the drones, m.
        surface: (W, N) what it wrote.
        count: How many there are, M.

    Returns:
        (world, drone) (M, 2); start and end (M, 3) of rays straight down, m.
    """
    drone = np.empty((count, 2), np.int64)
    start, end = np.empty((count, 3)), np.empty((count, 3))
    m = 0
    for w in range(surface.shape[0]):
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
    """Write the heights that the rays of `vertical_rays` met: the ground's where they met nothing.

    Args:
        surface: (W, N) heights, m, which are written.
        drone: (M, 2) world and drone of each ray.
        start: (M, 3) starts of the rays, m.
        fraction: (M,) share of each ray before it met something, 1 where it met nothing.
    """
    for m in range(drone.shape[0]):
        met = fraction[m] < 1.0
        height = start[m, 2] - RAY_LENGTH * fraction[m] if met else 0.0
        surface[drone[m, 0], drone[m, 1]] = height


@allocating
def within_tile(start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut rays off where they leave their tile: what is beyond belongs to another world.

    Args:
        start: (M, 3) starts of the rays in their world's own frame, m.
        end: (M, 3) ends of the rays, m.

    Returns:
        Ends (M, 3) of what is left, m, and the share (M,) of each ray that is left.
    """
    share = np.ones(start.shape[0])
    half = 0.5 * TILE_PITCH
    last = end.copy()
    for m in range(start.shape[0]):
        # The side of the tile that the ray crosses first, east-west or north-south.
        for k in range(2):
            change = end[m, k] - start[m, k]
            if abs(end[m, k]) > half:
                crossed = (math.copysign(half, change) - start[m, k]) / change
                share[m] = max(0.0, min(share[m], crossed))
        if share[m] < 1.0:
            for k in range(3):
                last[m, k] = start[m, k] + share[m] * (end[m, k] - start[m, k])
    return last, share
