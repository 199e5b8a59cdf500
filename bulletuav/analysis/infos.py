"""Selection of the infos that a task adds to the standard ones."""

from collections.abc import Mapping

import numpy as np

from bulletuav.tasks.check import STANDARD_INFOS as INFOS_OF_EVERY_TASK
from bulletuav.tasks.check import STANDARD_PREFIXES

STANDARD_INFOS = INFOS_OF_EVERY_TASK | {"messages"}
"""Infos of every task, and those that come with randomization"""


def select_task_infos(info: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Select the infos that are specific to the task.

    Args:
        info: Infos of a decision, (W, N, ...) by name.

    Returns:
        The infos whose names are not standard, in their order.
    """
    return {
        name: values
        for name, values in info.items()
        if name not in STANDARD_INFOS and not name.startswith(STANDARD_PREFIXES)
    }


def is_scalar(values: np.ndarray, shape: tuple[int, int]) -> bool:
    """Return True if an info holds one number for each drone of `shape` (worlds, drones)."""
    return values.shape == shape and values.dtype.kind in "biuf"
