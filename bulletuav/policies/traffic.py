"""Traffic around each drone: the input of the avoidance policies.

Positions are relative to the drone, in world axes. This module reads the true state of the swarm;
`bulletuav.policies.observed` builds the same data from observations.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.convex import make_hull_shape, make_shape_table
from bulletuav.geometry.grid import (
    MIN_POINTS,
    Grid,
    cells_around,
    fill_grid,
    make_point_grid,
    num_rows,
    row_items,
    sort_ascending,
)
from bulletuav.geometry.rotation import Vec3, dot, minus, point, vec3
from bulletuav.geometry.shapes import distance_from_box
from bulletuav.geometry.solids import Solids

FACES = 6
"""Number of faces of the arena, the first rows of surfaces"""
DENSE = 8
"""Reciprocal of the fraction of points near one of them from which on all are searched"""
MIN_NORM = 1e-9
"""Minimum length of a vector that has a direction, m"""
NO_POSITIONS, NO_DRONES = np.zeros((0, 0, 3)), np.zeros((0, 0), dtype=bool)
"""`position` and `alive` of a `Traffic` without drones to search"""


class Traffic(NamedTuple):
    """Other drones (M), spheres (K) and surfaces (P) around N drones in each of W worlds.

    In a large swarm, a policy with a finite range gets rows of near drones only, or no rows, but
    the positions of all drones to search in, as the number of all rows is quadratic.

    Attributes:
        velocity: (W, N, 3) own velocities, m/s.
        goal: (W, N, 3) offsets to the goals, m.
        goal_velocity: (W, N, 3) velocities of the goals, m/s.
        offset: (W, N, M, 3) offsets to other drones, m.
        other_velocity: (W, N, M, 3) velocities of other drones, m/s.
        known: (W, N, M) bool, which of these rows are valid.
        sphere: (W, N, K, 3) offsets to the centres of spheres, m.
        sphere_velocity: (W, N, K, 3) velocities of the spheres, m/s.
        sphere_radius: (W, N, K) distances to maintain from these centres, m; 0 for unused rows.
        surface: (W, N, P, 4) unit normal of a static surface, towards the drone, and the distance
            that the drone may move towards it, m; infinite for unused rows.
        position: (W, N, 3) positions in which other drones are searched, m; empty for none.
        alive: (W, N) bool, which of these drones fly.
    """

    velocity: np.ndarray
    goal: np.ndarray
    goal_velocity: np.ndarray
    offset: np.ndarray
    other_velocity: np.ndarray
    known: np.ndarray
    sphere: np.ndarray
    sphere_velocity: np.ndarray
    sphere_radius: np.ndarray
    surface: np.ndarray
    position: np.ndarray = NO_POSITIONS
    alive: np.ndarray = NO_DRONES


class Buildings(NamedTuple):
    """P convex pieces of the buildings in all layouts of a task.

    Attributes:
        low: (P, 3) lower corners of the bounding boxes, m.
        high: (P, 3) upper corners of the bounding boxes, m.
        layout: (L, 2) first piece of each layout, and one past its last.
        plane: (F, 4) outward unit normal n of each face of a hull, and d of its plane n . x = d, m.
        planes: (P, 2) first face of each piece, and one past its last; empty ranges for boxes.
    """

    low: np.ndarray
    high: np.ndarray
    layout: np.ndarray
    plane: np.ndarray
    planes: np.ndarray


class ObstacleClearance(NamedTuple):
    """Distances that drones maintain to static obstacles.

    Attributes:
        body: Radius of a drone, m: distance to the ground and to the bounds of the arena.
        margin: Additional distance to spheres and buildings, m.
        max_distance: Distance beyond which buildings are ignored, m.
    """

    body: float
    margin: float
    max_distance: float


def tabulate_buildings(layouts: Sequence[Solids]) -> Buildings:
    """Build the table of the building pieces in all layouts."""
    bounds = np.concatenate([np.zeros((0, 2, 3)), *(solids.bounds for solids in layouts)])
    last = np.cumsum([len(solids.bounds) for solids in layouts], dtype=np.int64)
    first = last - [len(solids.bounds) for solids in layouts]
    plane: list[np.ndarray] = [np.zeros((0, 4))]
    planes: list[tuple[int, int]] = []
    count = 0
    for solids in layouts:
        planes += [(count, count)] * len(solids.boxes)
        for hull in solids.hulls:
            # Faces of shapes are relative to the centre of the shape, not to the world origin.
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
    spheres: tuple[np.ndarray, np.ndarray, np.ndarray],
    box: tuple[np.ndarray, np.ndarray],
    layout: np.ndarray,
    buildings: Buildings,
    clearance: ObstacleClearance,
    max_distance: float,
    is_searched: bool,
) -> Traffic:
    """Compute the traffic around each drone from the true state.

    Args:
        swarm: Positions (W, N, 3), m, velocities (W, N, 3), m/s, and (W, N) bool, which drones fly.
        goals: Positions and velocities (W, N, 3) of the goals.
        spheres: Positions and velocities (W, K, 3) of spheres, and distances (K,) to maintain, m.
        box: Lower and upper corner (3,) of the arena, m.
        layout: (W,) layout of each world; negative for none.
        buildings: Buildings of all layouts.
        clearance: Distances to static obstacles.
        max_distance: Distance within which other drones are needed, m. If it is finite, a large
            swarm has rows of these drones only, in the order of their indices.
        is_searched: Whether a large swarm has `position` and `alive` instead of these rows.
    """
    position, velocity, alive = swarm
    worlds, drones = alive.shape
    count = spheres[2].size
    goal_offset = np.empty((worlds, drones, 3))
    is_large = drones >= MIN_POINTS and max_distance < np.inf
    if is_large and not is_searched:
        offset, other_velocity, known = _near_others(swarm, max_distance)
    else:
        offset, other_velocity, known = _other_rows(swarm, 0 if is_large else drones)
    searched = drones if is_large and is_searched else 0
    places, used = np.empty((worlds, searched, 3)), np.empty((worlds, searched), np.bool_)
    places[:], used[:] = position[:, :searched], alive[:, :searched]
    sphere = np.empty((worlds, drones, count, 3))
    sphere_velocity = np.empty((worlds, drones, count, 3))
    sphere_radius = np.empty((worlds, drones, count))
    for w in range(worlds):
        for i in range(drones):
            for axis in range(3):
                here = position[w, i, axis]
                goal_offset[w, i, axis] = goals[0][w, i, axis] - here
                for k in range(count):
                    sphere[w, i, k, axis] = spheres[0][w, k, axis] - here
                    sphere_velocity[w, i, k, axis] = spheres[1][w, k, axis]
            for k in range(count):
                sphere_radius[w, i, k] = spheres[2][k]
    surface = find_surfaces(position, box, layout, buildings, clearance)
    return Traffic(
        velocity,
        goal_offset,
        goals[1],
        offset,
        other_velocity,
        known,
        sphere,
        sphere_velocity,
        sphere_radius,
        surface,
        places,
        used,
    )


@allocating
def _other_rows(
    swarm: tuple[np.ndarray, np.ndarray, np.ndarray], others: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute `offset`, `other_velocity` and `known` of `Traffic` for so many other drones."""
    position, velocity, alive = swarm
    worlds, drones = alive.shape
    offset = np.empty((worlds, drones, others, 3))
    other_velocity = np.empty((worlds, drones, others, 3))
    known = np.empty((worlds, drones, others), np.bool_)
    for w in range(worlds):
        for i in range(drones):
            for axis in range(3):
                here = position[w, i, axis]
                for j in range(others):
                    offset[w, i, j, axis] = position[w, j, axis] - here
                    other_velocity[w, i, j, axis] = velocity[w, j, axis]
            for j in range(others):
                known[w, i, j] = alive[w, i] and alive[w, j] and i != j
    return offset, other_velocity, known


@deferred(types.Tuple((types.float64[:, :, :, ::1],) * 2 + (types.boolean[:, :, ::1],)))
@allocating
def _near_others(
    swarm: tuple[np.ndarray, np.ndarray, np.ndarray], max_distance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the same rows as `_other_rows`, but of the drones within a distance only."""
    position, velocity, alive = swarm
    worlds, drones = alive.shape
    grid = make_point_grid(drones)
    # Number of near drones, and their indices one drone after the other
    count = np.zeros((worlds, drones), dtype=np.int64)
    near = np.empty((worlds, 64 * drones), dtype=np.int64)
    found = np.empty(drones, dtype=np.int64)
    most = 0
    for w in range(worlds):
        for i in range(drones):
            for k in range(3):
                grid.place[i, k] = position[w, i, k]
        if not fill_grid(grid, alive, w):
            return _other_rows(swarm, drones)
        total = 0
        for i in range(drones):
            if alive[w, i]:
                count[w, i] = _list_near(grid, alive, w, i, max_distance, found)
                if total + count[w, i] > near.shape[1]:
                    wider = np.empty((worlds, 2 * (total + count[w, i])), dtype=np.int64)
                    wider[:, : near.shape[1]] = near
                    near = wider
                near[w, total : total + count[w, i]] = found[: count[w, i]]
                total += count[w, i]
                most = max(most, count[w, i])
    offset = np.zeros((worlds, drones, most, 3))
    other_velocity = np.zeros((worlds, drones, most, 3))
    known = np.zeros((worlds, drones, most), np.bool_)
    for w in range(worlds):
        total = 0
        for i in range(drones):
            for k in range(count[w, i]):
                j = near[w, total + k]
                known[w, i, k] = True
                for axis in range(3):
                    offset[w, i, k, axis] = position[w, j, axis] - position[w, i, axis]
                    other_velocity[w, i, k, axis] = velocity[w, j, axis]
            total += count[w, i]
    return offset, other_velocity, known


@kernel
def _list_near(
    grid: Grid, is_used: np.ndarray, w: int, i: int, max_distance: float, found: np.ndarray
) -> int:
    """List the points within a distance of point i, ascending; return their number."""
    here = point(grid.place, i)
    radius = max_distance + grid.sizes[1]
    box = cells_around(grid, here, radius)
    count = 0
    candidates = 0
    for row in range(num_rows(box)):
        first, last = row_items(grid, box, row)
        candidates += last - first
    if DENSE * candidates > grid.place.shape[0]:
        # So many that a loop over all points is faster than to sort them
        for j in range(grid.place.shape[0]):
            between = minus(point(grid.place, j), here)
            if is_used[w, j] and j != i and dot(between, between) <= radius * radius:
                found[count] = j
                count += 1
        return count
    for row in range(num_rows(box)):
        first, last = row_items(grid, box, row)
        for m in range(first, last):
            j = grid.item[m]
            between = minus(point(grid.place, j), here)
            if j != i and dot(between, between) <= radius * radius:
                found[count] = j
                count += 1
    sort_ascending(found, count)
    return count


@allocating
def find_surfaces(
    position: np.ndarray,
    box: tuple[np.ndarray, np.ndarray],
    layout: np.ndarray,
    buildings: Buildings,
    clearance: ObstacleClearance,
) -> np.ndarray:
    """Find the faces of a box around drones, and the nearest surfaces of buildings.

    Args:
        position: (W, N, 3) positions, m.
        box: Lower and upper corner (3,) of the box, m.
        layout: (W,) layout of each world; negative for none.
        buildings: Buildings of all layouts.
        clearance: Distances to static obstacles.

    Returns:
        (W, N, P, 4) surfaces, as in `Traffic`.
    """
    worlds, drones, _ = position.shape
    # Number of rows: maximum number of near buildings of any drone.
    nothing = np.empty((0, 4))
    rows = 0
    for w in range(worlds):
        for i in range(drones):
            rows = max(rows, _near_buildings(nothing, position, layout, buildings, clearance, w, i))
    result = np.zeros((worlds, drones, FACES + rows, 4))
    result[..., 3] = np.inf
    for w in range(worlds):
        for i in range(drones):
            for axis in range(3):
                # Inward normals of the lower and the upper face.
                here = position[w, i, axis]
                result[w, i, 2 * axis, axis] = 1.0
                result[w, i, 2 * axis, 3] = here - box[0][axis] - clearance.body
                result[w, i, 2 * axis + 1, axis] = -1.0
                result[w, i, 2 * axis + 1, 3] = box[1][axis] - here - clearance.body
            _near_buildings(result[w, i, FACES:], position, layout, buildings, clearance, w, i)
    return result


@kernel
def _near_buildings(
    out: np.ndarray,
    position: np.ndarray,
    layout: np.ndarray,
    buildings: Buildings,
    clearance: ObstacleClearance,
    w: int,
    i: int,
) -> int:
    """Write the surfaces of near pieces to `out` if they fit; return their number."""
    if layout[w] < 0:
        return 0
    here = vec3(position, w, i)
    count = 0
    for p in range(buildings.layout[layout[w], 0], buildings.layout[layout[w], 1]):
        # The bounding box is a fast test of the distance
        low = point(buildings.low, p)
        high = point(buildings.high, p)
        if distance_from_box(here, low, high) > clearance.max_distance:
            continue
        # Count all pieces, so that the caller can allocate the rows
        if count < out.shape[0]:
            n, distance = _nearest_surface(here, buildings, p, low, high)
            for axis in range(3):
                out[count, axis] = n[axis]
            out[count, 3] = distance - clearance.body - clearance.margin
        count += 1
    return count


@func
def _nearest_surface(
    here: Vec3, buildings: Buildings, p: int, low: Vec3, high: Vec3
) -> tuple[Vec3, float]:
    """Return the normal of a piece's surface towards a point, and the distance, m.

    The surface of a box is at the nearest point. The surface of a hull is the face with the largest
    signed distance to the point, whose plane is never farther than the hull.
    """
    best = (0.0, 0.0, 1.0)
    distance = -np.inf
    if buildings.planes[p, 0] == buildings.planes[p, 1]:
        # A box: the nearest point; inside the box the distance is 0
        nearest = (
            min(max(here[0], low[0]), high[0]),
            min(max(here[1], low[1]), high[1]),
            min(max(here[2], low[2]), high[2]),
        )
        away = minus(here, nearest)
        distance = math.sqrt(dot(away, away))
        if distance > MIN_NORM:
            best = (away[0] / distance, away[1] / distance, away[2] / distance)
    # A hull: signed distances to its faces are negative inside
    for f in range(buildings.planes[p, 0], buildings.planes[p, 1]):
        n = point(buildings.plane, f)
        height = dot(n, here) - buildings.plane[f, 3]
        if height > distance:
            best = n
            distance = height
    return best, distance
