"""Observation blocks of teams."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.observations.neighbours import known_others


@register("observation")
def team(task: Any) -> Block:
    """One-hot encoding of the drone's team."""
    count = int(task.team.max()) + 1
    own = np.eye(count)[task.team]
    labels = tuple(Label(f"in team {k}", "1", 0.0, 1.0) for k in range(count))

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        return np.broadcast_to(own, (*present.shape, count))

    return Block(labels, compute)


@register("observation")
def neighbour_teams(task: Any) -> Block:
    """Teams of the drones in `neighbours`: 1 for the own team, -1 for another, 0 for padding."""
    slots = task.context.num_neighbours
    labels = tuple(Label(f"neighbour {k} team", "1", -1.0, 1.0) for k in range(1, slots + 1))
    relation = np.where(task.team[:, None] == task.team, 1.0, -1.0)

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        position, _, known = known_others(frame, present)
        # Sorted as in `neighbours`
        distance = np.linalg.norm(position - frame.known_position[:, :, None], axis=-1)
        distance = np.where(known, distance, np.inf)
        nearest = np.argsort(distance, axis=-1, kind="stable")[..., :slots]
        is_there = np.take_along_axis(known, nearest, axis=-1)
        of_team = np.take_along_axis(np.broadcast_to(relation, known.shape), nearest, axis=-1)
        out = np.zeros((*present.shape, slots))
        out[..., : nearest.shape[-1]] = np.where(is_there, of_team, 0.0)
        return out

    return Block(labels, compute)
