"""What drones know of the traffic around them, each in a frame of its own position.

Axes are those of the world. This is what avoiding policies work from; it comes from the true swarm
here, and from observations in `bulletuav.policies.observed`.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.convex import make_hull_shape, make_shape_table
from bulletuav.geometry.rotation import Vec3, dot, minus, point, vec3
from bulletuav.geometry.shapes import distance_from_box
from bulletuav.geometry.solids import Solids

FACES = 6
"""Faces of the arena, the first rows of surfaces"""
NO_DIRECTION = 1e-9
"""Length below which a vector has no direction, m"""


class Traffic(NamedTuple):
    """What N drones in each of W worlds know of M other drones, K balls and P surfaces.

    Attributes:
        velocity: (W, N, 3) own velocities, m/s.
        goal: (W, N, 3) ways to the goals, m.
        goal_velocity: (W, N, 3) velocities of the goals, m/s.
        gap: (W, N, M, 3) ways to other drones, m.
        other: (W, N, M, 3) their velocities, m/s.
        known: (W, N, M) bool, which rows of these are drones.
        ball: (W, N, K, 3) ways to the centres of balls, m.
        ball_velocity: (W, N, K, 3) velocities of the balls, m/s.
        ball_radius: (W, N, K) distances to keep from these centres, m; 0 for rows without a ball.
        surface: (W, N, P, 4) unit normal of a surface that stands still, towards the drone, and how
            far the drone may come towards it, m; infinite for rows without a surface.
    """

    velocity: np.ndarray
    goal: np.ndarray
    goal_velocity: np.ndarray
    gap: np.ndarray
    other: np.ndarray
    known: np.ndarray
    ball: np.ndarray
    ball_velocity: np.ndarray
    ball_radius: np.ndarray
    surface: np.ndarray


class Buildings(NamedTuple):
    """P convex pieces of all layouts of a task.

    Attributes:
        low: (P, 3) low corners of their bounding boxes, m.
        high: (P, 3) high corners of these, m.
        layout: (L, 2) first piece of each layout, and the one after its last.
        plane: (F, 4) outward unit normal n of each face of a hull, and d of its plane n . x = d, m.
        planes: (P, 2) first face of each piece, and the one after its last; none for boxes.
    """

    low: np.ndarray
    high: np.ndarray
    layout: np.ndarray
    plane: np.ndarray
    planes: np.ndarray


class Clearance(NamedTuple):
    """How far drones keep away from what stands still.

    Attributes:
        body: Radius of a drone, m: kept from the ground and the arena's bounds.
        margin: More of it, m: kept from balls and buildings.
        reach: Distance beyond which a building does not matter, m.
    """

    body: float
    margin: float
    reach: float


def buildings(layouts: Sequence[Solids]) -> Buildings:
    """Make the table of what can stand in a world."""
    bounds = np.concatenate([np.zeros((0, 2, 3)), *(solids.bounds for solids in layouts)])
    last = np.cumsum([len(solids.bounds) for solids in layouts], dtype=np.int64)
    first = last - [len(solids.bounds) for solids in layouts]
    plane: list[np.ndarray] = [np.zeros((0, 4))]
    planes: list[tuple[int, int]] = []
    count = 0
    for solids in layouts:
        planes += [(count, count)] * len(solids.boxes)
        for hull in solids.hulls:
            # Shapes have their faces about a middle, not about the world's origin.
            middle = hull.mean(axis=0)
            faces = make_shape_table([make_hull_shape(hull - middle)]).face_planes
            plane.append(np.column_stack([faces[:, :3], faces[:, 3] + faces[:, :3] @ middle]))
            planes.append((count, count + len(faces)))
            count += len(faces)
    return Buildings(
        low=bounds[:, 0].copy(),
        high=bounds[:, 1].copy(),
        layout=np.column_stack([first, last]).astype(np.int64).reshape(-1, 2),
        plane=np.concatenate(plane),
        planes=np.array(planes, dtype=np.int64).reshape(-1, 2),
    )


@allocating
def true_traffic(
    swarm: tuple[np.ndarray, np.ndarray, np.ndarray],
    goals: tuple[np.ndarray, np.ndarray],
    balls: tuple[np.ndarray, np.ndarray, np.ndarray],
    box: tuple[np.ndarray, np.ndarray],
    layout: np.ndarray,
    stands: Buildings,
    clear: Clearance,
) -> Traffic:
    """Tell what drones would know if they knew all.

    Args:
        swarm: Positions (W, N, 3), m, velocities (W, N, 3), m/s, and (W, N) bool, who flies.
        goals: Positions and velocities (W, N, 3) of the goals.
        balls: Positions and velocities (W, K, 3) of balls, and the distances (K,) to keep, m.
        box: Low and high corner (3,) of the arena, m.
        layout: (W,) which layout stands in each world; negative for none.
        stands: What can stand in a world.
        clear: How far drones keep away from what stands still.
    """
    position, velocity, alive = swarm
    worlds, drones = alive.shape
    count = balls[2].size
    way = np.empty((worlds, drones, 3))
    gap = np.empty((worlds, drones, drones, 3))
    other = np.empty((worlds, drones, drones, 3))
    known = np.empty((worlds, drones, drones), np.bool_)
    ball = np.empty((worlds, drones, count, 3))
    ball_velocity = np.empty((worlds, drones, count, 3))
    ball_radius = np.empty((worlds, drones, count))
    for w in range(worlds):
        for i in range(drones):
            for axis in range(3):
                here = position[w, i, axis]
                way[w, i, axis] = goals[0][w, i, axis] - here
                # Other drones, then balls.
                for j in range(drones):
                    gap[w, i, j, axis] = position[w, j, axis] - here
                    other[w, i, j, axis] = velocity[w, j, axis]
                for k in range(count):
                    ball[w, i, k, axis] = balls[0][w, k, axis] - here
                    ball_velocity[w, i, k, axis] = balls[1][w, k, axis]
            for j in range(drones):
                known[w, i, j] = alive[w, i] and alive[w, j] and i != j
            for k in range(count):
                ball_radius[w, i, k] = balls[2][k]
    surface = surfaces(position, box, layout, stands, clear)
    return Traffic(
        velocity, way, goals[1], gap, other, known, ball, ball_velocity, ball_radius, surface
    )


@allocating
def surfaces(
    position: np.ndarray,
    box: tuple[np.ndarray, np.ndarray],
    layout: np.ndarray,
    stands: Buildings,
    clear: Clearance,
) -> np.ndarray:
    """Find the faces of a box about drones, and the nearest surfaces of buildings.

    Args:
        position: (W, N, 3) positions, m.
        box: Low and high corner (3,) of the box, m.
        layout: (W,) which layout stands in each world; negative for none.
        stands: What can stand in a world.
        clear: How far drones keep away from it.

    Returns:
        (W, N, P, 4) surfaces, as in `Traffic`.
    """
    worlds, drones, _ = position.shape
    # As many rows as the drone with the most buildings needs.
    nothing = np.empty((0, 4))
    most = 0
    for w in range(worlds):
        for i in range(drones):
            most = max(most, _near_buildings(nothing, position, layout, stands, clear, w, i))
    result = np.zeros((worlds, drones, FACES + most, 4))
    result[..., 3] = np.inf
    for w in range(worlds):
        for i in range(drones):
            for axis in range(3):
                # Into the box at its low face, and back at its high one.
                here = position[w, i, axis]
                result[w, i, 2 * axis, axis] = 1.0
                result[w, i, 2 * axis, 3] = here - box[0][axis] - clear.body
                result[w, i, 2 * axis + 1, axis] = -1.0
                result[w, i, 2 * axis + 1, 3] = box[1][axis] - here - clear.body
            _near_buildings(result[w, i, FACES:], position, layout, stands, clear, w, i)
    return result


@kernel
def _near_buildings(
    out: np.ndarray,
    position: np.ndarray,
    layout: np.ndarray,
    stands: Buildings,
    clear: Clearance,
    w: int,
    i: int,
) -> int:
    """Write the surfaces of pieces within reach to `out`, where there is room; count them."""
    # A world without a city
    if layout[w] < 0:
        return 0
    here = vec3(position, w, i)
    count = 0
    for p in range(stands.layout[layout[w], 0], stands.layout[layout[w], 1]):
        # The box tells fast whether a piece is near enough
        low = point(stands.low, p)
        high = point(stands.high, p)
        if distance_from_box(here, low, high) > clear.reach:
            continue
        # All are counted, so that the caller can make room and ask again
        if count < out.shape[0]:
            n, distance = _nearest_surface(here, stands, p, low, high)
            for axis in range(3):
                out[count, axis] = n[axis]
            out[count, 3] = distance - clear.body - clear.margin
        count += 1
    return count


@func
def _nearest_surface(
    here: Vec3,
    stands: Buildings,
    p: int,
    low: Vec3,
    high: Vec3,
) -> tuple[Vec3, float]:
    """Find the normal of a piece's surface towards a point, and the distance, m.

    Of a box it is at the nearest point; of a hull it is the face that is the farthest below the
    point, whose plane is never farther than the hull.
    """
    best = (0.0, 0.0, 1.0)
    distance = -np.inf
    if stands.planes[p, 0] == stands.planes[p, 1]:
        # A box: the point of it that is nearest; inside of it the distance is 0
        nearest = (
            min(max(here[0], low[0]), high[0]),
            min(max(here[1], low[1]), high[1]),
            min(max(here[2], low[2]), high[2]),
        )
        away = minus(here, nearest)
        distance = math.sqrt(dot(away, away))
        if distance > NO_DIRECTION:
            best = (away[0] / distance, away[1] / distance, away[2] / distance)
    # A hull: heights over its faces are negative inside
    for f in range(stands.planes[p, 0], stands.planes[p, 1]):
        n = point(stands.plane, f)
        height = dot(n, here) - stands.plane[f, 3]
        if height > distance:
            best = n
            distance = height
    return best, distance
