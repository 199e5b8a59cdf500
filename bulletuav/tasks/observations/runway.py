"""Observation block of a runway: how long it is still occupied."""

from typing import Any

import numpy as np

from bulletuav.registry import register
from bulletuav.sensors.base import Label
from bulletuav.tasks.ingredients import block
from bulletuav.tasks.observations.base import require_task_memory


def _runway_labels(task: Any) -> tuple[Label, ...]:
    require_task_memory(task, "runway", ("runway_free",))
    return (Label("time until the runway is free", "s", 0.0, task.config.runway_time),)


@register("observation")
@block(_runway_labels)
def runway(all_runway_free: np.ndarray, time: float) -> float:
    """Time until the runway is free, 0 if it is; the tower sends it to all drones."""
    left: float = all_runway_free[0] - time
    return max(left, 0.0)
