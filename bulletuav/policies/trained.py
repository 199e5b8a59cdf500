"""Trained policies, shared by all drones: each drone's own observation goes in, its action comes out."""

from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.spaces import widest_action_space
from bulletuav.policies.base import Policy
from bulletuav.policies.neural_network import Network, is_plain, read_weights
from bulletuav.policies.run import RunConfig
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

TRUST = (
    "it was saved by stable-baselines3, in a form that can run any code when it is read; if you know who made it, say so "
    "by --trust (in Python trust=True)"
)


class SharedPolicy(Policy):
    """A policy that maps rows of observations, one for each drone, to rows of actions."""

    name = "trained"
    actions = ()
    reads_swarm = False

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """What each drone does on its observation."""
        shape = self.aviary.alive.shape

        def rows(array: np.ndarray) -> np.ndarray:
            return array.reshape(-1, *array.shape[2:])

        if isinstance(observations, dict):
            seen: Any = {name: rows(array) for name, array in observations.items()}
        else:
            seen = rows(observations)
        return np.asarray(self._choose(seen), dtype=float).reshape(*shape, -1)

    @abstractmethod
    def _choose(self, rows: Any) -> np.ndarray:
        """Actions (M, A), or (M,) choices, for M rows of observations, or a dict of such."""


class Trained(SharedPolicy):
    """The policy of a training run, from a file that holds nothing but numbers.

    NumPy flies it; PyTorch, of the extra `sb3`, where it sees pictures or its layers are unusual.
    """

    def __init__(self, aviary: Aviary, config: RunConfig, path: str | Path):
        """Read the policy.

        Args:
            aviary: What it will fly.
            config: The settings of its run.
            path: The run's policy.safetensors, or that of a checkpoint.

        Raises:
            ValueError: The file holds another policy, or one for other observations or actions.
            ImportError: It needs the extra that is named.
        """
        super().__init__(aviary)
        path = Path(path)
        weights = read_weights(path)
        self._choose_rows: Callable[[Any], np.ndarray]
        space, action = aviary.observer.space(), widest_action_space(aviary.action)
        algo, model = config.algo, config.settings
        try:
            if isinstance(space, Box) and is_plain(algo, model):
                network = Network(weights, algo, model)
                choices = isinstance(action, Discrete)
                given = int(action.n) if isinstance(action, Discrete) else action.shape[0]  # type: ignore[index]
                if not network.fits(space.shape[0], given, choices):
                    raise ValueError(
                        f"it was trained for observations and actions of {network.shape}, and here they are "
                        f"{space.shape[0]} numbers to {given} {'choices' if choices else 'numbers'}"
                    )
                self._choose_rows = network
            else:
                from bulletuav.adapters.sb3_policy import (
                    policy_network,
                )  # the extra is needed from here on

                self._choose_rows = policy_network(
                    algo, model, space, action, aviary.num_drones, weights
                )
        except ValueError as error:
            raise ValueError(
                f"{path} is no policy of {algo} for this environment: {error}"
            ) from None

    def _choose(self, rows: Any) -> np.ndarray:
        return self._choose_rows(rows)


class Sb3Model(SharedPolicy):
    """A model that stable-baselines3 saved; PyTorch keeps to one thread, so that its actions are the same everywhere."""

    def __init__(self, aviary: Aviary, algorithm: str, path: str | Path, trust: bool = False):
        """Load a model.

        Args:
            aviary: What it will fly.
            algorithm: In lower case, such as "ppo".
            path: The zip file.
            trust: Whether the file may run code, which such files can hold.

        Raises:
            ValueError: It is not trusted, is no such model, or its spaces are not those of one drone.
            ImportError: It names the extra to install.
        """
        super().__init__(aviary)
        if not trust:
            raise ValueError(f"{path} is not read: {TRUST}")
        from bulletuav.adapters import sb3  # the extra is needed from here on

        sb3.single_thread()
        with sb3.own_random():
            try:
                self._model: Any = sb3.algorithm(algorithm).load(path, device="cpu")
            except (
                Exception
            ) as error:  # the library raises whatever it stumbles over in a file of another kind
                raise ValueError(f"{path} is no model of {algorithm}: {error}") from None
        for name, own, needed in (
            ("observations", aviary.observer.space(), self._model.observation_space),
            ("actions", widest_action_space(aviary.action), self._model.action_space),
        ):
            if own.shape != needed.shape or type(own) is not type(needed):
                kinds = [
                    f"{type(space).__name__} of shape {space.shape}" for space in (needed, own)
                ]
                raise ValueError(
                    f"{path} was trained for {name} in a {kinds[0]}, and here they are in a {kinds[1]}"
                )

    def _choose(self, rows: Any) -> np.ndarray:
        return self._model.predict(rows, deterministic=True)[0]
