"""Numbers that a task adds to the infos of a decision by itself."""

from collections.abc import Mapping

import numpy as np

from bulletuav.tasks.check import STANDARD_INFOS as INFOS_OF_EVERY_TASK
from bulletuav.tasks.check import STANDARD_PREFIXES

STANDARD_INFOS = INFOS_OF_EVERY_TASK | {"messages"}
"""Infos that every task has, or that come with randomization"""


def select_task_infos(info: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Pick the infos that are the task's own.

    Args:
        info: Infos of a decision, (W, N, ...) by name.

    Returns:
        Those whose names are not standard, in their order.
    """
    return {
        name: values
        for name, values in info.items()
        if name not in STANDARD_INFOS and not name.startswith(STANDARD_PREFIXES)
    }


def is_scalar(values: np.ndarray, shape: tuple[int, int]) -> bool:
    """Tell whether an info holds one number for each drone of `shape` (worlds, drones)."""
    return values.shape == shape and values.dtype.kind in "biuf"
