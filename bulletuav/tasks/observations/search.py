"""Observation blocks of searches: the clue, the victim in sight, and what the drone knows."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.observations.base import Block, require_task_memory

NOISE_BOUND = 1.5
"""Bound of an observed offset to a victim, in largest true offsets"""


@register("observation")
def clue_offset(task: Any) -> Block:
    """Vector from the drone to the clue, world axes."""
    require_task_memory(task, "clue_offset", ("clue",))
    size = task.arena_high - task.arena_low

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        offset: np.ndarray = frame.scene.memory["clue"][:, None] - frame.known_position
        return offset

    return Block(vector_labels("clue offset", "m", -size, size), compute)


@register("observation")
def sighting(task: Any) -> Block:
    """Nearest victim in sight: 1, and its offset with noise, world axes; zeros for none."""
    require_task_memory(task, "sighting", ("sighting",))
    reach = NOISE_BOUND * float(task.config.sight_radius)
    depth = NOISE_BOUND * float(task.arena_high[2])
    bound = np.array([reach, reach, depth])
    labels = (Label("victim seen", "1", 0.0, 1.0), *vector_labels("victim", "m", -bound, bound))
    return Block(labels, lambda frame, present: frame.scene.memory["sighting"])


@register("observation")
def victims_found(task: Any) -> Block:
    """Fraction of the victims that the drone knows as found."""
    require_task_memory(task, "victims_found", ("known_found",))
    label = Label("victims found", "1", 0.0, 1.0)
    return Block(
        (label,),
        lambda frame, present: frame.scene.memory["known_found"].mean(axis=-1, keepdims=True),
    )


@register("observation")
def searched_cells(task: Any) -> Block:
    """Squares around the clue: 1 if the drone knows it as searched, or there is no free ground.

    They are in columns from west to east, each from south to north.
    """
    require_task_memory(task, "searched_cells", ("known_cells", "has_ground"))
    labels = tuple(
        Label(f"searched {x:g} east {y:g} north of the clue", "1", 0.0, 1.0)
        for x, y in task.grid.tolist()
    )

    def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
        memory = frame.scene.memory
        known: np.ndarray = np.maximum(memory["known_cells"], 1 - memory["has_ground"][:, None])
        return known

    return Block(labels, compute)
