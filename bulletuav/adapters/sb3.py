"""Environment for stable-baselines3, for one policy that all drones share.

Every drone of a batch of worlds is a slot of a `VecEnv`, see `bulletuav.adapters.slots`:

    env = DroneVecEnv("crossing", num_worlds=16, dynamics="point_mass")
    model = PPO("MlpPolicy", env, rollout_buffer_class=LivingRollouts)

A drone whose episode has ended is absent until its whole world is reset, but stable-baselines3
needs a transition of every slot in every step. In transitions of slots without a drone the reward
is NaN, so that training on them cannot go unnoticed. `LivingRollouts` and `LivingReplay` drop these
transitions, which therefore affect no loss, advantage, statistic or sample. With one drone in each
world there are no such slots, and the buffers of stable-baselines3 itself can be used.
"""

import contextlib
import importlib
import random
from collections.abc import Iterator
from typing import Any

import numpy as np

from bulletuav.adapters.features import SymlogFeatures as Symlog
from bulletuav.adapters.sb3_buffers import LivingReplay, LivingRollouts
from bulletuav.adapters.slots import DroneSlots
from bulletuav.envs.reset_options import reset_options
from bulletuav.errors import missing_extra, shown
from bulletuav.tasks import TaskSource

try:
    import stable_baselines3
    import torch
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices
except ImportError:
    raise missing_extra("learning with stable-baselines3", "sb3") from None


__all__ = [
    "BaseCallback",
    "DroneVecEnv",
    "LivingReplay",
    "LivingRollouts",
    "Symlog",
    "algorithm",
    "preserve_random_state",
    "single_thread",
]


MASKS = "bulletuav.adapters.sb3_masks"
"""Module of MaskablePPO and its buffer; imported lazily, as it needs the extra `contrib`"""


def algorithm(name: str, masked: bool = False) -> Any:
    """Return the class of an algorithm.

    Args:
        name: Its name in lower case.
        masked: If True, MaskablePPO of sb3-contrib, which learns with masks of actions.

    Raises:
        ImportError: If the extra `contrib`, which MaskablePPO needs, is not installed.
    """
    if masked:
        return importlib.import_module(MASKS).MaskablePPO
    return getattr(stable_baselines3, name.upper())


@contextlib.contextmanager
def preserve_random_state() -> Iterator[None]:
    """Restore the global random states of Python, NumPy and PyTorch (CPU) at the end.

    Stable-baselines3 seeds them when it creates a model.
    """
    of_python = random.getstate()
    of_numpy = np.random.get_state()  # noqa: NPY002 - which stable-baselines3 uses
    of_torch = torch.get_rng_state()
    try:
        yield
    finally:
        random.setstate(of_python)
        np.random.set_state(of_numpy)  # noqa: NPY002
        torch.set_rng_state(of_torch)


def single_thread() -> None:
    """Limit PyTorch to one thread: fastest for small networks, and reproducible."""
    torch.set_num_threads(1)


class DroneVecEnv(DroneSlots, VecEnv):
    """`VecEnv` of the slots of W worlds of N drones, see `DroneSlots`."""

    def __init__(self, task: TaskSource, num_worlds: int = 16, *args: Any, **kwargs: Any) -> None:
        """Make the environment from the arguments of `DroneSlots`."""
        DroneSlots.__init__(self, task, num_worlds, *args, **kwargs)
        VecEnv.__init__(self, self.num_envs, self.observation_space, self.action_space)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Raise ValueError for options: slots cannot be reset individually.

        Raises:
            ValueError: If there is an option. Slots are drones, and a reset is one of whole worlds.
        """
        each = [options] if isinstance(options, dict) else options or []
        for given in each:
            reset_options(given)
            if given:
                raise ValueError(
                    f"options is {shown(given)}: resets of a DroneVecEnv take none, as its slots "
                    f"are drones; give start and goal when the environment is made"
                )

    def get_images(self) -> list[np.ndarray | None]:
        """Render an image of each world."""
        return [self.aviary.render(world) for world in range(self.num_worlds)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of this environment, repeated for each requested slot."""
        value = self._render_mode if attr_name == "render_mode" else getattr(self, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise NotImplementedError: attributes of slots cannot be set.

        Raises:
            NotImplementedError: The slots share one environment.
        """
        raise NotImplementedError(
            f"setting {attr_name} has no effect: slots share one environment, whose options are "
            f"given when it is made"
        )

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """Return the masks of slots for `action_masks`; slots have no other methods of their own.

        Raises:
            NotImplementedError: The slots share one environment.
        """
        if method_name == "action_masks":
            return list(self.action_masks()[list(self._get_indices(indices))])
        raise NotImplementedError(
            f"slots share one environment: call env.{method_name}, or env.aviary.{method_name}"
        )

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each requested slot: slots are never wrapped."""
        return [False] * len(list(self._get_indices(indices)))
