"""Observation blocks about other drones and obstacles."""

import math
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.compiled.program import Program
from bulletuav.geometry.closest_approach import closest_squared_distances, insert_nearest
from bulletuav.geometry.rotation import Vec3, dot, minus, vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import PRESENT
from bulletuav.tasks.observations.base import Block

HEARD = "heard"
"""Reading that tells which others drones have heard of; there only with communication"""
PER_NEIGHBOUR, PER_OBSTACLE = 7, 8
"""Numbers of each: distance, relative position, relative velocity; of obstacles the radius, too"""
NOW = 0.0
"""Horizon, s, of what is nearest now"""
AHEAD = 10.0
"""Horizon of `intruders`, s: at 20 m/s two that fly at each other are 400 m apart"""


def _relative(task: Any, name: str) -> tuple[Label, ...]:
    """Label another's position and velocity as seen from the drone."""
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

    Nearest first; zeros where there are fewer.
    """
    return _others(task, "neighbour", NOW)


@register("observation")
def intruders(task: Any) -> Block:
    """Other drones that come nearest within 10 s if all fly straight on, told as `neighbours`.

    That one first which comes nearest; zeros where there are fewer. Few of them say what many
    neighbours do not: whom to avoid among those that fly side by side.
    """
    return _others(task, "intruder", AHEAD)


def _others(task: Any, name: str, horizon: float) -> Block:
    """Make the block of others that come nearest within a time, s."""
    count = task.context.num_neighbours
    # For each, the nearest first: distance, relative position and velocity
    labels: list[Label] = []
    for k in range(1, count + 1):
        labels += [_distance(task, f"{name} {k}"), *_relative(task, f"{name} {k}")]

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        out = np.zeros((*present.shape, len(labels)))
        own = (frame.known_position, frame.known_velocity)
        # With a radio drones know of those that they heard, else of all
        if HEARD in frame.readings:
            nearest(*own, *heard(frame, present), horizon, count, out)
        else:
            nearest_present(*own, present, horizon, count, out)
        return out

    def add(program: Program, frame: Frame, out: np.ndarray) -> bool:
        if HEARD in frame.readings:
            return False
        own = (frame.known_position, frame.known_velocity)
        program.call(nearest_present, *own, frame.derived[PRESENT], horizon, count, out)
        return True

    return Block(tuple(labels), compute, add)


@register("observation")
def all_neighbours(task: Any) -> Block:
    """All other drones by index: relative position and velocity.

    Zeros for those that are not there.
    """
    drones = task.context.num_drones
    labels = tuple(label for k in range(1, drones) for label in _relative(task, f"other {k}"))
    listed = [[j for j in range(drones) if j != i] for i in range(drones)]
    others = np.array(listed, dtype=int).reshape(drones, drones - 1)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        position, velocity, known = heard(frame, present)
        own = np.concatenate([frame.known_position, frame.known_velocity], axis=-1)
        theirs = np.concatenate([position, velocity], axis=-1)
        seen = np.where(known[..., None], theirs - own[:, :, None], 0.0)
        ordered = np.take_along_axis(seen, others[None, :, :, None], axis=2)
        return ordered.reshape(*present.shape, len(labels))

    return Block(labels, compute)


@register("observation")
def obstacles(task: Any) -> Block:
    """Nearest obstacles: distance to bounding sphere, relative position and velocity, radius.

    Nearest first; zeros where there are fewer.
    """
    # Bounding spheres of the task's obstacles, which keep their sizes
    radius = np.array([obstacle.radius for obstacle in task.obstacles()])
    count = task.context.num_neighbours
    labels: list[Label] = []
    for k in range(1, count + 1):
        labels += [_distance(task, f"obstacle {k}"), *_relative(task, f"obstacle {k}")]
        labels.append(Label(f"obstacle {k} radius", "m", 0.0, float(radius.max(initial=1.0))))

    # On its own, or as a step of a compiled program
    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        out = np.zeros((*present.shape, len(labels)))
        own = (frame.known_position, frame.known_velocity)
        scene = frame.scene
        nearest_obstacles(*own, scene.obstacle, scene.obstacle_velocity, radius, count, out)
        return out

    def add(program: Program, frame: Frame, out: np.ndarray) -> bool:
        own = (frame.known_position, frame.known_velocity)
        them = (frame.scene.obstacle, frame.scene.obstacle_velocity, radius)
        program.call(nearest_obstacles, *own, *them, count, out)
        return True

    return Block(tuple(labels), compute, add)


def heard(frame: Frame, present: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Tell what drones know of each other.

    Without communication that is what the others know of themselves.

    Args:
        frame: The decision.
        present: (W, N) bool, drones that can still be met.

    Returns:
        Position and velocity (W, N, N, 3) of drone j as drone i knows them, and whether it knows of
        it, (W, N, N) bool.
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
def _least(theirs: tuple[Vec3, Vec3], own: tuple[Vec3, Vec3], horizon: float) -> float:
    """Compute how near another comes within `horizon`, s, if both fly straight on, m."""
    gap, speed = minus(theirs[0], own[0]), minus(theirs[1], own[1])
    # Where the other will be, relative to the drone
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
    """Write one of the others, as seen from the drone, to its `place` (w, i, slot)."""
    w, i, slot = place
    first = PER_NEIGHBOUR * slot
    # Relative to the drone, in world axes
    gap, speed = minus(theirs[0], own[0]), minus(theirs[1], own[1])
    out[w, i, first] = math.sqrt(dot(gap, gap))
    for k in range(3):
        out[w, i, first + 1 + k] = gap[k]
        out[w, i, first + 4 + k] = speed[k]


@allocating
def nearest(
    position: np.ndarray,
    velocity: np.ndarray,
    their_position: np.ndarray,
    their_velocity: np.ndarray,
    known: np.ndarray,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> None:
    """Fill `out` (W, N, 7 count) with others that are `known` (W, N, N).

    They are those that come nearest within `horizon`, s. See `heard` for what drones know of each
    other.
    """
    near, least = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(known.shape[0]):
        for i in range(known.shape[1]):
            own = (vec3(position, w, i), vec3(velocity, w, i))
            # Sort the nearest ones in, one after the other
            found = 0
            for j in range(known.shape[1]):
                if known[w, i, j]:
                    theirs = (vec3(their_position[w], i, j), vec3(their_velocity[w], i, j))
                    found = insert_nearest(near, least, found, j, _least(theirs, own, horizon))
            for slot in range(found):
                j = near[slot]
                theirs = (vec3(their_position[w], i, j), vec3(their_velocity[w], i, j))
                _write(out, (w, i, slot), theirs, own)


@allocating
def nearest_present(
    position: np.ndarray,
    velocity: np.ndarray,
    present: np.ndarray,
    horizon: float,
    count: int,
    out: np.ndarray,
) -> None:
    """Fill `out` (W, N, 7 count) with others that are `present` (W, N).

    They are those that come nearest within `horizon`, s.
    """
    near, least = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(present.shape[0]):
        for i in range(present.shape[1]):
            own = (vec3(position, w, i), vec3(velocity, w, i))
            # Sort the nearest ones in, one after the other
            found = 0
            for j in range(present.shape[1]):
                if present[w, j] and j != i:
                    theirs = (vec3(position, w, j), vec3(velocity, w, j))
                    found = insert_nearest(near, least, found, j, _least(theirs, own, horizon))
            for slot in range(found):
                j = near[slot]
                theirs = (vec3(position, w, j), vec3(velocity, w, j))
                _write(out, (w, i, slot), theirs, own)


@allocating
def nearest_obstacles(
    position: np.ndarray,
    velocity: np.ndarray,
    obstacle: np.ndarray,
    obstacle_velocity: np.ndarray,
    radius: np.ndarray,
    count: int,
    out: np.ndarray,
) -> None:
    """Fill `out` (W, N, 8 count) with the nearest of K obstacles, by their bounding spheres."""
    near, distance = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(position.shape[0]):
        for i in range(position.shape[1]):
            # Sort the nearest ones in, one after the other
            found = 0
            for j in range(len(radius)):
                square = 0.0
                for k in range(3):
                    square += (obstacle[w, j, k] - position[w, i, k]) ** 2
                gap = max(math.sqrt(square) - radius[j], 0.0)
                found = insert_nearest(near, distance, found, j, gap)
            # Write them, as seen from the drone
            for slot in range(found):
                j = near[slot]
                first = PER_OBSTACLE * slot
                out[w, i, first] = distance[slot]
                out[w, i, first + 7] = radius[j]
                for k in range(3):
                    speed = obstacle_velocity[w, j, k] - velocity[w, i, k]
                    out[w, i, first + 1 + k] = obstacle[w, j, k] - position[w, i, k]
                    out[w, i, first + 4 + k] = speed
