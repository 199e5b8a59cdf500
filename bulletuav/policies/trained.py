"""Trained policies that all drones share: each drone's observation goes in, its action out."""

import importlib
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box, Discrete

from bulletuav.control.actions import CHOICES, Action, make_action
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import action_context
from bulletuav.envs.spaces import widest_action_space
from bulletuav.policies.base import Policy
from bulletuav.policies.neural_network import Network, Weights, is_plain, read_weights
from bulletuav.policies.run import RunConfig
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

TRUST = (
    "it was saved by stable-baselines3, in a form that can run any code when it is read; "
    "if you know who made it, say so by --trust (in Python trust=True)"
)
"""Why a model of stable-baselines3 is not read, and what to do"""
SB3_POLICY = "bulletuav.adapters.sb3_policy"
"""Module of PyTorch's networks; it is above this room and needs the extra"""
VELOCITY = "velocity"
"""Action by which choices among velocities can be given, too"""
Choose = Callable[[Any], np.ndarray]
"""Function from M rows of observations, or a dict of such arrays, to M rows of actions"""


def actions_given(learned: str) -> tuple[str, ...]:
    """List the actions that a run's policy can give: what it learned, and velocities of choices."""
    return (learned, VELOCITY) if learned in CHOICES else (learned,)


class SharedPolicy(Policy):
    """A policy that maps rows of observations, one for each drone, to rows of actions."""

    name = "trained"
    actions = ()
    reads_swarm = False

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as actions follow from the last observation alone."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose each drone's action on its own observation; see `Policy.act`."""
        shape = self.aviary.alive.shape
        rows: Observation
        if isinstance(observations, dict):
            rows = {name: _rows(array) for name, array in observations.items()}
        else:
            rows = _rows(observations)
        return np.asarray(self._choose(rows), dtype=float).reshape(*shape, -1)

    @abstractmethod
    def _choose(self, rows: Any) -> np.ndarray:
        """Choose actions (M, A), or (M,) choices, for M rows of observations, or a dict of such."""


def _rows(array: np.ndarray) -> np.ndarray:
    """Put the drones of all worlds one below the other: (W * N, ...) from (W, N, ...)."""
    return array.reshape(-1, *array.shape[2:])


class Trained(SharedPolicy):
    """The policy of a training run, from a file that holds nothing but numbers.

    NumPy flies it. PyTorch does, of the extra `sb3`, where it sees pictures or its layers are
    unusual. A network that chooses among velocities flies where velocities are asked for, too.
    """

    def __init__(self, aviary: Aviary, config: RunConfig, path: str | Path) -> None:
        """Read the policy.

        Args:
            aviary: The worlds that it flies.
            config: The settings of its run.
            path: The run's policy.safetensors, or that of a checkpoint.

        Raises:
            ValueError: The file holds another policy, or one for other observations or actions.
            ImportError: It needs the extra that is named.
        """
        super().__init__(aviary)
        path = Path(path)
        weights = read_weights(path)
        self._learned = aviary.action
        if aviary.options.action != config.action:
            # It still chooses, and asks for the velocity that it chose
            context = action_context(aviary.options, aviary.task)
            self._learned = make_action(config.action, context)
        try:
            self._choose_rows = _network(aviary, config, weights, self._learned)
        except ValueError as error:
            raise ValueError(
                f"{path} is no policy of {config.algo} for this environment: {error}"
            ) from None

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose actions by the network; see `Policy.act`."""
        aviary = self.aviary
        actions = super().act(observations, swarm)
        if self._learned is aviary.action:
            return actions
        return self.encoded(self._learned.decode(actions, aviary.commanded)[..., :3])

    def _choose(self, rows: Any) -> np.ndarray:
        """Choose the actions of the network."""
        return self._choose_rows(rows)


def _network(aviary: Aviary, config: RunConfig, weights: Weights, learned: Action) -> Choose:
    """Build a run's network from its weights; raise ValueError where they do not fit."""
    observed = aviary.observer.space()
    given = widest_action_space(learned)
    settings = config.settings
    # Pictures and unusual layers need PyTorch.
    if not isinstance(observed, Box) or not is_plain(config.algo, settings):
        adapter = importlib.import_module(SB3_POLICY)
        network = adapter.policy_network(
            name=config.algo,
            model=settings,
            observed=observed,
            given=given,
            num_drones=aviary.num_drones,
            labels=aviary.observer.labels,
            weights=weights,
        )
        return cast(Choose, network)
    # All others are flown by NumPy.
    plain = Network(weights, config.algo, settings, aviary.observer.labels)
    if isinstance(given, Discrete):
        size, unit = int(given.n), "choices"
    else:
        size, unit = int(cast(Box, given).shape[0]), "numbers"
    if not plain.fits(observed.shape[0], size, choices=unit == "choices"):
        raise ValueError(
            f"it was trained for observations and actions of {plain.shape}, and here they are "
            f"{observed.shape[0]} numbers to {size} {unit}"
        )
    return plain
