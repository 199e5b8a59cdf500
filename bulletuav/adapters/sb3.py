"""Stable-baselines3: every drone of a batch of worlds is a slot of a `VecEnv`, for one policy that all drones share.

    env = DroneVecEnv("crossing", num_worlds=16, dynamics="point_mass")
    model = PPO("MlpPolicy", env, rollout_buffer_class=LivingRollouts)

A drone whose episode ended is gone until its whole world starts anew, and SB3 wants a transition of every slot in every
step. In those of slots without a drone the reward is NaN, so that nothing learns from them unnoticed; `LivingRollouts` and
`LivingReplay` drop them: no loss, advantage, statistic or sample ever sees one. Where worlds hold a single drone there are
none, and SB3's own buffers do as well.
"""

import contextlib
import random
from collections.abc import Generator, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.adapters.features import Symlog
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.curriculum import Curriculum, common_observation
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import widest_action_space
from bulletuav.envs.step import Step
from bulletuav.errors import as_int, missing
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation, part

try:
    import stable_baselines3
    import torch
    from stable_baselines3.common.buffers import ReplayBuffer, RolloutBuffer
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.type_aliases import RolloutBufferSamples
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise missing("learning with stable-baselines3", "sb3") from None


__all__ = [
    "BaseCallback",
    "DroneVecEnv",
    "LivingReplay",
    "LivingRollouts",
    "Symlog",
    "algorithm",
    "own_random",
    "single_thread",
]


def algorithm(name: str) -> Any:
    """The class of an algorithm by its name in lower case."""
    return getattr(stable_baselines3, name.upper())


@contextlib.contextmanager
def own_random() -> Iterator[None]:
    """Leave the global random states of Python, NumPy and PyTorch, which SB3 seeds where it makes a model, as they were."""
    before = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002 - SB3's
    try:
        yield
    finally:
        random.setstate(before[0])
        np.random.set_state(before[1])  # noqa: NPY002
        torch.set_rng_state(before[2])


def single_thread() -> None:
    """Let PyTorch keep to one thread: small networks are fastest so, and the same everywhere."""
    torch.set_num_threads(1)


class DroneVecEnv(Environment, VecEnv):
    """W worlds of N drones as W * N slots: slot w * N + i is drone i of world w, with its own observation.

    Worlds start anew when all their drones are done. Infos are empty but where a drone's episode ends: then they hold
    "terminal_observation", "TimeLimit.truncated" (whether nothing but the horizon, or a change of stage, ended it),
    "is_success", and "episode", of that drone alone: return "r", decisions "l", seconds "t", "conflicts", "collision" and
    the return of each reward term ("reward/goal", ...).

    With `shared_reward` each drone is given the mean of the rewards of all drones of its world, those that are gone with 0;
    infos still tell its own.

    With several `stages` (options of each, easiest first, such as [{"num_drones": 2}, {"num_drones": 8}]) the success of
    the last episodes decides which one all worlds fly; see `Curriculum`. There are slots for the largest stage.

    Public state, to read: curriculum, num_worlds, num_drones, and decisions, how many drones have flown so far.
    """

    def __init__(
        self,
        task: TaskSource,
        num_worlds: int = 16,
        stages: Sequence[Mapping[str, Any]] = ({},),
        curriculum: Curriculum | None = None,
        shared_reward: bool = False,
        **options: Any,
    ):
        """Options as of `Aviary`. Raises ValueError for what cannot be, also stages whose observations differ in shape."""
        self._shared_reward = shared_reward
        self._task, self._stage_options = task, [{**options, **stage} for stage in stages]
        self.curriculum = curriculum or Curriculum(len(self._stage_options))
        if self.curriculum.count != len(self._stage_options):
            raise ValueError(
                f"the curriculum has {self.curriculum.count} stages, and {len(self._stage_options)} are given"
            )
        plans = [EnvSpec(task, num_worlds, stage) for stage in self._stage_options]
        widest = max(plans, key=lambda plan: plan.options.num_drones)
        self.num_worlds, self.num_drones = num_worlds, widest.options.num_drones
        self._render_mode = widest.options.render_mode
        self._aviaries: dict[int, Aviary] = {}
        self._seed: int | None = None
        self._unseeded: set[int] = set()
        self._stage = self.curriculum.stage
        self.decisions = 0
        self._actions: np.ndarray = np.empty(0)
        super().__init__(
            num_worlds * self.num_drones,
            common_observation(plans),
            widest_action_space(widest.action),
        )

    @property
    def aviary(self) -> Aviary:
        """The worlds of the stage that is flown."""
        if self._stage not in self._aviaries:
            self._aviaries[self._stage] = Aviary(
                self._task, self.num_worlds, **self._stage_options[self._stage]
            )
        return self._aviaries[self._stage]

    def seed(self, seed: int | None = None) -> list[int | None]:
        """From the next `reset` on world k has the seed s + k, at every stage; None goes on with its random numbers."""
        self._seed = None if seed is None else as_int("seed", seed, 0)
        self._unseeded = set(range(len(self._stage_options)))
        return [
            None if seed is None else seed + slot // self.num_drones
            for slot in range(self.num_envs)
        ]

    @exclusive
    def reset(self) -> Any:
        """Start new episodes in all worlds, at the stage that the curriculum says; observations (slots, D), or a dict."""
        return self._rows(self._start(np.ones(self.num_worlds, dtype=bool)))

    def _start(self, worlds: np.ndarray) -> Observation:
        """Observations after new episodes have begun in the worlds of the mask (W,), or in all where the stage changes."""
        if self.curriculum.stage != self._stage or not self._aviaries:
            self._stage, worlds = self.curriculum.stage, np.ones(self.num_worlds, dtype=bool)
        aviary = self.aviary
        seed = self._seed if self._stage in self._unseeded else None
        self._unseeded.discard(self._stage)
        observations = aviary.reset(worlds, seed)
        if worlds.all():
            shape = aviary.alive.shape
            self._returns: dict[str, np.ndarray] = {}
            self._success, self._collision = np.zeros((2, *shape), dtype=bool)
            self._conflicts, self._decisions = np.zeros((2, *shape))
        for total in (
            *self._returns.values(),
            self._success,
            self._collision,
            self._conflicts,
            self._decisions,
        ):
            total[worlds] = 0
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions (slots, A), or (slots,) choices; those of slots without a drone are ignored."""
        self._actions = np.asarray(actions).reshape(self.num_worlds, self.num_drones, -1)

    @exclusive
    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Fly one decision: observations, rewards (slots,), dones (slots,) and infos."""
        aviary = self.aviary
        flown = aviary.alive.copy()
        step = aviary.step(self._actions[:, : aviary.num_drones])
        self._add(step, flown)
        over = np.any(flown, axis=1) & ~np.any(aviary.alive, axis=1)
        for world in np.flatnonzero(over):
            if (
                self.curriculum.stage == self._stage
            ):  # else this was an episode of a stage that is left by now
                self.curriculum.record(float(self._success[world].mean()))
        change = self.curriculum.stage != self._stage
        ended = flown & (change | ~aviary.alive)
        infos = self._infos(step, ended)
        dones = self._wide(ended | over[:, None] | change, True)
        earned = np.where(flown, step.rewards, 0.0)
        if self._shared_reward:
            earned = np.broadcast_to(earned.mean(axis=1, keepdims=True), earned.shape)
        rewards = self._wide(np.where(flown, earned, np.nan), np.nan)
        observations = self._start(over) if over.any() else step.observations
        return self._rows(observations), rewards.astype(np.float32), dones, infos

    def _add(self, step: Step, flown: np.ndarray) -> None:
        terms = {"": step.rewards} | {
            name: term for name, term in step.info.items() if name.startswith("reward/")
        }
        for name, term in terms.items():
            self._returns[name] = self._returns.get(name, 0.0) + np.where(flown, term, 0.0)
        self._success = np.where(flown, step.info["success"], self._success)
        self._collision |= flown & step.info["collision"]
        self._conflicts += flown * step.info["conflicts"]
        self._decisions += flown
        self.decisions += int(flown.sum())

    def _infos(self, step: Step, ended: np.ndarray) -> list[dict[str, Any]]:
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if not ended.any():
            return infos
        hz = self.aviary.options.decision_hz
        for w, i in np.argwhere(ended):
            episode = {
                "r": float(self._returns[""][w, i]),
                "l": int(self._decisions[w, i]),
                "t": float(self._decisions[w, i] / hz),
                "conflicts": float(self._conflicts[w, i]),
                "collision": float(self._collision[w, i]),
            }
            infos[w * self.num_drones + i] = {
                "terminal_observation": part(step.observations, (w, i)),
                "TimeLimit.truncated": not step.terminated[w, i],
                "is_success": bool(self._success[w, i]),
                "episode": episode
                | {name: float(term[w, i]) for name, term in self._returns.items() if name},
            }
        return infos

    def _wide(self, array: np.ndarray, fill: float) -> np.ndarray:
        """(slots, ...) from (W, N, ...) of a stage that may have fewer drones than there are slots for."""
        missing = self.num_drones - array.shape[1]
        if missing:
            array = np.concatenate(
                [array, np.full((len(array), missing, *array.shape[2:]), fill, array.dtype)], axis=1
            )
        return array.reshape(-1, *array.shape[2:])

    def _rows(self, observations: Observation) -> Any:
        """Observations by slot, of those without a drone zero."""
        alive = self._wide(self.aviary.alive, False)

        def rows(array: np.ndarray) -> np.ndarray:
            wide = self._wide(array, 0)
            return np.where(alive.reshape(-1, *[1] * (wide.ndim - 1)), wide, 0).astype(
                array.dtype, copy=False
            )

        if isinstance(observations, dict):
            return {name: rows(array) for name, array in observations.items()}
        return rows(observations)

    def get_images(self) -> list[np.ndarray | None]:
        """A picture of each world."""
        return [self.aviary.render(world) for world in range(self.num_worlds)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Of this environment, once for each slot asked for."""
        value = self._render_mode if attr_name == "render_mode" else getattr(self, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the slots share one environment. Raises NotImplementedError."""
        raise NotImplementedError(
            "slots share one environment, so that none has attributes of its own"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused: the slots share one environment. Raises NotImplementedError."""
        raise NotImplementedError(
            f"slots share one environment: call env.{method_name}, or env.aviary.{method_name}"
        )

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """By nothing."""
        return [False] * len(list(self._get_indices(indices)))

    @exclusive
    def close(self) -> None:
        """Free the engines; a second call does nothing."""
        for aviary in self._aviaries.values():
            aviary.close()


class LivingRollouts(RolloutBuffer):
    """Of on-policy algorithms: gives minibatches of transitions that drones flew.

    Minibatches, at most `batch_size` large, are of one size but for one transition; their order follows PyTorch's seed.
    """

    def compute_returns_and_advantage(self, last_values: torch.Tensor, dones: np.ndarray) -> None:
        """As SB3; an episode ends before the transitions of a slot without a drone, so they reach no advantage of others."""
        self.flown = np.flatnonzero(~np.isnan(self.swap_and_flatten(self.rewards)))
        np.nan_to_num(self.rewards, copy=False)
        super().compute_returns_and_advantage(last_values, dones)

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """Minibatches in a random order, of all at once for None."""
        if not self.generator_ready:
            for name in ("observations", "actions", "values", "log_probs", "advantages", "returns"):
                setattr(self, name, self.swap_and_flatten(getattr(self, name))[self.flown])
            self.generator_ready = True
        count = len(self.flown)
        order = torch.randperm(count).numpy()
        for indices in np.array_split(order, -(-count // (batch_size or count))):
            yield self._get_samples(indices)


class LivingReplay(ReplayBuffer):
    """Of off-policy algorithms: keeps transitions that drones flew, one after the other, whatever slot they come from."""

    def __init__(
        self,
        buffer_size: int,
        observation_space: Any,
        action_space: Any,
        device: Any = "auto",
        **kwargs: Any,
    ):
        if kwargs.get("optimize_memory_usage"):
            raise ValueError(
                "optimize_memory_usage is True: transitions of living drones alone do not follow each other"
            )
        super().__init__(
            buffer_size, observation_space, action_space, device, **{**kwargs, "n_envs": 1}
        )

    def add(
        self,
        obs: Any,
        next_obs: Any,
        action: Any,
        reward: Any,
        done: Any,
        infos: list[dict[str, Any]],
    ) -> None:
        """Keep those with a reward."""
        flown = np.flatnonzero(~np.isnan(reward))
        action = np.asarray(action).reshape(len(reward), self.action_dim)
        places = (self.pos + np.arange(len(flown))) % self.buffer_size
        self.observations[places, 0], self.next_observations[places, 0] = (
            obs[flown],
            next_obs[flown],
        )
        self.actions[places, 0], self.rewards[places, 0], self.dones[places, 0] = (
            action[flown],
            reward[flown],
            done[flown],
        )
        self.timeouts[places, 0] = [infos[slot].get("TimeLimit.truncated", False) for slot in flown]
        self.full |= self.pos + len(flown) >= self.buffer_size
        self.pos = (self.pos + len(flown)) % self.buffer_size
