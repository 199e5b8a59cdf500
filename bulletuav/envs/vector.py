"""The batched face: W worlds of N drones that reset themselves."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import MOST_WORLDS
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import widest_action_space
from bulletuav.errors import as_int, choose, shown
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation


def autoreset(mode: Any) -> AutoresetMode:
    """An `AutoresetMode`, by itself, its name or its value. Raises ValueError, with the choices, for anything else."""
    if isinstance(mode, AutoresetMode):
        return mode
    names = {name: one for one in AutoresetMode for name in (one.name, one.value)}
    return choose("autoreset_mode", mode, names)


def reset_mask(options: Any) -> Any:
    """What a reset's options tell of worlds. Raises ValueError unless they are a dict, None for none."""
    if options is not None and not isinstance(options, Mapping):
        raise ValueError(
            f"options is {shown(options)}: a dict such as {{'reset_mask': mask}}, or None, is needed"
        )
    return (options or {}).get("reset_mask")


class BatchAviary(Environment):
    """W worlds of N drones: arrays in, arrays out. A world's episode is over when all its drones are done.

    What then happens follows Gymnasium's `AutoresetMode`: NEXT_STEP, the step after the last ignores the world's actions and
    returns the first observations of a new episode with zero rewards; SAME_STEP, the last step itself returns them, and
    info["final_obs"] (W, N, D), "final_state" and "final_info" hold the end, under the masks "_final_obs" and "_final_info"
    (W,); DISABLED, the caller resets by `reset(options={"reset_mask": mask})`.

    observation_space, action_space are those of one drone; in a mixed swarm those with fewer rotors ignore the last numbers.
    """

    def __init__(
        self,
        task: TaskSource,
        num_envs: int,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        *,
        first_world: int = 0,
        **options: Any,
    ):
        self.autoreset_mode = autoreset(autoreset_mode)
        as_int("num_envs", num_envs, 1, MOST_WORLDS)
        self.aviary = Aviary(task, num_envs, first_world=first_world, **options)
        self.num_envs, self.num_drones = self.aviary.num_worlds, self.aviary.num_drones
        self.observation_space: Box | Dict = self.aviary.observer.space()
        self.action_space: Space = widest_action_space(self.aviary.action)
        self._ended = np.zeros(self.num_envs, dtype=bool)

    @property
    def alive(self) -> np.ndarray:
        """(W, N) bool: drones whose episode goes on."""
        return self.aviary.alive.copy()

    @property
    def ended(self) -> np.ndarray:
        """(W,) worlds whose episode ended in the last step."""
        return self._ended.copy()

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes in all worlds, or in those of options["reset_mask"] (W,).

        `seed`: an int s gives world k the seed s + k; a sequence gives one to each; None goes on with each world's own.
        """
        mask = reset_mask(options)
        observations = self.aviary.reset(mask, seed)
        self._ended = self._ended & (False if mask is None else ~np.asarray(mask))
        return observations, dict(self.aviary.first_info())

    @exclusive
    def step(
        self, actions: np.ndarray
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One decision of all worlds with actions (W, N, A), or (W, N) choices of a discrete action.

        Returns observations, rewards (W, N), terminated (W, N), truncated (W, N) and infos (W, N) by name.
        """
        actions = np.asarray(actions)
        if self.aviary.action.choices is not None:
            actions = actions[..., None]
        fresh = self._ended & (self.autoreset_mode == AutoresetMode.NEXT_STEP)
        flying = self.aviary.alive.any(axis=1)
        observations, rewards, terminated, truncated, info = self.aviary.step(actions)
        infos: dict[str, Any] = dict(info)
        self._ended = flying & ~np.any(self.aviary.alive, axis=1)
        if fresh.any():
            observations = self.aviary.reset(fresh)
            infos |= self._with_fresh(infos, fresh)
        if self._ended.any() and self.autoreset_mode == AutoresetMode.SAME_STEP:
            infos |= {
                "final_obs": observations,
                "final_state": self.aviary.state(),
                "final_info": info,
            }
            infos |= {"_final_obs": self.ended, "_final_info": self.ended}
            observations = self.aviary.reset(self._ended)
            infos |= self._with_fresh(info, self._ended)
        return observations, rewards, terminated, truncated, infos

    def _with_fresh(self, info: dict[str, np.ndarray], worlds: np.ndarray) -> dict[str, np.ndarray]:
        """Infos in which those of `worlds` (W,) are of their new episodes."""
        first = self.aviary.first_info()
        return {name: np.where(worlds[:, None], first[name], info[name]) for name in first}

    def state(self) -> np.ndarray:
        """(W, 17 N) float32 global state; see `Aviary.state`."""
        return self.aviary.state()

    def render(self, world: int = 0) -> np.ndarray | None:
        """A picture (height, width, 3) uint8 of one world with render_mode "rgb_array"."""
        return self.aviary.render(world)

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self.aviary.close()
