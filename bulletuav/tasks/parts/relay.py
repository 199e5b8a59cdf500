"""Relays: service by line of sight, to which each drone has to contribute."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.errors import finite
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.mean_service import ROUNDING
from bulletuav.tasks.parts.users import Service, Users


@dataclass(frozen=True)
class RelayOptions:
    """Options of relays.

    Attributes:
        min_contribution: Fraction of users that only the drone itself has to see, averaged over the
            episode, for its success; 0 for none.
    """

    min_contribution: float = 0.02


class Relay(Service):
    """Service to all users in sight; a drone without a contribution of its own has no success.

    The contribution of a drone is the fraction of users that it sees and no other drone does: the
    service of the team would be lower by as much without the drone. A drone that rests while the
    others serve enough users does not succeed. Decisions that have not been taken count as without
    contribution. The info "contribution" has the mean.

    References:
        The difference reward of D. Wolpert and K. Tumer, Optimal payoff functions for members of
        collectives (2001).
    """

    def __init__(self, task: Task[Any], users: Users) -> None:
        """Set up the service to the users of a task.

        Args:
            task: The task, with the options `wanted` and `min_contribution`.
            users: Its users.

        Raises:
            ValueError: If `min_contribution` is not from 0 to 1.
        """
        super().__init__(task, users)
        context = task.context
        self._num_drones = context.num_drones
        self._num_decisions = max(round(context.duration / context.period), 1)
        needed = finite("min_contribution", task.config.min_contribution, 0, 1)
        self._needed = needed - ROUNDING

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shape of "contribution" (N,), the sum over all decisions so far."""
        return {"contribution": (self._num_drones,)}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Add the contributions of the decision."""
        add_contributions(frame.readings["sight"], frame.alive, frame.scene.memory["contribution"])

    def contribution(self, frame: Frame) -> np.ndarray:
        """Return the mean fraction of users that only the drone itself sees, (W, N)."""
        mean: np.ndarray = frame.scene.memory["contribution"] / self._num_decisions
        return mean

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether the team serves enough users, and the drone contributes, (W, N) bool."""
        return super().succeeded(frame) & (self.contribution(frame) >= self._needed)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the mean contribution."""
        return {"contribution": self.contribution(frame)}


@kernel
def add_contributions(sight: np.ndarray, alive: np.ndarray, contribution: np.ndarray) -> None:
    """Add the fraction of users that only the drone itself sees to `contribution`.

    Args:
        sight: (W, N, U) bool, users that drones see.
        alive: (W, N) bool, active drones; others see no user.
        contribution: (W, N) sums, updated.
    """
    num_users = sight.shape[2]
    for w in range(alive.shape[0]):
        for j in range(num_users):
            count, last = 0, 0
            for i in range(alive.shape[1]):
                if alive[w, i] and sight[w, i, j]:
                    count += 1
                    last = i
            if count == 1:
                contribution[w, last] += 1.0 / num_users
