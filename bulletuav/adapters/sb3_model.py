"""Policy from a model file of stable-baselines3."""

from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters import sb3
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.spaces import widest_action_space
from bulletuav.policies.trained import TRUST, SharedPolicy


class Sb3Model(SharedPolicy):
    """Policy from a zip file that stable-baselines3 saved, such as model.zip.

    PyTorch is limited to one thread, so that actions are reproducible.
    """

    def __init__(
        self, aviary: Aviary, algorithm: str, path: str | Path, trust: bool = False
    ) -> None:
        """Load a model.

        Args:
            aviary: The worlds that the policy controls.
            algorithm: Name of the algorithm in lower case, such as "ppo".
            path: The zip file.
            trust: If True, the file is loaded although such files can run code.

        Raises:
            ValueError: If the file is not trusted, is not a model of the algorithm, or was trained
                for other spaces than those of a drone in these worlds.
        """
        super().__init__(aviary)
        if not trust:
            raise ValueError(f"{path} is not read: {TRUST}")
        sb3.single_thread()
        with sb3.preserve_random_state():
            # Files of other types raise arbitrary errors
            try:
                self._model: Any = sb3.algorithm(algorithm).load(path, device="cpu")
            except Exception as error:
                raise ValueError(f"{path} is not a model of {algorithm}: {error}") from None
        self._check_spaces(path)

    def _check_spaces(self, path: str | Path) -> None:
        """Raise ValueError unless the model was trained for this aviary's spaces."""
        for name, own, needed in (
            ("observations", self.aviary.observer.space(), self._model.observation_space),
            ("actions", widest_action_space(self.aviary.action), self._model.action_space),
        ):
            if own.shape != needed.shape or type(own) is not type(needed):
                raise ValueError(
                    f"{path} was trained for {name} in a {_describe_space(needed)}, "
                    f"and here they are in a {_describe_space(own)}"
                )

    def _choose(self, rows: Any) -> np.ndarray:
        """Return the deterministic actions of the model."""
        return np.asarray(self._model.predict(rows, deterministic=True)[0])


def _describe_space(space: Any) -> str:
    """Describe a space in a message."""
    return f"{type(space).__name__} of shape {space.shape}"
