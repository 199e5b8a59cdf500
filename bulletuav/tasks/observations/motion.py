"""Observation blocks about motion: each says what its numbers are, in which unit and within which bounds.

Positions and velocities of drones are those that they know (see `Frame`); without randomization they are the true ones.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bulletuav.control.actions import Action
from bulletuav.geometry.closest_approach import keep_nearest
from bulletuav.kernel import kernel

if TYPE_CHECKING:
    from bulletuav.tasks.base import Frame, Task

MAX_BODY_RATE = 50.0  # rad/s


class Label(NamedTuple):
    """One number of an observation; values beyond the bounds are clipped to them."""

    name: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Block:
    """Some numbers of an observation: `compute(frame, present)` gives (W, N, len(labels)).

    `present` (W, N) are the drones that can still be met after the frame.
    """

    labels: tuple[Label, ...]
    compute: Callable[["Frame", np.ndarray], np.ndarray]


def vector_labels(
    name: str, unit: str, low: Iterable[float], high: Iterable[float]
) -> tuple[Label, ...]:
    """Labels of x, y and z."""
    return tuple(Label(f"{name} {k}", unit, a, b) for k, a, b in zip("xyz", low, high, strict=True))


def position(task: "Task") -> Block:
    """Own position, world axes."""
    labels = vector_labels("position", "m", task.arena_low, task.arena_high)
    return Block(labels, lambda frame, present: frame.known_position)


def attitude(task: "Task") -> Block:
    """Own attitude: quaternion body to world, of the two signs the one with w >= 0."""

    def compute(frame, present):
        quaternion = frame.after.quaternion
        return np.where(quaternion[..., 3:] < 0, -quaternion, quaternion)

    low = (-1.0, -1.0, -1.0, 0.0)
    return Block(
        tuple(Label(f"quaternion {k}", "1", a, 1.0) for k, a in zip("xyzw", low, strict=True)),
        compute,
    )


def velocity(task: "Task") -> Block:
    """Own velocity, world axes."""
    bound = np.full(3, 2 * task.context.max_speed)
    return Block(
        vector_labels("velocity", "m/s", -bound, bound), lambda frame, present: frame.known_velocity
    )


def rates(task: "Task") -> Block:
    """Own angular velocity, body axes."""
    bound = np.full(3, MAX_BODY_RATE)
    return Block(
        vector_labels("rates", "rad/s", -bound, bound), lambda frame, present: frame.after.rates
    )


def goal_position(task: "Task") -> Block:
    """The goal's position, world axes."""
    return Block(
        vector_labels("goal", "m", task.arena_low, task.arena_high),
        lambda frame, present: frame.scene.goal,
    )


def goal_offset(task: "Task") -> Block:
    """From the drone to its goal, world axes."""
    size = task.arena_high - task.arena_low
    labels = vector_labels("goal offset", "m", -size, size)
    return Block(labels, lambda frame, present: frame.scene.goal - frame.known_position)


def goal_velocity(task: "Task") -> Block:
    """The goal's velocity, world axes."""
    bound = np.full(3, 2 * task.context.max_speed)
    return Block(
        vector_labels("goal velocity", "m/s", -bound, bound),
        lambda frame, present: frame.scene.goal_velocity,
    )


def goal(task: "Task") -> Block:
    """Direction to the goal (unit vector, world axes) and distance."""

    def compute(frame, present):
        offset = frame.scene.goal - frame.known_position
        distance = frame.known_distance[..., None]
        return np.concatenate([offset / np.maximum(distance, 1e-9), distance], axis=-1)

    furthest = float(np.linalg.norm(task.arena_high - task.arena_low))
    one = np.ones(3)
    return Block(
        (
            *vector_labels("goal direction", "1", -one, one),
            Label("goal distance", "m", 0.0, furthest),
        ),
        compute,
    )


def alive(task: "Task") -> Block:
    """1 while the drone flies, else 0."""
    return Block(
        (Label("alive", "1", 0.0, 1.0),), lambda frame, present: present[..., None].astype(float)
    )


def identity(task: "Task") -> Block:
    """Which drone it is: 1 at its own index, else 0."""
    drones = task.context.num_drones

    def compute(frame, present):
        return np.broadcast_to(np.eye(drones), (len(present), drones, drones))

    return Block(tuple(Label(f"is drone {i}", "1", 0.0, 1.0) for i in range(drones)), compute)


def _relative(task: "Task", name: str) -> tuple[Label, ...]:
    """Labels of another's position and velocity as seen from the drone."""
    size = task.arena_high - task.arena_low
    speed = np.full(3, 4 * task.context.max_speed)
    return *vector_labels(f"{name} position", "m", -size, size), *vector_labels(
        f"{name} velocity", "m/s", -speed, speed
    )


def _distance(task: "Task", name: str) -> Label:
    return Label(
        f"{name} distance", "m", 0.0, float(np.linalg.norm(task.arena_high - task.arena_low))
    )


def neighbours(task: "Task") -> Block:
    """The nearest other drones, nearest first: distance, relative position and velocity; zeros where there are fewer."""
    count = task.context.num_neighbours
    labels = []
    for k in range(1, count + 1):
        labels += [_distance(task, f"neighbour {k}"), *_relative(task, f"neighbour {k}")]

    def compute(frame, present):
        out = np.zeros((*present.shape, len(labels)))
        nearest(frame.known_position, frame.known_velocity, *heard(frame, present), count, out)
        return out

    return Block(tuple(labels), compute)


def all_neighbours(task: "Task") -> Block:
    """All other drones by index: relative position and velocity; zeros for those that are not there."""
    drones = task.context.num_drones
    labels = tuple(label for k in range(1, drones) for label in _relative(task, f"other {k}"))
    others = np.array(
        [[j for j in range(drones) if j != i] for i in range(drones)], dtype=int
    ).reshape(drones, drones - 1)

    def compute(frame, present):
        position, velocity, known = heard(frame, present)
        own = np.concatenate([frame.known_position, frame.known_velocity], axis=-1)
        seen = np.where(
            known[..., None], np.concatenate([position, velocity], axis=-1) - own[:, :, None], 0.0
        )
        return np.take_along_axis(seen, others[None, :, :, None], axis=2).reshape(
            *present.shape, len(labels)
        )

    return Block(labels, compute)


def obstacles(task: "Task") -> Block:
    """The nearest obstacles, nearest first: distance to their bounding spheres, relative position, velocity and radius.

    Zeros where there are fewer.
    """
    radius = np.array([obstacle.radius for obstacle in task.obstacles()])
    shown = min(task.context.num_neighbours, len(radius))
    labels = []
    for k in range(1, task.context.num_neighbours + 1):
        labels += [_distance(task, f"obstacle {k}"), *_relative(task, f"obstacle {k}")]
        labels.append(Label(f"obstacle {k} radius", "m", 0.0, float(radius.max(initial=1.0))))

    def compute(frame, present):
        out = np.zeros((*present.shape, task.context.num_neighbours, 8))
        offset = frame.scene.obstacle[:, None] - frame.known_position[:, :, None]
        gap = np.maximum(np.linalg.norm(offset, axis=-1) - radius, 0.0)
        order = np.argsort(gap, axis=-1, kind="stable")[..., :shown, None]
        speed = frame.scene.obstacle_velocity[:, None] - frame.known_velocity[:, :, None]
        out[..., :shown, :1] = np.take_along_axis(gap[..., None], order, axis=2)
        out[..., :shown, 1:4] = np.take_along_axis(offset, order, axis=2)
        out[..., :shown, 4:7] = np.take_along_axis(speed, order, axis=2)
        out[..., :shown, 7] = radius[order[..., 0]]
        return out.reshape(*present.shape, len(labels))

    return Block(tuple(labels), compute)


def last_action(action: Action) -> Block:
    """What the drone was told last, zeros at the start."""
    bounds = zip(action.low.min(axis=0), action.high.max(axis=0), strict=True)
    labels = tuple(
        Label(f"action {k}", "1", float(low), float(high)) for k, (low, high) in enumerate(bounds)
    )
    return Block(labels, lambda frame, present: frame.action)


def heard(frame: "Frame", present: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities (W, N, N, 3) of others j as drone i knows them, and of whom it knows (W, N, N).

    Without communication that is what the others know of themselves.
    """
    if "heard" in frame.readings:
        known = frame.readings["heard"] & present[:, None, :]
        return frame.readings["heard_position"], frame.readings["heard_velocity"], known
    worlds, drones = present.shape
    shape = (worlds, drones, drones, 3)
    others = present[:, None, :] & ~np.eye(drones, dtype=bool)
    return (
        np.broadcast_to(frame.known_position[:, None], shape),
        np.broadcast_to(frame.known_velocity[:, None], shape),
        others,
    )


@kernel
def nearest(position, velocity, their_position, their_velocity, known, count, out):
    """Fill `out` (W, N, 7 count) with the nearest others that are `known` (W, N, N); see `heard` for what they are."""
    drones = known.shape[1]
    near, distance = np.empty(count, dtype=np.int64), np.empty(count)
    for w in range(known.shape[0]):
        for i in range(drones):
            found = 0
            for j in range(drones):
                if not known[w, i, j]:
                    continue
                square = 0.0
                for k in range(3):
                    square += (their_position[w, i, j, k] - position[w, i, k]) ** 2
                found = keep_nearest(near, distance, found, j, math.sqrt(square))
            for slot in range(found):
                j = near[slot]
                out[w, i, 7 * slot] = distance[slot]
                for k in range(3):
                    out[w, i, 7 * slot + 1 + k] = their_position[w, i, j, k] - position[w, i, k]
                    out[w, i, 7 * slot + 4 + k] = their_velocity[w, i, j, k] - velocity[w, i, k]
