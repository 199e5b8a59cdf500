"""Trained policies with shared weights: each drone's observation is mapped to its action."""

import importlib
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Box, Discrete

from bulletuav.control.actions import CHOICES, Action, ActionNames, action_names, make_action
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import action_context
from bulletuav.envs.spaces import widest_action_space
from bulletuav.policies.base import Policy
from bulletuav.policies.neural_network import Network, Weights, is_plain, read_weights
from bulletuav.policies.run import RunConfig
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

TRUST = (
    "it was saved by stable-baselines3, in a format that can execute code when it is read; "
    "if you trust its author, set --trust (in Python trust=True)"
)
"""Reason why a model of stable-baselines3 is not read, and the remedy"""
SB3_POLICY = "bulletuav.adapters.sb3_policy"
"""Module of the PyTorch networks; imported lazily, as it needs an extra"""
VELOCITY = "velocity"
"""Action type that policies with discrete choices among velocities support, too"""
RowsToActions = Callable[..., np.ndarray]
"""Function from M rows of observations, or a dict of such arrays, to M rows of actions.

If the policy was trained with masks, (M, C) bool masks of the actions are its second argument.
"""


def actions_given(learned: ActionNames) -> tuple[ActionNames, ...]:
    """List the supported action types: the trained one, and velocity for discrete choices."""
    return (learned, VELOCITY) if learned in CHOICES else (learned,)


class SharedPolicy(Policy):
    """Policy that maps rows of observations, one per drone, to rows of actions."""

    name = "trained"
    actions = ()
    reads_swarm = False

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: actions depend on the current observation only."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose each drone's action from its own observation; see `Policy.act`."""
        shape = self.aviary.alive.shape
        rows: Observation
        if isinstance(observations, dict):
            rows = {name: _rows(array) for name, array in observations.items()}
        else:
            rows = _rows(observations)
        return np.asarray(self._choose(rows), dtype=float).reshape(*shape, -1)

    @abstractmethod
    def _choose(self, rows: Any) -> np.ndarray:
        """Return actions (M, A), or choices (M,), for M rows of observations or a dict of such."""


def _rows(array: np.ndarray) -> np.ndarray:
    """Reshape (W, N, ...) to (W * N, ...)."""
    return array.reshape(-1, *array.shape[2:])


class Trained(SharedPolicy):
    """Policy of a training run, from a safetensors file.

    Inference runs in NumPy. Policies with image observations or unusual layers run in PyTorch
    (extra `sb3`). A network that was trained to choose among velocities also supports velocity
    actions.
    """

    def __init__(self, aviary: Aviary, config: RunConfig, path: str | Path) -> None:
        """Read the policy.

        Args:
            aviary: The worlds to control.
            config: Configuration of the run.
            path: The policy.safetensors of the run or of a checkpoint.

        Raises:
            ValueError: If the file contains another policy, or observations or actions do not
                match.
            ImportError: If the named extra is not installed.
        """
        super().__init__(aviary)
        path = Path(path)
        weights = read_weights(path)
        self._learned = aviary.action
        learned = action_names(config.action)
        if action_names(aviary.options.action) != learned:
            # Decode the discrete choice, and command the chosen velocity
            context = action_context(aviary.options, aviary.task)
            self._learned = make_action(learned[0], context)
        self._masks = aviary.worlds.make_masks(self._learned) if config.action_masks else None
        try:
            config.require_observed(aviary.task.name, aviary.options)
            self._choose_rows = _network(aviary, config, weights, self._learned)
        except ValueError as error:
            raise ValueError(
                f"{path} is not a policy of {config.algo} for this environment: {error}"
            ) from None

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose actions with the network; see `Policy.act`."""
        aviary = self.aviary
        actions = super().act(observations, swarm)
        if self._learned is aviary.action:
            return actions
        return self.encoded(self._learned.decode(actions, aviary.commanded)[..., :3])

    def _choose(self, rows: Any) -> np.ndarray:
        if self._masks is None:
            return self._choose_rows(rows)
        masks = self.aviary.worlds.compute_masks(self._masks)
        return self._choose_rows(rows, _rows(masks).astype(bool))


def _network(aviary: Aviary, config: RunConfig, weights: Weights, learned: Action) -> RowsToActions:
    """Build the network of a run from its weights; raise ValueError if they do not match."""
    observed = aviary.observer.space()
    given = widest_action_space(learned)
    settings = config.settings
    # Image observations and unusual layers need PyTorch.
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
            masked=config.action_masks,
        )
        return cast(RowsToActions, network)
    plain = Network(weights, config.algo, settings, aviary.observer.labels)
    if isinstance(given, Discrete):
        size, unit = int(given.n), "choices"
    else:
        size, unit = int(cast(Box, given).shape[0]), "numbers"
    if not plain.fits(observed.shape[0], size, choices=unit == "choices"):
        raise ValueError(
            f"it was trained for observations and actions of {plain.shape}, not "
            f"{observed.shape[0]} numbers to {size} {unit}"
        )
    return plain
