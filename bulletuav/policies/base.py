"""The interface of policies, which choose the actions of all drones of all worlds at once."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


class Policy(ABC):
    """A policy that flies all drones of an aviary, W worlds of N drones.

    A policy of one's own derives from this class, in a module that can be imported, and flies by
    `--policy module:Name`, or under its `name` once `@register("policy")` is above it:

        class Higher(Policy):
            name = "higher"
            actions = ("velocity",)
            reads_swarm = True

            def reset(self, mask): ...

            def act(self, observations, swarm):
                return self.encoded(np.full(swarm.position.shape, (0.0, 0.0, 1.0)))

    Attributes:
        name: Its name on the command line and in tables.
        actions: Actions that it can give, the preferred one first; none named: any.
        reads_swarm: Whether it uses the true state instead of the observations.
        remembers: Names of the attributes in which it remembers anything between decisions, for
            snapshots.
        aviary: The worlds that it flies.
    """

    name: ClassVar[str]
    actions: ClassVar[tuple[str, ...]]
    reads_swarm: ClassVar[bool]
    remembers: ClassVar[tuple[str, ...]] = ()

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly.

        Args:
            aviary: The worlds that it flies.

        Raises:
            ValueError: The aviary's action is not one that the policy can give.
        """
        check_action(self.name, self.actions, aviary.options.action)
        self.aviary = aviary

    def encoded(self, setpoint: np.ndarray) -> np.ndarray:
        """Encode setpoints as actions.

        Args:
            setpoint: (W, N, 3) velocities, m/s, or where the action is a target position, places,
                m; in world axes.

        Returns:
            (W, N, 3) actions that ask for them.
        """
        encode = self.aviary.action.encode
        assert encode is not None  # all actions that policies ask for have one
        return encode(setpoint, self.aviary.commanded)

    @abstractmethod
    def reset(self, mask: np.ndarray) -> None:
        """Forget the worlds of `mask` (W,), which start anew."""

    @abstractmethod
    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose actions.

        Args:
            observations: (W, N, D) of each drone, or a dict of such arrays.
            swarm: The true state of all drones.

        Returns:
            (W, N, A) actions.
        """

    def memory(self) -> dict[str, Any]:
        """Copy all that it remembers, for `restore`."""
        return {name: copy.deepcopy(getattr(self, name)) for name in self.remembers}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Go on with what `memory` gave, here or in another policy of the same class."""
        for name, value in copy.deepcopy(dict(memory)).items():
            setattr(self, name, value)


def check_action(policy: str, actions: tuple[str, ...], action: str) -> None:
    """Refuse an action that a policy cannot give.

    Args:
        policy: Name of the policy, for the message.
        actions: Actions that it can give; none named: any.
        action: The action of the environment.

    Raises:
        ValueError: The action is not among them.
    """
    if actions and action not in actions:
        raise ValueError(
            f"policy {policy!r} gives {' or '.join(actions)} actions, not {action!r}: "
            f"choose action={actions[0]!r}"
        )
