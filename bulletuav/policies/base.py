"""The interface of policies: batched like the aviary."""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


class Policy(ABC):
    """Chooses the actions of all drones of all worlds.

    name         what the command line calls it
    actions      kinds of action that it can give, the preferred one first; none named: any
    reads_swarm  whether it uses the true state instead of the observations
    """

    name: ClassVar[str]
    actions: ClassVar[tuple[str, ...]]
    reads_swarm: ClassVar[bool]

    def __init__(self, aviary: Aviary):
        """Raises ValueError when the aviary's action is not one that the policy can give."""
        check_action(self.name, self.actions, aviary.options.action)
        self.aviary = aviary

    def encoded(self, setpoint: np.ndarray) -> np.ndarray:
        """The actions (W, N, 3) that ask for velocities (or target positions) `setpoint` (W, N, 3), m/s (m)."""
        encode = self.aviary.action.encode
        assert encode is not None  # all actions that policies ask for have one
        return encode(setpoint, self.aviary.commanded)

    @abstractmethod
    def reset(self, mask: np.ndarray) -> None:
        """Forget the worlds of `mask` (W,), which start anew."""

    @abstractmethod
    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Actions (W, N, A) for observations (W, N, D) and the true swarm."""


def check_action(policy: str, actions: tuple[str, ...], action: str) -> None:
    """Raise ValueError unless a policy that can give `actions` (none named: any) can give this one."""
    if actions and action not in actions:
        raise ValueError(
            f"policy {policy!r} gives {' or '.join(actions)} actions, not {action!r}: choose action={actions[0]!r}"
        )
