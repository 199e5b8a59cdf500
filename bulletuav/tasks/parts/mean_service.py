"""Mean service over an episode, by which tasks of service judge success."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.parts.base import Part, Rngs

SERVICE_SHIRKERS = (
    "service_fixed",
    "service_by_one",
    "service_but_one",
    "service_late",
    "service_half",
    "service_conflict",
)
"""Policies that try to be paid for service without doing it; see
`bulletuav.policies.shirkers.service`"""
ROUNDING = 1e-9
"""Maximum rounding error of a mean"""


class MeanService(Part):
    """Mean of a fraction of service over all decisions of an episode, also of those to come.

    Decisions that have not been taken count as without service. A drone can therefore not succeed
    early and rest, nor by ending its episode at a good moment, nor by service at the end only. The
    info "mean_service" has the mean.
    """

    def __init__(self, task: Task[Any], served: Callable[[Frame], np.ndarray]) -> None:
        """Average the service of a task.

        Args:
            task: The task, with the option `wanted`.
            served: Function of a frame that returns the service of a decision, (W, N) from 0 to 1,
                the same for all drones of a world.
        """
        context = task.context
        self._served, self._wanted = served, float(task.config.wanted)
        self._num_decisions = max(round(context.duration / context.period), 1)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of "service" (), the sum of the service of all decisions so far."""
        return {"service": ()}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Add the service of the decision."""
        service = frame.scene.memory["service"]
        service += self._served(frame)[:, 0]

    def mean(self, frame: Frame) -> np.ndarray:
        """Return the mean service, (W, N) from 0 to 1."""
        mean: np.ndarray = frame.scene.memory["service"][:, None] / self._num_decisions
        return mean + np.zeros(frame.alive.shape)

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether the mean is at least the option `wanted`, (W, N) bool."""
        return self.mean(frame) >= self._wanted - ROUNDING

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the mean as "mean_service"."""
        return {"mean_service": self.mean(frame)}
