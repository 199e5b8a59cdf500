"""A policy that flies a model that stable-baselines3 saved."""

from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters import sb3
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.spaces import widest_action_space
from bulletuav.policies.trained import TRUST, SharedPolicy


class Sb3Model(SharedPolicy):
    """A policy from a zip file of stable-baselines3, such as model.zip.

    PyTorch keeps to one thread, so that its actions are the same everywhere.
    """

    def __init__(
        self, aviary: Aviary, algorithm: str, path: str | Path, trust: bool = False
    ) -> None:
        """Load a model.

        Args:
            aviary: The worlds that it flies.
            algorithm: Name of the algorithm in lower case, such as "ppo".
            path: The zip file.
            trust: Whether the file may run code, which such files can hold.

        Raises:
            ValueError: It is not trusted, is no such model, or its spaces are not those of one
                drone.
        """
        super().__init__(aviary)
        if not trust:
            raise ValueError(f"{path} is not read: {TRUST}")
        sb3.single_thread()
        with sb3.own_random():
            # The library raises whatever it stumbles over in a file of another kind.
            try:
                self._model: Any = sb3.algorithm(algorithm).load(path, device="cpu")
            except Exception as error:
                raise ValueError(f"{path} is no model of {algorithm}: {error}") from None
        self._check_spaces(path)

    def _check_spaces(self, path: str | Path) -> None:
        """Raise ValueError unless the model was trained for this aviary's spaces."""
        for name, own, needed in (
            ("observations", self.aviary.observer.space(), self._model.observation_space),
            ("actions", widest_action_space(self.aviary.action), self._model.action_space),
        ):
            if own.shape != needed.shape or type(own) is not type(needed):
                raise ValueError(
                    f"{path} was trained for {name} in a {_told(needed)}, "
                    f"and here they are in a {_told(own)}"
                )

    def _choose(self, rows: Any) -> np.ndarray:
        """Choose the deterministic actions of the model."""
        return np.asarray(self._model.predict(rows, deterministic=True)[0])


def _told(space: Any) -> str:
    """Describe a space in a message."""
    return f"{type(space).__name__} of shape {space.shape}"
