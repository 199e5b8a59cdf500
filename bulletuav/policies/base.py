"""Interface of policies, which choose the actions of all drones in all worlds."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, TypeVar

import numpy as np

from bulletuav.control.actions import ActionNames, action_names
from bulletuav.envs.aviary import Aviary
from bulletuav.tasks.base import Task
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


class Policy(ABC):
    """Base class of policies that control all drones of an aviary, N drones in each of W worlds.

    A custom policy derives from this class in an importable module. It is selected with `--policy
    module:Name`, or by its `name` if the class is decorated with `@register("policy")`:

        class Higher(Policy):
            name = "higher"
            actions = ("velocity",)
            reads_swarm = True

            def reset(self, mask): ...

            def act(self, observations, swarm):
                return self.encoded(np.full(swarm.position.shape, (0.0, 0.0, 1.0)))

    Attributes:
        name: Name on the command line and in tables.
        actions: Supported action types, the preferred one first; empty if all are supported.
        reads_swarm: Whether the policy reads the true state instead of the observations.
        remembers: Names of the attributes that hold state between decisions; snapshots save them.
        aviary: The controlled worlds.
    """

    name: ClassVar[str]
    actions: ClassVar[tuple[str, ...]]
    reads_swarm: ClassVar[bool]
    remembers: ClassVar[tuple[str, ...]] = ()

    def __init__(self, aviary: Aviary) -> None:
        """Bind the policy to an aviary.

        Args:
            aviary: The worlds to control.

        Raises:
            ValueError: If the policy does not support the action type of the aviary.
        """
        check_action(self.name, self.actions, aviary.options.action)
        self.aviary = aviary

    def encoded(self, setpoint: np.ndarray) -> np.ndarray:
        """Encode world-frame setpoints as actions.

        Args:
            setpoint: (W, N, 3) velocities, m/s; target positions, m, if the action type is a target
                position.

        Returns:
            (W, N, A) actions that command the setpoints.
        """
        encode = self.aviary.action.encode
        assert encode is not None  # every action type that a baseline supports can be encoded
        return encode(setpoint, self.aviary.commanded)

    @abstractmethod
    def reset(self, mask: np.ndarray) -> None:
        """Reset the state of the worlds in `mask` (W,) bool, in which a new episode starts."""

    @abstractmethod
    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose the actions of all drones.

        Args:
            observations: (W, N, D) observations of the drones, or a dict of such arrays.
            swarm: The true state of all drones.

        Returns:
            (W, N, A) actions.
        """

    def memory(self) -> dict[str, Any]:
        """Return a copy of the state that the policy keeps between decisions, for `restore`."""
        return {name: copy.deepcopy(getattr(self, name)) for name in self.remembers}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned, also from another policy of this class."""
        for name, value in copy.deepcopy(dict(memory)).items():
            setattr(self, name, value)


def check_action(policy: str, actions: tuple[ActionNames, ...], action: ActionNames) -> None:
    """Check that a policy supports an action type.

    Args:
        policy: Name of the policy, for the message.
        actions: Supported action types; empty if all are supported.
        action: Action type of the environment; or of each drone, or by team.

    Raises:
        ValueError: If the action type is not supported.
    """
    if not actions or action in actions:
        return
    for name in action_names(action):
        if name not in actions:
            raise ValueError(
                f"policy {policy!r} supports {' or '.join(map(str, actions))} actions, not "
                f"{name!r}: choose action={actions[0]!r}"
            )


TaskT = TypeVar("TaskT", bound=Task[Any])


def require_supported_task(policy: Policy, kind: type[TaskT]) -> TaskT:
    """Return the task of a policy that supports one kind of task only.

    Raises:
        ValueError: If the task is of another kind.
    """
    task = policy.aviary.task
    if not isinstance(task, kind):
        raise ValueError(
            f"policy {policy.name!r} supports task {kind.name!r}, not {task.name!r}: choose "
            f"another policy"
        )
    return task
