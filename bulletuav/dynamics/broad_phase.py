"""Broad phase of collision detection: compiled search for pairs that may touch along a path.

Drones are bounding spheres here, swept along the straight pieces of the path. A pair is kept where
the spheres come within `TOUCH`, or where the box about a swept sphere meets that about a piece of
the city. What is left goes to the engine's exact shapes, see `first_touch`.
"""

import math

import numpy as np

from bulletuav.dynamics.path import Path
from bulletuav.geometry.city_grid import CityGrid, meets
from bulletuav.geometry.closest_approach import closest_squared
from bulletuav.geometry.rotation import Vec3, dot, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND

TOUCH = 1e-3  # m; closer counts as touching
FAST = 0.25  # of a drone's thinnest extent: who moves farther in a substep may jump over a contact

Pair = tuple[int, int, int]
"""World, drone, other as in `Contacts`; of two drones the lower index first"""


@kernel
def _reaches(track: np.ndarray) -> np.ndarray:
    """Return (W, N): how far from where it begins each track (S + 1, W, N, 3) gets, m."""
    reach: np.ndarray = np.zeros(track.shape[1:3])
    for w in range(reach.shape[0]):
        for i in range(reach.shape[1]):
            for piece in range(1, track.shape[0]):
                square = 0.0
                for k in range(3):
                    square += (track[piece, w, i, k] - track[0, w, i, k]) ** 2
                reach[w, i] = max(reach[w, i], square)
            reach[w, i] = math.sqrt(reach[w, i])
    return reach


@func
def _box_about(one: Vec3, two: Vec3, margin: float) -> tuple[Vec3, Vec3]:
    """Return the low and high corner of the box about two points, `margin` m wider all around."""
    low = (
        min(one[0], two[0]) - margin,
        min(one[1], two[1]) - margin,
        min(one[2], two[2]) - margin,
    )
    high = (
        max(one[0], two[0]) + margin,
        max(one[1], two[1]) + margin,
        max(one[2], two[2]) + margin,
    )
    return low, high


@func
def _meets_ground(
    position: np.ndarray,
    radius: np.ndarray,
    w: int,
    i: int,
) -> bool:
    """Tell whether a drone's bounding sphere reaches the ground at the end of some piece."""
    for piece in range(position.shape[0]):
        if position[piece, w, i, 2] < radius[w, i] + TOUCH:
            return True
    return False


@func
def _meets_city(
    position: np.ndarray,
    radius: np.ndarray,
    city_grid: CityGrid,
    w: int,
    i: int,
) -> bool:
    """Tell whether the box about a drone's swept sphere overlaps that about a piece of the city."""
    margin = radius[w, i] + TOUCH
    for piece in range(position.shape[0] - 1):
        before = vec3(position[piece], w, i)
        after = vec3(position[piece + 1], w, i)
        low, high = _box_about(before, after, margin)
        if meets(city_grid, w, low, high):
            return True
    return False


@func
def between(one: Vec3, two: Vec3) -> Vec3:
    """Return the vector from point `one` to point `two`."""
    return (
        two[0] - one[0],
        two[1] - one[1],
        two[2] - one[2],
    )


@func
def _gap(
    one: np.ndarray,
    two: np.ndarray,
    piece: int,
    w: int,
    i: int,
    j: int,
) -> Vec3:
    """Return the vector from track i of `one` to track j of `two` where a piece begins."""
    return (
        two[piece, w, j, 0] - one[piece, w, i, 0],
        two[piece, w, j, 1] - one[piece, w, i, 1],
        two[piece, w, j, 2] - one[piece, w, i, 2],
    )


@func
def _near(
    one: np.ndarray,
    two: np.ndarray,
    w: int,
    i: int,
    j: int,
    within: float,
) -> bool:
    """Tell whether tracks i and j begin closer to each other than `within` m."""
    gap = _gap(one, two, 0, w, i, j)
    return dot(gap, gap) < within * within


@func
def _meets(
    one: np.ndarray,
    two: np.ndarray,
    w: int,
    i: int,
    j: int,
    within: float,
) -> bool:
    """Tell whether tracks i and j (S + 1, W, ., 3) come closer to each other than `within` m."""
    for piece in range(one.shape[0] - 1):
        gap = _gap(one, two, piece, w, i, j)
        later = _gap(one, two, piece + 1, w, i, j)
        if closest_squared(gap, later)[1] < within * within:
            return True
    return False


@kernel
def candidates(
    position: np.ndarray,
    obstacle: np.ndarray,
    alive: np.ndarray,
    radius: np.ndarray,
    obstacle_radius: np.ndarray,
    city_grid: CityGrid,
) -> list[Pair]:
    """Find the pairs that may come within `TOUCH` along a path.

    Args:
        position: (S + 1, W, N, 3) positions of the drones at the ends of the pieces, m.
        obstacle: (S + 1, W, K, 3) positions of the obstacles, m.
        alive: (W, N) bool, drones that fly; the others touch nothing.
        radius: (W, N) bounding spheres of the drones, m.
        obstacle_radius: (K,) bounding spheres of the obstacles, m.
        city_grid: Where the pieces of the city are.

    Returns:
        Pairs of a drone and the ground, the city, an obstacle or another drone.
    """
    found = [(0, 0, 0) for _ in range(0)]
    reach = _reaches(position)
    obstacle_reach = _reaches(obstacle)
    for w in range(alive.shape[0]):
        # Sweep and prune: drones in the order of their x, so that few others come into question
        order = np.argsort(position[0, w, :, 0])
        widest = (reach[w] + radius[w]).max()
        for rank in range(order.shape[0]):
            i = order[rank]
            if not alive[w, i]:
                continue

            # What does not fly: ground, city and obstacles
            if _meets_ground(position, radius, w, i):
                found.append((w, i, GROUND))
            if _meets_city(position, radius, city_grid, w, i):
                found.append((w, i, CITY))
            for k in range(obstacle.shape[2]):
                within = radius[w, i] + obstacle_radius[k] + TOUCH
                begins = within + reach[w, i] + obstacle_reach[w, k]
                near = _near(position, obstacle, w, i, k, begins)
                if near and _meets(position, obstacle, w, i, k, within):
                    found.append((w, i, FIRST_OBSTACLE - k))

            # Drones further along x, until none can get here any more
            east = position[0, w, i, 0] + radius[w, i] + reach[w, i]
            farthest = east + widest + TOUCH
            for later in range(rank + 1, order.shape[0]):
                j = order[later]
                if position[0, w, j, 0] > farthest:
                    break
                within = radius[w, i] + radius[w, j] + TOUCH
                begins = within + reach[w, i] + reach[w, j]
                near = alive[w, j] and _near(position, position, w, i, j, begins)
                if near and _meets(position, position, w, i, j, within):
                    found.append((w, min(i, j), max(i, j)))
    return found


@kernel
def crowded(
    position: np.ndarray,
    moved: np.ndarray,
    alive: np.ndarray,
    radius: np.ndarray,
    city_grid: CityGrid,
) -> list[Pair]:
    """Find the pairs of living drones, or of one and the city, that may touch without moving.

    Args:
        position: (W, N, 3) positions of the drones, m.
        moved: (W, N) bool, drones of which at least one must be in a pair.
        alive: (W, N) bool, drones that fly.
        radius: (W, N) bounding spheres of the drones, m.
        city_grid: Where the pieces of the city are.

    Returns:
        Pairs whose bounding spheres, or boxes in the case of the city, overlap; some twice.
    """
    found = [(0, 0, 0) for _ in range(0)]
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if not (moved[w, i] and alive[w, i]):
                continue
            # Pieces of the city by boxes
            here = vec3(position, w, i)
            margin = radius[w, i] + TOUCH
            low, high = _box_about(here, here, margin)
            if meets(city_grid, w, low, high):
                found.append((w, i, CITY))
            # Other drones by spheres
            for j in range(alive.shape[1]):
                gap = between(here, vec3(position, w, j))
                within = margin + radius[w, j]
                if j != i and alive[w, j] and dot(gap, gap) < within * within:
                    found.append((w, min(i, j), max(i, j)))
    return found


@kernel
def any_fast(
    position: np.ndarray,
    obstacle: np.ndarray,
    alive: np.ndarray,
    parameters: np.ndarray,
) -> bool:
    """Tell whether a living drone, or an obstacle of its world, moves too far to be seen.

    Args:
        position: (2, W, N, 3) positions of the drones before and after a substep, m.
        obstacle: (2, W, K, 3) positions of the obstacles, m.
        alive: (W, N) bool, drones that fly.
        parameters: (W, N) rows of `PARAMETERS`.

    Returns:
        True where something moves by more than `FAST` times the drone's thinnest extent.
    """
    moved = _reaches(position)
    swept = _reaches(obstacle)
    for w in range(alive.shape[0]):
        farthest = 0.0
        for k in range(swept.shape[1]):
            farthest = max(farthest, swept[w, k])
        for i in range(alive.shape[1]):
            change = max(moved[w, i], farthest)
            if alive[w, i] and change > FAST * parameters[w, i].thinnest:
                return True
    return False


@kernel
def suspects(
    path: Path,
    alive: np.ndarray,
    parameters: np.ndarray,
    obstacle_radius: np.ndarray,
    city_grid: CityGrid,
) -> bool:
    """Tell whether `contacts.catch_fast` has anything to look at, for compiled code."""
    if not any_fast(path.position, path.obstacle, alive, parameters):
        return False
    # The broad phase alone: exact shapes are asked outside
    radius = parameters["collision_radius"]
    pairs = candidates(path.position, path.obstacle, alive, radius, obstacle_radius, city_grid)
    return len(pairs) > 0
