"""The Gymnasium faces: one agent commands all drones of a world, alone or batched.

Observation: the flat global state; action: the drones' numbers one after the other; reward: the mean over all drones. With
one drone it is that drone's own environment: its observation, its action, its reward. The episode ends when all drones are
done, by truncation when time ended it for one of them.
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import joint_action_space, joint_numbers
from bulletuav.envs.vector import BatchAviary
from bulletuav.errors import as_int
from bulletuav.tasks import TaskSource, list_tasks
from bulletuav.tasks.observations.observer import Observation, part

METADATA: dict[str, Any] = {"render_modes": ["rgb_array", "human"]}


def environment_id(task: str) -> str:
    """The Gymnasium id of a task: `bulletuav/Hover-v0` for hover."""
    return f"bulletuav/{task.title().replace('_', '')}-v0"


def register_environments() -> None:
    """Make every task known to `gymnasium.make` and `gymnasium.make_vec`."""
    for task in list_tasks():
        gymnasium.register(
            environment_id(task),
            entry_point=f"{__name__}:CentralAviary",
            vector_entry_point=f"{__name__}:CentralVectorAviary",
            kwargs={"task": task},
        )


def _observation_space(aviary: Aviary) -> gymnasium.Space:
    if aviary.num_drones == 1:
        return aviary.observer.space()
    observer, drones = aviary.state_observer, aviary.num_drones
    return gymnasium.spaces.Box(
        np.tile(observer.low, drones), np.tile(observer.high, drones), dtype=np.float32
    )


def _central(aviary: Aviary, observations: Observation) -> Observation:
    """(W, ...) what the one agent of each world sees."""
    return part(observations, (slice(None), 0)) if aviary.num_drones == 1 else aviary.state()


class CentralAviary(Environment, gymnasium.Env):
    """One world as a `gymnasium.Env`."""

    metadata = METADATA

    def __init__(self, task: TaskSource, **options: Any):
        self.aviary = Aviary(task, 1, **options)
        self.metadata = {**METADATA, "render_fps": self.aviary.options.decision_hz}
        self.render_mode = self.aviary.options.render_mode
        self.observation_space = _observation_space(self.aviary)
        self.action_space = joint_action_space(self.aviary.action)

    @exclusive
    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Any, dict]:
        """Start a new episode; `options` is Gymnasium's and not read."""
        super().reset(seed=None if seed is None else as_int("seed", seed, 0))
        observations = self.aviary.reset(seeds=seed)
        return part(_central(self.aviary, observations), 0), _of_world(self.aviary.first_info())

    @exclusive
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        """One decision of all drones; infos are (N,) arrays."""
        step = self.aviary.step(joint_numbers(self.aviary.action, np.asarray(action)[None], 1))
        over = not self.aviary.alive.any()
        truncated = over and bool(step.truncated.any())
        observation = part(_central(self.aviary, step.observations), 0)
        return (
            observation,
            float(step.rewards.mean()),
            over and not truncated,
            truncated,
            _of_world(step.info),
        )

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3) uint8 with render_mode "rgb_array"."""
        return self.aviary.render()

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self.aviary.close()


def _of_world(info: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: value[0] for name, value in info.items()}


class CentralVectorAviary(Environment, gymnasium.vector.VectorEnv):
    """W worlds as a `gymnasium.vector.VectorEnv`; infos are (W, N) arrays."""

    metadata = METADATA

    def __init__(
        self,
        task: TaskSource,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ):
        self._batch = BatchAviary(task, num_envs, autoreset_mode, **options)
        aviary = self.aviary = self._batch.aviary
        self.num_envs = aviary.num_worlds
        self.render_mode = aviary.options.render_mode
        self.metadata = {
            **METADATA,
            "render_fps": aviary.options.decision_hz,
            "autoreset_mode": self._batch.autoreset_mode,
        }
        self.single_observation_space = _observation_space(aviary)
        self.single_action_space = joint_action_space(aviary.action)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    @exclusive
    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes in all worlds, or in those of options["reset_mask"] (W,); seeds as in `BatchAviary.reset`."""
        observations, infos = self._batch.reset(seed=seed, options=options)
        return _central(self.aviary, observations), infos

    @exclusive
    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One decision of all worlds; rewards, terminated and truncated are (W,)."""
        batch = joint_numbers(self.aviary.action, actions, self.num_envs)
        if self.aviary.action.choices is not None:
            batch = batch[..., 0]
        observations, rewards, _, truncated, infos = self._batch.step(batch)
        cut = self._batch.ended & truncated.any(axis=1)
        if "final_obs" in infos:
            alone = self.aviary.num_drones == 1
            infos["final_obs"] = (
                part(infos["final_obs"], (slice(None), 0)) if alone else infos["final_state"]
            )
        return (
            _central(self.aviary, observations),
            rewards.mean(axis=1),
            self._batch.ended & ~cut,
            cut,
            infos,
        )

    def render(self) -> tuple[np.ndarray | None, ...]:  # type: ignore[override]
        """Pictures of all worlds with render_mode "rgb_array"."""
        return tuple(self.aviary.render(world) for world in range(self.num_envs))

    @exclusive
    def close(self, **kwargs: Any) -> None:
        """Free the engine; a second call does nothing."""
        self.aviary.close()
