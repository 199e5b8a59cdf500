"""Observation blocks: named numbers that drones observe, with units and bounds."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.compiled.program import Program
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.tasks.frame import Frame

__all__ = ["Block", "Label", "Maker", "make_drone_block", "require_task_memory", "vector_labels"]

Compute = Callable[[Frame, np.ndarray], np.ndarray]
Add = Callable[[Program, Frame, np.ndarray], bool]


@dataclass(frozen=True)
class Block:
    """Some features of an observation, computed for all drones at once.

    Attributes:
        labels: Name, unit and bounds of each feature.
        compute: Returns (W, N, len(labels)) from a frame and `present` (W, N), the drones active
            after the decision.
        add: Adds steps to a program that write the features of a frame to a zeroed array (W, N,
            labels); returns False if it cannot. None to call `compute` instead.
    """

    labels: tuple[Label, ...]
    compute: Compute
    add: Add | None = None


Maker = Callable[[Any], Block]
"""Creates a block for a task"""


def make_drone_block(name: str, unit: str, high: float, drones: int) -> Block:
    """Return a block of the global state that shows a memory array (W, N), from 0 to `high`."""
    labels = tuple(Label(f"{name} of drone_{i}", unit, 0.0, high) for i in range(drones))
    return Block(labels, lambda frame, present: frame.scene.memory[name])


def require_task_memory(task: Any, block: str, names: tuple[str, ...]) -> None:
    """Check that a task has the memory that a block shows.

    Raises:
        ValueError: If the task has no memory of one of these names.
    """
    if not task.memory().keys() >= set(names):
        raise make_missing_error(task, block)


def make_missing_error(task: Any, block: str) -> ValueError:
    """Return the error for a block that shows data that a task does not have."""
    return ValueError(
        f"observation block {block!r} shows what task {task.name!r} does not have: leave it out"
    )
