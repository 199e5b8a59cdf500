"""Observation blocks of landing pads: the clue of their place, and the pads that are claimed."""

from typing import Any

import numpy as np

from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.base import require_task_memory

PER_PAD = 4
"""Numbers per claimed pad: relative position, and 1"""


def _clue_labels(task: Any) -> tuple[Label, ...]:
    require_task_memory(task, "pad_clue", ("clue",))
    size = 2 * (task.arena_high - task.arena_low)
    return vector_labels("pad clue", "m", -size, size)


@register("observation")
@block(_clue_labels)
def pad_clue(all_clue: np.ndarray, known_position: Vec3) -> Vec3:
    """Offset from the drone to the clue of the pads, which is the same for all drones."""
    return (
        all_clue[0] - known_position[0],
        all_clue[1] - known_position[1],
        all_clue[2] - known_position[2],
    )


def _claim_labels(task: Any) -> tuple[Label, ...]:
    require_task_memory(task, "claimed_pads", ("claimed",))
    size = task.arena_high - task.arena_low
    labels: list[Label] = []
    for k in range(1, max(task.context.num_drones, 2)):
        labels += vector_labels(f"claimed pad {k}", "m", -size, size)
        labels.append(Label(f"claimed pad {k} flag", "1", 0.0, 1.0))
    return tuple(labels)


@register("observation")
@block(_claim_labels)
def claimed_pads(
    i: int,
    known_position: np.ndarray,
    all_claimed: np.ndarray,
    all_obstacle: np.ndarray,
    out: np.ndarray,
) -> None:
    """Claimed pads of other drones: position relative to the drone, and 1.

    One slot for each other drone, by index, with zeros until it claims a pad. Drones report their
    claims by radio, without loss, and the pads their positions from then on.
    """
    for p in range(len(all_claimed)):
        owner = int(all_claimed[p]) - 1
        if owner < 0 or owner == i:
            continue
        first = PER_PAD * (owner if owner < i else owner - 1)
        for k in range(3):
            out[first + k] = all_obstacle[p, k] - known_position[k]
        out[first + 3] = 1.0
