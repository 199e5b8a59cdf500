"""Batches of worlds with automatic resets: arrays in, arrays out."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import MAX_WORLDS
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.infos import lazy_infos
from bulletuav.envs.reset_options import MASK, reset_options
from bulletuav.envs.snapshot import Snapshot
from bulletuav.envs.spaces import widest_action_space
from bulletuav.errors import as_int, find_choice, numbers_of
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation, copied

BatchResults = tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]
"""Observations, rewards, terminated, truncated and infos of a step"""


def as_autoreset_mode(mode: Any) -> AutoresetMode:
    """Convert a value to an `AutoresetMode`.

    Args:
        mode: The mode itself, its name or its value.

    Raises:
        ValueError: If there is no such mode; the message lists the choices.
    """
    if isinstance(mode, AutoresetMode):
        return mode
    modes = {}
    for one in AutoresetMode:
        modes[one.name] = one
        modes[one.value] = one
    return find_choice("autoreset_mode", mode, modes)


class BatchAviary(LabelledEnvironment):
    """W worlds of N drones: arrays in, arrays out.

    A world's episode is over when all its drones are done. The world is then reset by Gymnasium's
    `AutoresetMode`:

    - NEXT_STEP: the next step ignores the world's actions. It returns the first observations of a
      new episode, with zero rewards.
    - SAME_STEP: the last step itself returns the first observations of a new episode.
      info["final_obs"] (W, N, D), info["final_state"] and info["final_info"] have the results of
      the old one. The masks (W,) "_final_obs" and "_final_info" select the worlds for which they
      are defined.
    - DISABLED: the caller resets by `reset(options={"reset_mask": mask})`.

    Attributes:
        aviary: The batched core.
        num_envs: Number of worlds W.
        num_drones: Number of drones N of a world.
        autoreset_mode: When finished worlds are reset.
        observation_space: Observation space of one drone. If teams observe different blocks, drones
            with fewer numbers have zeros after them.
        action_space: Action space of one drone. In a mixed swarm drones with fewer rotors, or
            smaller actions, ignore the last numbers, which are clipped to 0.
    """

    def __init__(
        self,
        task: TaskSource,
        num_envs: int,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        *,
        first_world: int = 0,
        copy: bool = True,
        **options: Any,
    ) -> None:
        """Create the environment.

        Args:
            task: A name from `list_tasks()`, `module:Name`, or a task class.
            num_envs: Number of worlds W.
            autoreset_mode: When finished worlds are reset.
            first_world: Index of the first world among those of several processes.
            copy: If False, observations are not copied: they are arrays that the next step or reset
                overwrites, as in Gymnasium's `AsyncVectorEnv`.
            **options: See `parallel_env`.

        Raises:
            ValueError: If an option is invalid.
        """
        self.autoreset_mode = as_autoreset_mode(autoreset_mode)
        as_int("num_envs", num_envs, 1, MAX_WORLDS)
        self.aviary = Aviary(task, num_envs, first_world=first_world, copy=copy, **options)
        self._copies = copy
        self._observer = self.aviary.observer
        self.num_envs = self.aviary.num_worlds
        self.num_drones = self.aviary.num_drones
        self.observation_space: Box | Dict = self._observer.space()
        self.action_space: Space[Any] = widest_action_space(self.aviary.action)
        self._ended = np.zeros(self.num_envs, dtype=bool)

    @property
    def alive(self) -> np.ndarray:
        """Drones whose episode is running, (W, N) bool."""
        return self.aviary.alive.copy()

    @property
    def ended(self) -> np.ndarray:
        """Worlds whose episode ended in the last step, (W,) bool."""
        return self._ended.copy()

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: An int s gives world k the seed s + k. A sequence gives each world its own seed.
                None continues the random numbers of each world.
            options: Any of "reset_mask", (W,) bool, for some of the worlds only, and of "start",
                "goal", "velocity", "quaternion", "rates" and "charge", for all worlds or with a row
                for each; see `Aviary.reset`.

        Returns:
            Observations of all worlds, (W, N, D) or a dict, and infos (W, N) by name.

        Raises:
            ValueError: If seed or options are invalid, or the task's start is.
        """
        given = reset_options(options, MASK)
        mask = given.pop(MASK, None)
        observations = self.aviary.reset(mask, seed, **given)
        kept = False if mask is None else ~np.asarray(mask)
        self._ended = self._ended & kept
        return observations, self.aviary.first_info()

    @exclusive
    def step(self, actions: np.ndarray) -> BatchResults:
        """Simulate one decision of all worlds.

        Args:
            actions: (W, N, A), or (W, N) choices of a discrete action.

        Returns:
            Observations (W, N, D) or a dict, rewards (W, N), terminated (W, N), truncated (W, N)
            and infos (W, N) by name.

        Raises:
            ValueError: If actions are invalid; nothing is simulated then.
            RuntimeError: If called before the first reset or after `close`.
        """
        actions = numbers_of("actions are", actions)
        if self.aviary.action.choices is not None:
            actions = actions[..., None]
        observations, rewards, terminated, truncated, info = self.aviary.step(actions)
        infos: dict[str, Any] = info
        if not self.aviary.any_left and not self._ended.any():
            return observations, rewards, terminated, truncated, infos
        # Worlds in which drones flew, and finished ones that are reset instead
        flying = self.aviary.worlds.state.flying
        fresh = self._ended & ~flying & (self.autoreset_mode != AutoresetMode.DISABLED)
        ended = flying & ~np.any(self.aviary.alive, axis=1)
        # If a reset raises, as no start is found, the next step tries again
        self._ended = fresh | ended
        if fresh.any():
            observations = self.aviary.reset(fresh)
            infos = self._with_fresh(info, fresh, {})
        self._ended = ended
        if self._ended.any() and self.autoreset_mode == AutoresetMode.SAME_STEP:
            final = {
                # The reset overwrites observations that are not copied
                "final_obs": observations if self._copies else copied(observations),
                "final_state": self.aviary.state(),
                "final_info": info,
                "_final_obs": self.ended,
                "_final_info": self.ended,
            }
            observations = self.aviary.reset(self._ended)
            infos = self._with_fresh(info, self._ended, final)
        return observations, rewards, terminated, truncated, infos

    def _with_fresh(
        self, info: dict[str, np.ndarray], worlds: np.ndarray, final: dict[str, Any]
    ) -> dict[str, Any]:
        """Return infos with those of the new episodes in `worlds` (W,), and final entries."""
        first = self.aviary.first_info(worlds)
        return lazy_infos(
            lambda: {name: _merged(worlds, first[name], info[name]) for name in first} | final
        )

    @exclusive
    def set_condition(self, drones: Any = None, worlds: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `Aviary.set_condition`."""
        self.aviary.set_condition(drones, worlds, **changes)

    @exclusive
    def save_state(self, worlds: Any = None) -> Snapshot:
        """Save the complete state of worlds; see `Aviary.save_state`."""
        return self.aviary.save_state(worlds)

    @exclusive
    def load_state(self, snapshot: Snapshot, worlds: Any = None) -> Observation:
        """Restore a saved state; see `Aviary.load_state`."""
        observations = self.aviary.load_state(snapshot, worlds)
        chosen = slice(None) if worlds is None else worlds
        self._ended[chosen] = ~np.any(self.aviary.alive, axis=1)[chosen]
        return observations

    @exclusive
    def state_hash(self, worlds: Any = None) -> tuple[str, ...]:
        """Compute a hash of the state of each world; see `Aviary.state_hash`."""
        return self.aviary.state_hash(worlds)

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state.

        Returns:
            (W, K) float32; see `Aviary.state`.
        """
        return self.aviary.state()

    @exclusive
    def render(self, world: int = 0) -> np.ndarray | None:
        """Render one world.

        Args:
            world: Index of the world.

        Returns:
            (height, width, 3) uint8 with render_mode "rgb_array", else None.

        Raises:
            ValueError: If there is no such world.
        """
        return self.aviary.render(world)

    @exclusive
    def close(self) -> None:
        """Free the engine. Further calls do nothing."""
        self.aviary.close()


def _merged(worlds: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return arrays (W, ...) with those of `first` in `worlds` (W,)."""
    return np.where(worlds.reshape(-1, *[1] * (first.ndim - 1)), first, last)
