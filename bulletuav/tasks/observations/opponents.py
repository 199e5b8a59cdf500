"""Observation blocks of two-team games: opponents in sight, and teammates."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.sensors.drone_sight import DRONE_SIGHT
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.observations.neighbours import (
    NO_HORIZON,
    PER_NEIGHBOUR,
    known_others,
    write_nearest_known,
)

PER_OPPONENT = 1 + PER_NEIGHBOUR
"""Numbers per opponent: whether it is seen, distance, relative position, relative velocity"""


def opponents_in_sight(task: Any, frame: Frame, present: np.ndarray) -> np.ndarray:
    """Return which opponents each drone sees.

    Opponents are seen within the task's `sight_range` and, if there is a reading "drone_sight",
    only if nothing but drones is in between.

    Args:
        task: The task, which defines the teams.
        frame: The decision.
        present: (W, N) bool, drones active after the decision.

    Returns:
        (W, N, N) bool, whether drone i sees drone j.
    """
    opposed = task.team[:, None] != task.team
    position = frame.after.position
    gap = np.linalg.norm(position[:, None] - position[:, :, None], axis=-1)
    seen: np.ndarray = opposed & present[:, None, :]
    seen &= gap <= getattr(task, "sight_range", np.inf)
    if DRONE_SIGHT in frame.readings:
        seen &= frame.readings[DRONE_SIGHT]
    return seen


def _labels(task: Any, name: str) -> tuple[Label, ...]:
    """Return the labels of another drone's distance, relative position and relative velocity."""
    size = task.arena_high - task.arena_low
    speed = np.full(3, 4 * task.context.max_speed)
    return (
        Label(f"{name} distance", "m", 0.0, float(np.linalg.norm(size))),
        *vector_labels(f"{name} position", "m", -size, size),
        *vector_labels(f"{name} velocity", "m/s", -speed, speed),
    )


@register("observation")
def opponents(task: Any) -> Block:
    """Nearest opponents in sight: 1 for seen, distance, relative position and velocity.

    Sorted by distance and padded with zeros. Measured optically, without error.
    """
    slots = task.context.num_neighbours
    labels: list[Label] = []
    for k in range(1, slots + 1):
        labels += [Label(f"opponent {k} seen", "1", 0.0, 1.0), *_labels(task, f"opponent {k}")]

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        # Optical: true positions, independent of communication
        position, velocity = frame.after.position, frame.after.velocity
        shape = (*present.shape, present.shape[1], 3)
        places = np.broadcast_to(position[:, None], shape)
        speeds = np.broadcast_to(velocity[:, None], shape)
        seen = opponents_in_sight(task, frame, present)
        rows = np.zeros((*present.shape, slots * PER_NEIGHBOUR))
        write_nearest_known(position, velocity, places, speeds, seen, NO_HORIZON, slots, rows)
        # The first slots are occupied
        flags = np.arange(slots) < seen.sum(axis=-1)[..., None]
        rows = rows.reshape(*present.shape, slots, PER_NEIGHBOUR)
        return np.concatenate([flags[..., None], rows], axis=-1).reshape(*present.shape, -1)

    return Block(tuple(labels), compute)


@register("observation")
def teammates(task: Any) -> Block:
    """Nearest drones of the own team: distance, relative position and velocity.

    Sorted by distance and padded with zeros. Positions are those that teammates measure and report.
    """
    slots = task.context.num_neighbours
    names = range(1, slots + 1)
    labels = tuple(label for k in names for label in _labels(task, f"teammate {k}"))
    own = task.team[:, None] == task.team

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        position, velocity, known = known_others(frame, present)
        rows = np.zeros((*present.shape, len(labels)))
        mine = (frame.known_position, frame.known_velocity)
        write_nearest_known(*mine, position, velocity, known & own, NO_HORIZON, slots, rows)
        return rows

    return Block(labels, compute)
