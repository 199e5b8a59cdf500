"""Observation blocks of other drones and of obstacles."""

import math
from typing import Any

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.program import Program
from bulletuav.geometry.closest_approach import (
    closest_squared_distances,
    insert_nearest,
)
from bulletuav.geometry.grid import (
    MIN_POINTS,
    WIDENING,
    Grid,
    cells_around,
    clear_grid,
    fill_path_grid,
    is_grid_filled,
    is_whole,
    make_point_grid,
    new_point_grid,
    num_rows,
    row_items,
)
from bulletuav.geometry.rotation import Vec3, dot, minus, point, vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import PRESENT
from bulletuav.tasks.observations.base import Block

HEARD = "heard"
"""Reading of which other drones each drone has received messages from; only with communication"""
PER_NEIGHBOUR, PER_OBSTACLE = 7, 8
"""Numbers each: distance, relative position, relative velocity; for obstacles also the radius"""
NO_HORIZON = 0.0
"""Look-ahead time of blocks sorted by current distance, s"""
INTRUDER_HORIZON = 10.0
"""Look-ahead time of `intruders`, s: two drones approaching at 20 m/s each are then 400 m apart"""


def _relative(task: Any, name: str) -> tuple[Label, ...]:
    """Return the labels of another body's relative position and velocity."""
    size = task.arena_high - task.arena_low
    speed = np.full(3, 4 * task.context.max_speed)
    position = vector_labels(f"{name} position", "m", -size, size)
    return (*position, *vector_labels(f"{name} velocity", "m/s", -speed, speed))


def _distance(task: Any, name: str) -> Label:
    furthest = float(np.linalg.norm(task.arena_high - task.arena_low))
    return Label(f"{name} distance", "m", 0.0, furthest)


@register("observation")
def neighbours(task: Any) -> Block:
    """Nearest other drones: distance, relative position and velocity.

    Sorted by distance and padded with zeros.
    """
    return _others(task, "neighbour", NO_HORIZON)


@register("observation")
def intruders(task: Any) -> Block:
    """Other drones with the smallest distance within 10 s of straight flight, as in `neighbours`.

    Sorted by this distance and padded with zeros. A few intruders show which drones to avoid, which
    many neighbours that fly side by side may not.
    """
    return _others(task, "intruder", INTRUDER_HORIZON)


def _others(task: Any, name: str, horizon: float) -> Block:
    """Return the block of other drones with the smallest distance within a time, s."""
    count = task.context.num_neighbours
    labels: list[Label] = []
    for k in range(1, count + 1):
        labels += [_distance(task, f"{name} {k}"), *_relative(task, f"{name} {k}")]

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        out = np.zeros((*present.shape, len(labels)))
        own = (frame.known_position, frame.known_velocity)
        # With communication, drones know only those whose messages they received
        if HEARD in frame.readings:
            write_nearest_known(*own, *known_others(frame, present), horizon, count, out)
        else:
            write_nearest_present(*own, present, horizon, count, out)
        return out

    def add(program: Program, frame: Frame, out: np.ndarray) -> bool:
        if HEARD in frame.readings:
            return False
        own = (frame.known_position, frame.known_velocity)
        _add_nearest_present(program, *own, frame.derived[PRESENT], horizon, count, out)
        return True

    return Block(tuple(labels), compute, add)


@register("observation")
def all_neighbours(task: Any) -> Block:
    """All other drones by index: relative position and velocity.

    Zeros for inactive drones.
    """
    drones = task.context.num_drones
    labels = tuple(label for k in range(1, drones) for label in _relative(task, f"other {k}"))
    listed = [[j for j in range(drones) if j != i] for i in range(drones)]
    others = np.array(listed, dtype=int).reshape(drones, drones - 1)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        position, velocity, known = known_others(frame, present)
        own = np.concatenate([frame.known_position, frame.known_velocity], axis=-1)
        theirs = np.concatenate([position, velocity], axis=-1)
        seen = np.where(known[..., None], theirs - own[:, :, None], 0.0)
        ordered = np.take_along_axis(seen, others[None, :, :, None], axis=2)
        return ordered.reshape(*present.shape, len(labels))

    return Block(labels, compute)


@register("observation")
def obstacles(task: Any) -> Block:
    """Nearest obstacles: distance to bounding sphere, relative position and velocity, radius.

    Sorted by distance and padded with zeros.
    """
    radius = np.array([obstacle.radius for obstacle in task.obstacles()])
    count = task.context.num_neighbours
    labels: list[Label] = []
    for k in range(1, count + 1):
        labels += [_distance(task, f"obstacle {k}"), *_relative(task, f"obstacle {k}")]
        labels.append(Label(f"obstacle {k} radius", "m", 0.0, float(radius.max(initial=1.0))))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        out = np.zeros((*present.shape, len(labels)))
        own = (frame.known_position, frame.known_velocity)
        scene = frame.scene
        write_nearest_obstacles(*own, scene.obstacle, scene.obstacle_velocity, radius, count, out)
        return out

    def add(program: Program, frame: Frame, out: np.ndarray) -> bool:
        own = (frame.known_position, frame.known_velocity)
        them = (frame.scene.obstacle, frame.scene.obstacle_velocity, radius)
        program.call(write_nearest_obstacles, *own, *them, count, out)
        return True

    return Block(tuple(labels), compute, add)


def known_others(frame: Frame, present: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the positions and velocities of other drones as known to each drone.

    Without communication these are the measurements of the other drones themselves.

    Args:
        frame: The decision.
        present: (W, N) bool, drones active after the decision.

    Returns:
        Position and velocity (W, N, N, 3) of drone j as known to drone i, and whether drone i knows
        them, (W, N, N) bool.
    """
    if HEARD in frame.readings:
        known = frame.readings[HEARD] & present[:, None, :]
        return frame.readings["heard_position"], frame.readings["heard_velocity"], known
    worlds, drones = present.shape
    shape = (worlds, drones, drones, 3)
    others = present[:, None, :] & ~np.eye(drones, dtype=bool)
    return (
        np.broadcast_to(frame.known_position[:, None], shape),
        np.broadcast_to(frame.known_velocity[:, None], shape),
        others,
    )


@func
def _min_distance_within(
    theirs: tuple[Vec3, Vec3], own: tuple[Vec3, Vec3], horizon: float
) -> float:
    """Compute the minimum distance within `horizon`, s, if both drones fly straight, m."""
    gap, speed = minus(theirs[0], own[0]), minus(theirs[1], own[1])
    later = (
        gap[0] + horizon * speed[0],
        gap[1] + horizon * speed[1],
        gap[2] + horizon * speed[2],
    )
    return math.sqrt(closest_squared_distances(gap, later)[1])


@func
def _write(
    out: np.ndarray, place: tuple[int, int, int], theirs: tuple[Vec3, Vec3], own: tuple[Vec3, Vec3]
) -> None:
    """Write another drone's relative state to slot `place` (w, i, slot)."""
    w, i, slot = place
    first = PER_NEIGHBOUR * slot
    gap, speed = minus(theirs[0], own[0]), minus(theirs[1], own[1])
    out[w, i, first] = math.sqrt(dot(gap, gap))
    for k in range(3):
        out[w, i, first + 1 + k] = gap[k]
        out[w, i, first + 4 + k] = speed[k]


@allocating
def write_nearest_known(
    position: np.ndarray,
    velocity: np.ndarray,
    their_position: np.ndarray,
    their_velocity: np.ndarray,
    known: np.ndarray,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> None:
    """Write the `known` (W, N, N) others with the smallest distance within `horizon`, s.

    Args:
        position: (W, N, 3) m.
        velocity: (W, N, 3) m/s.
        their_position: (W, N, N, 3) positions of drone j as known to drone i, m.
        their_velocity: (W, N, N, 3) velocities of drone j as known to drone i, m/s.
        known: (W, N, N) bool, whether drone i knows drone j; see `known_others`.
        horizon: s.
        count: Maximum number of others.
        out: (W, N, 7 count) output.
    """
    near, least = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(known.shape[0]):
        for i in range(known.shape[1]):
            own = (vec3(position, w, i), vec3(velocity, w, i))
            found = 0
            for j in range(known.shape[1]):
                if known[w, i, j]:
                    theirs = (vec3(their_position[w], i, j), vec3(their_velocity[w], i, j))
                    found = insert_nearest(
                        near, least, found, j, _min_distance_within(theirs, own, horizon)
                    )
            for slot in range(found):
                j = near[slot]
                theirs = (vec3(their_position[w], i, j), vec3(their_velocity[w], i, j))
                _write(out, (w, i, slot), theirs, own)


@allocating
def write_nearest_present(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> None:
    """Write the `present` (W, N) others with the smallest distance within `horizon`, s.

    Args:
        position: (W, N, 3) m.
        velocity: (W, N, 3) m/s.
        present: (W, N) bool.
        horizon: s.
        count: Maximum number of others.
        out: (W, N, 7 count) output.
    """
    near, least = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(present.shape[0]):
        if present.shape[1] >= MIN_POINTS and _write_by_grid(
            position, velocity, present, w, horizon, count, out
        ):
            continue
        num_drones = present.shape[1]
        _write_among_all(position, velocity, present, w, horizon, near, least, out, 0, num_drones)


@func
def _write_among_all(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    w: int,
    horizon: float,
    near: np.ndarray,
    least: np.ndarray,
    out: np.ndarray,
    low: int,
    high: int,
) -> None:
    """Write the drones nearest to those from `low` to before `high`, by loops over all drones."""
    for i in range(low, high):
        own = (vec3(position, w, i), vec3(velocity, w, i))
        found = 0
        for j in range(present.shape[1]):
            if present[w, j] and j != i:
                theirs = (vec3(position, w, j), vec3(velocity, w, j))
                distance = _min_distance_within(theirs, own, horizon)
                found = insert_nearest(near, least, found, j, distance)
        for slot in range(found):
            j = near[slot]
            theirs = (vec3(position, w, j), vec3(velocity, w, j))
            _write(out, (w, i, slot), theirs, own)


@deferred(types.boolean)
@allocating
def _write_by_grid(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    w: int,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> bool:
    """Do the same as `write_nearest_present` for world w on a grid of the drones' paths.

    Returns False, and writes nothing, if a path is not finite.
    """
    grid = make_point_grid(present.shape[1])
    if not _fill_nearest_grid(position, velocity, present, w, horizon, grid):
        return False
    near, least = np.empty(count, dtype=np.int64), np.empty(count)
    num_drones = present.shape[1]
    _write_all_nearest(
        position, velocity, present, w, horizon, grid, near, least, out, 0, num_drones
    )
    return True


@func
def _fill_nearest_grid(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    w: int,
    horizon: float,
    grid: Grid,
) -> bool:
    """Fill the grid of the paths of world w; return False if a path is not finite."""
    for i in range(present.shape[1]):
        for k in range(3):
            # Drones that are not present see others, too
            if not math.isfinite(position[w, i, k] + horizon * velocity[w, i, k]):
                return False
    return bool(fill_path_grid(grid, position, velocity, horizon, present, w))


@kernel
def _write_all_nearest(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    w: int,
    horizon: float,
    grid: Grid,
    near: np.ndarray,
    least: np.ndarray,
    out: np.ndarray,
    low: int,
    high: int,
) -> None:
    """Write the drones nearest to those from `low` to before `high` of world w, with its grid.

    `near` and `least` (count,) are work arrays.
    """
    total = 0
    for i in range(present.shape[1]):
        total += present[w, i]
    for i in range(low, high):
        own = (vec3(position, w, i), vec3(velocity, w, i))
        # All entries are found within the final radius
        wanted = min(near.size, total - 1) if present[w, i] else min(near.size, total)
        closer = grid.reach[i] + grid.sizes[2]
        radius = grid.sizes[0] + closer
        found = 0
        while wanted > 0:
            found = 0
            box = cells_around(grid, point(grid.place, i), radius)
            for row in range(num_rows(box)):
                first, last = row_items(grid, box, row)
                for m in range(first, last):
                    j = grid.item[m]
                    theirs = (vec3(position, w, j), vec3(velocity, w, j))
                    distance = _min_distance_within(theirs, own, horizon)
                    if j != i:
                        found = insert_nearest(near, least, found, j, distance)
            if found == wanted and least[found - 1] <= radius - closer:
                break
            if is_whole(grid, box):
                break
            radius *= WIDENING
        for slot in range(found):
            j = near[slot]
            theirs = (vec3(position, w, j), vec3(velocity, w, j))
            _write(out, (w, i, slot), theirs, own)


@kernel
def start_nearest(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    horizon: float,
    grid: Grid,
) -> None:
    """Fill the grid of a single world for `write_nearest_of_drones`."""
    if not _fill_nearest_grid(position, velocity, present, 0, horizon, grid):
        clear_grid(grid)


@kernel
def write_nearest_of_drones(
    low: int,
    high: int,
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    horizon: float,
    grid: Grid,
    out: np.ndarray,
    near: np.ndarray,
    least: np.ndarray,
) -> None:
    """Do the same as `write_nearest_present` for some drones of a single world.

    Args:
        low: Index of the first drone.
        high: Index after the last drone.
        position: (1, N, 3) m.
        velocity: (1, N, 3) m/s.
        present: (1, N) bool.
        horizon: s.
        grid: Grid of `start_nearest`.
        out: (1, N, 7 count) output.
        near: (count,) work array.
        least: (count,) work array.
    """
    if is_grid_filled(grid):
        _write_all_nearest(
            position, velocity, present, 0, horizon, grid, near, least, out, low, high
        )
    else:
        _write_among_all(position, velocity, present, 0, horizon, near, least, out, low, high)


def _add_nearest_present(
    program: Program,
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> None:
    """Add calls to a program that do the same as `write_nearest_present`."""
    num_worlds, num_drones = present.shape
    if program.threads == 1 or num_worlds > 1 or num_drones < MIN_POINTS:
        program.call(write_nearest_present, position, velocity, present, horizon, count, out)
        return
    grid, paths = new_point_grid(num_drones), (position, velocity, present, horizon)
    work = [(np.zeros(count, dtype=np.int64), np.zeros(count)) for _ in range(program.threads)]
    program.call(start_nearest, *paths, grid)
    program.call(*program.shared(write_nearest_of_drones, num_drones, *paths, grid, out, own=work))


@allocating
def write_nearest_obstacles(
    position: np.ndarray,
    velocity: np.ndarray,
    obstacle: np.ndarray,
    obstacle_velocity: np.ndarray,
    radius: np.ndarray,
    count: int,
    out: np.ndarray,
) -> None:
    """Write the nearest of K obstacles, by distance to their bounding spheres.

    Args:
        position: (W, N, 3) m.
        velocity: (W, N, 3) m/s.
        obstacle: (W, K, 3) m.
        obstacle_velocity: (W, K, 3) m/s.
        radius: (K,) bounding radii, m.
        count: Maximum number of obstacles.
        out: (W, N, 8 count) output.
    """
    near, distance = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            found = 0
            for j in range(len(radius)):
                square = 0.0
                for k in range(3):
                    square += (obstacle[w, j, k] - position[w, i, k]) ** 2
                gap = max(math.sqrt(square) - radius[j], 0.0)
                found = insert_nearest(near, distance, found, j, gap)
            for slot in range(found):
                j = near[slot]
                first = PER_OBSTACLE * slot
                out[w, i, first] = distance[slot]
                out[w, i, first + 7] = radius[j]
                for k in range(3):
                    speed = obstacle_velocity[w, j, k] - velocity[w, i, k]
                    out[w, i, first + 1 + k] = obstacle[w, j, k] - position[w, i, k]
                    out[w, i, first + 4 + k] = speed
