"""Models trained with stable-baselines3, shared by all drones, each with its own observation."""

from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.spaces import widest_action_space
from bulletuav.physics.swarm import Swarm
from bulletuav.policies.base import Policy
from bulletuav.tasks.terms.observations import Observation


class Trained(Policy):
    """The deterministic actions of a model; PyTorch keeps to one thread, so that they are the same everywhere."""

    name = "trained"
    actions = ()
    reads_swarm = False

    def __init__(self, aviary: Aviary, algorithm: str, path: str | Path, fresh: bool = False):
        """Load `path`, a model that the algorithm saved; `fresh`: with the weights that its training began with.

        Raises ValueError where its spaces are not those of one drone, ImportError that names the extra to install.
        """
        super().__init__(aviary)
        from bulletuav.adapters import sb3  # the extra is needed from here on

        sb3.single_thread()
        with sb3.own_random():
            try:
                self._model: Any = sb3.algorithm(algorithm).load(path, device="cpu")
            except Exception as error:  # the library raises whatever it stumbles over in a file of another kind
                raise ValueError(f"{path} is no model of {algorithm}: {error}") from None
            if fresh:
                self._model._setup_model()  # draws them anew from the model's seed
        for name, own, needed in (
            ("observations", aviary.observer.space(), self._model.observation_space),
            ("actions", widest_action_space(aviary.action), self._model.action_space),
        ):
            if own.shape != needed.shape or type(own) is not type(needed):
                kinds = [f"{type(space).__name__} of shape {space.shape}" for space in (needed, own)]
                raise ValueError(f"{path} was trained for {name} in a {kinds[0]}, and here they are in a {kinds[1]}")

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """What the model does with each drone's observation."""
        shape = self.aviary.alive.shape

        def rows(array: np.ndarray) -> np.ndarray:
            return array.reshape(-1, *array.shape[2:])

        if isinstance(observations, dict):
            seen: Any = {name: rows(array) for name, array in observations.items()}
        else:
            seen = rows(observations)
        actions, _ = self._model.predict(seen, deterministic=True)
        return np.asarray(actions, dtype=float).reshape(*shape, -1)
