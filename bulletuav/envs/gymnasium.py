"""Gymnasium environments: one agent commands all drones of a world, alone or in batches.

An action concatenates the numbers of all drones, and the reward is their mean reward, without that
of absent drones. The episode ends when all drones are done, by truncation if time ended it for one
of them.

The agent observes the global state of all drones: a flat vector, or in the format "dict" an entry
(N, numbers) for each of its blocks. With one drone the environment has that drone's own
observation, action and reward.
"""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from bulletuav.envs.agents import take_one
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.infos import lazy_infos
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.reset_options import check_setting, reset_options
from bulletuav.envs.snapshot import Snapshot
from bulletuav.envs.spaces import joint_action_space, joint_numbers
from bulletuav.envs.vector import BatchAviary, BatchResults
from bulletuav.errors import as_int, numbers_of
from bulletuav.tasks import TaskSource, find_task
from bulletuav.tasks.observations.observer import Observation, part

METADATA: dict[str, Any] = {"render_modes": list(RENDER_MODES)}


def environment_id(task: str) -> str:
    """Return the id of a task for Gymnasium and PettingZoo: `bulletuav/Hover-v2` for hover."""
    return f"bulletuav/{task.title().replace('_', '')}-v{find_task(task).version}"


class CentralObserver:
    """Observations of the agent that commands all drones of a world.

    Attributes:
        is_alone: Whether there is one drone, of which the agent has the own observation.
        labels: Labels of the numbers of one drone.
    """

    def __init__(self, aviary: Aviary) -> None:
        """Select the observation: that of the only drone, or the global state."""
        self.is_alone = aviary.num_drones == 1
        self._aviary = aviary
        self._drone = aviary.observer if self.is_alone else aviary.global_state.drones
        self.labels = self._drone.labels
        self._gives_dict = aviary.options.observation_format == "dict"

    def space(self) -> Box | Dict:
        """Return the observation space of the agent of one world."""
        if self.is_alone:
            return self._drone.space()
        low, high = self._aviary.global_state.low, self._aviary.global_state.high
        if not self._gives_dict:
            return Box(low, high, dtype=np.float32)
        lows, highs = self.split(low), self.split(high)
        spaces: dict[str, Space[Any]] = {
            name: Box(lows[name], highs[name], dtype=np.float32) for name in lows
        }
        return Dict(spaces)

    def observe(self, observations: Observation, state: np.ndarray | None = None) -> Observation:
        """Return the observation of the agent of each world.

        Args:
            observations: (W, N, ...) observations of the drones.
            state: (W, K) global state; None for the present one.

        Returns:
            Arrays (W, ...).
        """
        if self.is_alone:
            own: Observation = part(observations, (slice(None), 0))
            return own
        state = self._aviary.state() if state is None else state
        return self.split(state) if self._gives_dict else state

    def split(self, observation: Observation) -> dict[str, np.ndarray]:
        """Split observations by the names of their blocks; see `LabelledEnvironment.split`.

        All drones have the same blocks. With one drone there is no axis of drones.
        """
        if self.is_alone or isinstance(observation, dict):
            return self._drone.split(observation)
        return self._aviary.global_state.split(observation)


class CentralAviary(LabelledEnvironment, gymnasium.Env[Any, Any]):
    """One world as a `gymnasium.Env`.

    Attributes:
        aviary: The batched core with W = 1.
        observation_space: Space of the drone with one drone, else of the global state.
        action_space: Concatenated numbers of all drones, or one choice of each.
    """

    metadata = METADATA
    _observer: CentralObserver

    def __init__(self, task: TaskSource, **options: Any) -> None:
        """Create the environment; see `bulletuav.parallel_env`."""
        self.aviary = Aviary(task, 1, **options)
        self._observer = CentralObserver(self.aviary)
        self.metadata = {**METADATA, "render_fps": self.aviary.options.decision_hz}
        self.render_mode = self.aviary.options.render_mode
        self.observation_space = self._observer.space()
        action = self.aviary.action
        self.action_space = joint_action_space(action)
        # Whether actions can be copied without conversion
        self._takes = self._observer.is_alone and action.choices is None
        self._config = self.aviary.task.config

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; raise AttributeError for one without effect."""
        if type(self) is CentralAviary and "_config" in vars(self):
            check_setting(self, name, self._config)
        super().__setattr__(name, value)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute for a wrapper; see `gymnasium.Env.set_wrapper_attr`."""
        check_setting(self, name, self._config)
        return super().set_wrapper_attr(name, value, force=force)

    @exclusive
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers; None continues them.
            options: Any of "start", "goal", "velocity", "quaternion", "rates" and "charge", which
                are set instead of drawn; see `Aviary.reset`.

        Returns:
            The observation, and infos (N,) by name.
        """
        # Gymnasium seeds its own generator, which nothing here uses
        if seed is not None:
            seed = as_int("seed", seed, 0)
        super().reset(seed=seed)
        observations = self.aviary.reset(seeds=seed, **reset_options(options))
        observation = part(self._observer.observe(observations), 0)
        return observation, _of_world(self.aviary.first_info())

    @exclusive
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Simulate one decision of all drones.

        Args:
            action: An element of `action_space`.

        Returns:
            The observation, reward, terminated, truncated, and infos (N,) by name.

        Raises:
            ValueError: If the action is invalid; nothing is simulated then.
            RuntimeError: If called before the first reset or after `close`.
        """
        aviary = self.aviary
        aviary.require_started()
        if not self._takes or not take_one(action, aviary.given):  # checked by the program
            aviary.given[:] = joint_numbers(aviary.action, numbers_of("action is", action)[None], 1)
        aviary.decide()
        # An episode that time ended for one of the drones is truncated
        is_over = True not in aviary.alive.tolist()[0]
        truncated = is_over and True in aviary.truncated.tolist()[0]
        seen = aviary.observations()
        if self._observer.is_alone:
            observation = part(seen, (0, 0))
            mean = aviary.rewards.item()
        else:
            observation = part(self._observer.observe(seen), 0)
            mean = float(aviary.mean_of_members(aviary.rewards)[0])
        infos = lazy_infos(aviary.info_table(0))
        return observation, mean, is_over and not truncated, truncated, infos

    @exclusive
    def set_condition(self, drones: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `Aviary.set_condition`."""
        self.aviary.set_condition(drones, **changes)

    @exclusive
    def save_state(self) -> Snapshot:
        """Save the complete state; see `Aviary.save_state`."""
        return self.aviary.save_state()

    @exclusive
    def load_state(self, snapshot: Snapshot) -> Any:
        """Restore a saved state, and return the observation; see `Aviary.load_state`."""
        return part(self._observer.observe(self.aviary.load_state(snapshot)), 0)

    @exclusive
    def state_hash(self) -> str:
        """Compute a hash of the state; see `Aviary.state_hash`."""
        return self.aviary.state_hash()[0]

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render the world.

        Returns:
            (height, width, 3) uint8 with render_mode "rgb_array", else None.
        """
        return self.aviary.render()

    @exclusive
    def close(self) -> None:
        """Free the engine. Further calls do nothing."""
        self.aviary.close()


def _of_world(info: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the infos of the only world."""
    return lazy_infos(lambda: {name: value[0] for name, value in info.items()})


class CentralVectorAviary(LabelledEnvironment, gymnasium.vector.VectorEnv[Any, Any, Any]):
    """W worlds as a `gymnasium.vector.VectorEnv`.

    Attributes:
        aviary: The batched core.
        num_envs: Number of worlds W.
        single_observation_space: Observation space of one world, as in `CentralAviary`.
        single_action_space: Action space of one world, as in `CentralAviary`.
        observation_space: Observation space of all worlds.
        action_space: Action space of all worlds.
    """

    metadata = METADATA
    _observer: CentralObserver

    def __init__(
        self,
        task: TaskSource,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        """Create the environment.

        Args:
            task: A name from `list_tasks()`, `module:Name`, or a task class.
            num_envs: Number of worlds W.
            autoreset_mode: When finished worlds are reset; see `BatchAviary`.
            **options: See `bulletuav.parallel_env`.

        Raises:
            ValueError: If an option is invalid.
        """
        # The batch simulates and resets; this class joins its drones to one agent
        self._batch = BatchAviary(task, num_envs, autoreset_mode, **options)
        self.aviary = self._batch.aviary
        self._observer = CentralObserver(self.aviary)
        self.num_envs = self.aviary.num_worlds
        self.render_mode = self.aviary.options.render_mode
        self.metadata = {
            **METADATA,
            "render_fps": self.aviary.options.decision_hz,
            "autoreset_mode": self._batch.autoreset_mode,
        }
        self.single_observation_space = self._observer.space()
        self.single_action_space = joint_action_space(self.aviary.action)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes in all worlds, or in those of options["reset_mask"] (W,).

        Args:
            seed: See `BatchAviary.reset`.
            options: See `BatchAviary.reset`.

        Returns:
            Observations (W, ...), and infos (W, N) by name.
        """
        observations, infos = self._batch.reset(seed=seed, options=options)
        return self._observer.observe(observations), infos

    @exclusive
    def step(self, actions: Any) -> BatchResults:
        """Simulate one decision of all worlds.

        Args:
            actions: An element of `action_space`.

        Returns:
            Observations (W, ...), rewards (W,), terminated (W,), truncated (W,), and infos (W, N)
            by name.

        Raises:
            ValueError: If actions are invalid; nothing is simulated then.
            RuntimeError: If called before the first reset or after `close`.
        """
        batch = joint_numbers(self.aviary.action, actions, self.num_envs)
        if self.aviary.action.choices is not None:
            batch = batch[..., 0]
        # A reset within the step draws other members
        members = self.aviary.members.copy() if self.aviary.options.has_absent else None
        observations, rewards, _, cut, infos = self._batch.step(batch)
        truncated, terminated = self._batch.ended, self._batch.ended
        if truncated.any():
            # An episode that time ended for one of the drones is truncated
            truncated &= cut.any(axis=1)
            terminated &= ~truncated
            infos = lazy_infos(partial(self._joined_infos, infos))
        mean_rewards = self.aviary.mean_of_members(rewards, members)
        return self._observer.observe(observations), mean_rewards, terminated, truncated, infos

    def _joined_infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        """Return infos with the final observation of the agent instead of those of the drones."""
        if "final_obs" not in infos:
            return infos
        final = self._observer.observe(infos["final_obs"], infos["final_state"])
        return infos | {"final_obs": final}

    @exclusive
    def set_condition(self, drones: Any = None, worlds: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `Aviary.set_condition`."""
        self._batch.set_condition(drones, worlds, **changes)

    @exclusive
    def save_state(self, worlds: Any = None) -> Snapshot:
        """Save the complete state of worlds; see `Aviary.save_state`."""
        return self._batch.save_state(worlds)

    @exclusive
    def load_state(self, snapshot: Snapshot, worlds: Any = None) -> Any:
        """Restore a saved state, and return observations; see `Aviary.load_state`."""
        return self._observer.observe(self._batch.load_state(snapshot, worlds))

    @exclusive
    def state_hash(self, worlds: Any = None) -> tuple[str, ...]:
        """Compute a hash of the state of each world; see `Aviary.state_hash`."""
        return self.aviary.state_hash(worlds)

    @exclusive
    def render(self) -> tuple[np.ndarray | None, ...]:  # type: ignore[override]
        """Render all worlds.

        Returns:
            (height, width, 3) uint8 of each with render_mode "rgb_array", else None for each.
        """
        return tuple(self.aviary.render(world) for world in range(self.num_envs))

    @exclusive
    def close(self, **kwargs: Any) -> None:
        """Free the engine. Further calls do nothing."""
        self.aviary.close()
