"""Environment with the interface of PyMARL, EPyMARL and pymarlzooplus.

These programs are not imported: register the environment in their registry, then run them.

    from envs import REGISTRY  # of EPyMARL; of pymarlzooplus: from pymarlzooplus.envs

    register_pymarl(REGISTRY, flavour="epymarl")

Then `env: bulletuav` in a configuration selects it, with the task as `env_args.map_name`.
"""

import functools
import operator
from collections.abc import Callable, MutableMapping
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from PIL import Image

from bulletuav.adapters.totals import EpisodeTotals
from bulletuav.envs.action_masks import STAY
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.reset_options import reset_options
from bulletuav.errors import as_int, find_choice, shown
from bulletuav.files import whole_file
from bulletuav.policies.features import symlog as compress
from bulletuav.tasks import TaskSource

FLAVOURS = {"epymarl": True, "pymarl": False}
"""Whether `step` returns termination and truncation separately; pymarlzooplus is as PyMARL"""
SCALARISATIONS: dict[str, Callable[[np.ndarray], Any]] = {"sum": np.sum, "mean": np.mean}
"""Functions that combine the rewards of all drones"""


class PymarlEnv(LabelledEnvironment):
    """One world of N drones with discrete actions, as a PyMARL multi-agent environment.

    The N agents share one state and one episode. A drone whose episode has ended remains an agent
    until all are done, as these programs need: its observation and its reward are zero, and only
    the action 0 (stay) is available.

    Attributes:
        aviary: The batched environment with W = 1.
        n_agents: Number of drones N.
        episode_limit: Maximum number of decisions of an episode, the option `horizon`.
    """

    def __init__(
        self,
        task: TaskSource,
        flavour: str = "epymarl",
        *,
        common_reward: bool = True,
        reward_scalarisation: str = "sum",
        symlog: bool = False,
        replay_dir: str | Path | None = None,
        action: str = "discrete",
        **options: Any,
    ) -> None:
        """Make the environment.

        Args:
            task: One of `list_tasks()`, `module:Name`, or a task class.
            flavour: "epymarl", where `step` returns five values, or "pymarl" (also for
                pymarlzooplus), where it returns three.
            common_reward: If True, all drones receive one common reward. Otherwise each receives
                its own, which only EPyMARL supports, and which teams with opposed aims need.
            reward_scalarisation: Common reward: the "sum" or the "mean" over all N drones.
            symlog: If True, observations and state are compressed by sign(x) ln(1 + abs(x)). These
                programs pass them to their networks without scaling.
            replay_dir: Folder for `save_replay`; without it no frames are stored.
            action: "discrete", "discrete_27", or another discrete action.
            **options: Options of `parallel_env`.

        Raises:
            ValueError: If an option is invalid or unknown.
        """
        self._splits_ends = find_choice("flavour", flavour, FLAVOURS)
        self._combine_rewards: Callable[[np.ndarray], Any] = find_choice(
            "reward_scalarisation", reward_scalarisation, SCALARISATIONS
        )
        # Check the options before the world is created, which is slow
        spec = EnvSpec(task, 1, {**options, "action": action})
        _check(spec, common_reward, self._splits_ends)
        self.aviary = Aviary(task, 1, action=action, **options)
        # Form of observations and rewards
        self._observer = self.aviary.observer
        self._symlog = symlog
        self._common = common_reward
        # Rendered frames of the episode, for `save_replay`
        self._folder = None if replay_dir is None else Path(replay_dir)
        self._pictures: list[np.ndarray] = []
        self._replays = 0
        # Attributes that PyMARL reads
        self.n_agents = self.aviary.num_drones
        self.episode_limit = self.aviary.options.horizon
        # State of the episode
        self._seed: int | None = None
        self._present = np.zeros(self.n_agents, dtype=bool)
        self._observed = np.zeros((self.n_agents, self.get_obs_size()), np.float32)
        self._totals = EpisodeTotals(self.aviary)

    def seed(self, seed: int | None = None) -> None:
        """Seed the next `reset`; None continues the random sequence.

        Raises:
            ValueError: If the seed is not an integer of at least 0.
        """
        self._seed = None if seed is None else as_int("seed", seed, 0)

    @exclusive
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[np.ndarray], Any]:
        """Start a new episode.

        Args:
            seed: Random seed; None uses the seed set by `seed()`, or continues the random sequence.
            options: See `ParallelAviary.reset`.

        Returns:
            Observations of all drones, and an empty info (EPyMARL) or the global state (PyMARL).
        """
        seed = self._seed if seed is None else seed
        observations = self.aviary.reset(seeds=seed, **reset_options(options))
        self._seed = None
        self._pictures.clear()
        self._present[:] = self.aviary.alive[0]
        self._store_observations(observations)
        return self.get_obs(), {} if self._splits_ends else self.get_state()

    @exclusive
    def step(self, actions: Any) -> tuple[Any, ...]:
        """Step the environment by one decision.

        Args:
            actions: (N,) discrete actions, a tensor, an array or a list. Actions of drones whose
                episode has ended are ignored.

        Returns:
            EPyMARL: observations, reward, terminated, truncated, info. PyMARL: reward, terminated,
            info. The reward is a number, or without `common_reward` a list of N. The values of the
            info are numbers, which programs sum up. Its "episode_limit" is True if an episode was
            ended only by the horizon. At the end of an episode the info also has the fractions of
            drones with "success" and "collision", and the mean over drones of "conflicts" and of
            the return of each reward term.

        Raises:
            ValueError: If an action is invalid; the state is then unchanged.
            RuntimeError: Before the first reset, after the end of an episode, or after `close`.
        """
        self.aviary.require_started()
        flown = self.aviary.alive[0].copy()
        if not flown.any():
            raise RuntimeError("the episode is over: call reset()")
        choices = np.where(flown, self._choices(actions), STAY)
        step = self.aviary.step(choices[None, :, None])
        # Truncated drones count as present, so that value estimates bootstrap
        self._present = flown & ~step.terminated[0]
        self._store_observations(step.observations)
        over = not self.aviary.alive.any()
        limit = over and bool(step.truncated[0, flown].any())
        info: dict[str, Any] = {"episode_limit": limit}
        if over:
            # Programs use these names as file names
            totals = self._totals.of_world(0).items()
            info |= {name.replace("/", "_"): total for name, total in totals}
        reward = self._reward(step.rewards[0])
        if self._splits_ends:
            return self.get_obs(), reward, over and not limit, limit, info
        return reward, over, info

    def _choices(self, actions: Any) -> np.ndarray:
        """Convert the actions that programs pass to an array (N,) of float64."""
        try:
            chosen = [operator.index(one) for one in actions]
        except TypeError:
            chosen = []
        if len(chosen) != self.n_agents:
            raise ValueError(
                f"actions are {shown(actions)}: a whole number for each of the {self.n_agents} "
                f"drones is needed"
            )
        return np.array(chosen, dtype=float)

    def _reward(self, rewards: np.ndarray) -> float | list[float]:
        """Return the common reward of rewards (N,), or the rewards as a list."""
        if self._common:
            return float(self._combine_rewards(rewards))
        own: list[float] = rewards.tolist()
        return own

    def _store_observations(self, observations: Any) -> None:
        """Store observations (1, N, D), with zeros for drones that have left."""
        seen = np.where(self._present[:, None], observations[0], 0.0)
        self._observed = self._compressed(seen)

    def _compressed(self, values: np.ndarray) -> np.ndarray:
        shown: np.ndarray = compress(values) if self._symlog else values
        return shown.astype(np.float32)

    def get_obs(self) -> list[np.ndarray]:
        """Return the observations of all drones, N arrays (D,) of float32."""
        return list(self._observed.copy())

    def get_obs_agent(self, agent_id: int) -> np.ndarray:
        """Return the observation of one drone, (D,) float32."""
        seen: np.ndarray = self._observed[self._drone(agent_id)]
        return seen.copy()

    def get_obs_size(self) -> int:
        """Return the size D of an observation."""
        return int(np.prod(self._observer.space().shape or ()))

    @exclusive
    def get_state(self) -> np.ndarray:
        """Return the global state, (K,) float32; see `Aviary.state`."""
        return self._compressed(self.aviary.state()[0])

    def get_state_size(self) -> int:
        """Return the size K of the global state."""
        return len(self.aviary.global_state.low)

    def get_avail_actions(self) -> list[list[int]]:
        """Return the action mask of each drone: 1 for available actions, else 0."""
        return [self.get_avail_agent_actions(i) for i in range(self.n_agents)]

    def get_avail_agent_actions(self, agent_id: int) -> list[int]:
        """Return the action mask of one drone; after its episode only action 0 is available.

        With the option `action_masks`, moves that lead out of the arena are not available.
        """
        drone = self._drone(agent_id)
        if self._present[drone] and self.aviary.options.action_masks:
            valid: list[int] = self.aviary.action_masks()[0, drone].tolist()
            return valid
        here = self._present[drone]
        return [int(here or choice == STAY) for choice in range(self.get_total_actions())]

    def _drone(self, agent_id: int) -> int:
        return as_int("agent_id", agent_id, 0, self.n_agents - 1)

    def get_total_actions(self) -> int:
        """Return the number of discrete actions of a drone."""
        return int(self.aviary.action.choices or 0)

    def get_env_info(self) -> dict[str, int]:
        """Return state_shape, obs_shape, n_actions, n_agents and episode_limit."""
        return {
            "state_shape": self.get_state_size(),
            "obs_shape": self.get_obs_size(),
            "n_actions": self.get_total_actions(),
            "n_agents": self.n_agents,
            "episode_limit": self.episode_limit,
        }

    def get_stats(self) -> dict[str, float]:
        """Return no statistics: the info of the last step of an episode has them."""
        return {}

    def get_print_info(self) -> None:
        """Return nothing to print; pymarlzooplus calls this method."""

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render an image, and store it for `save_replay` if `replay_dir` is set.

        Returns:
            Image (height, width, 3) uint8 with render_mode "rgb_array", else None.
        """
        picture = self.aviary.render()
        if picture is not None and self._folder is not None:
            self._pictures.append(picture)
        return picture

    @exclusive
    def save_replay(self) -> None:
        """Write the rendered images of this episode to a new .gif in the folder `replay_dir`.

        Raises:
            RuntimeError: If `replay_dir` is not set, or no image was rendered.
        """
        if self._folder is None or not self._pictures:
            raise RuntimeError(
                "there are no images for a replay: give the environment replay_dir and "
                "render_mode='rgb_array', and the program render=True"
            )
        self._folder.mkdir(parents=True, exist_ok=True)
        self._replays += 1
        first, *others = [Image.fromarray(picture) for picture in self._pictures]
        period = 1000 / self.aviary.options.decision_hz
        name = f"{self.aviary.task.name}-{self._replays:03d}.gif"
        with whole_file(self._folder / name) as part:
            first.save(part, format="GIF", save_all=True, append_images=others, duration=period)

    @exclusive
    def close(self) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        self.aviary.close()


def _check(spec: EnvSpec, common_reward: bool, splits_ends: bool) -> None:
    """Raise ValueError for environments that these programs do not support."""
    if spec.action.choices is None:
        raise ValueError(
            f"action is {spec.action.name!r}: these programs store whole numbers as actions, for "
            f"MADDPG too; choose 'discrete' or 'discrete_27'"
        )
    space = spec.observer.space()
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(
            f"a drone observes {shown(space)}: these programs take a vector; choose "
            f"observation_format='vector' and an observation without images"
        )
    if not common_reward and not splits_ends:
        raise ValueError("common_reward is False: of these programs EPyMARL alone takes that")


def make_pymarl(
    flavour: str, map_name: TaskSource | None = None, key: TaskSource | None = None, **env_args: Any
) -> PymarlEnv:
    """Make an environment from the `env_args` of a configuration.

    Args:
        flavour: See `PymarlEnv`.
        map_name: The task, which the programs also use in names of results.
        key: The task, under the other name that these programs use.
        **env_args: Options of `PymarlEnv`.

    Raises:
        ValueError: If there is no task, or an option is invalid.
    """
    task = key if map_name is None else map_name
    if task is None:
        raise ValueError("env_args have no map_name: give the task, such as map_name='crossing'")
    return PymarlEnv(task, flavour, **env_args)


def register_pymarl(
    registry: MutableMapping[str, Any], name: str = "bulletuav", flavour: str = "epymarl"
) -> None:
    """Add the environment to the registry of a program.

    Args:
        registry: `envs.REGISTRY` of PyMARL or EPyMARL, `pymarlzooplus.envs.REGISTRY`.
        name: Value of `env` in configurations.
        flavour: See `PymarlEnv`.

    Raises:
        ValueError: If the flavour is unknown.
    """
    find_choice("flavour", flavour, FLAVOURS)
    registry[name] = functools.partial(make_pymarl, flavour)
