"""Environment of PyMARL, EPyMARL and pymarlzooplus, by the method names that their runners call.

These programs are not imported: register the environment with theirs, then run them.

    from envs import REGISTRY  # of EPyMARL; of pymarlzooplus: from pymarlzooplus.envs

    register_pymarl(REGISTRY, flavour="epymarl")

`env: bulletuav` in a configuration finds it then, with the task as `env_args.map_name`.
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
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.reset_options import reset_options
from bulletuav.errors import as_int, choose, shown
from bulletuav.files import whole_file
from bulletuav.policies.features import symlog as compress
from bulletuav.tasks import TaskSource

FLAVOURS = {"epymarl": True, "pymarl": False}
"""Whether a step tells terminations and truncations apart; pymarlzooplus is of PyMARL's kind"""
SCALARISATIONS: dict[str, Callable[[np.ndarray], Any]] = {"sum": np.sum, "mean": np.mean}
"""Ways to make one reward of all"""
STAY = 0
"""Choice that is left to drones that are gone: to stay, in the package's discrete actions"""


class PymarlEnv(LabelledEnvironment):
    """One world of N drones that choose among discrete actions: N agents, one state, one episode.

    A drone whose episode ended stays an agent until all are done, as these programs need: it
    observes zeros, has the reward 0, and the action 0 (to stay) alone is available.

    Attributes:
        aviary: The batched core with W = 1.
        n_agents: N.
        episode_limit: Most decisions of an episode, the option `horizon`.
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
            task: One of `list_tasks()`, `module:Name`, or a class of one's own.
            flavour: "epymarl", whose steps have five results, or "pymarl" (also for
                pymarlzooplus), whose steps have three.
            common_reward: Whether all drones have one reward. Else each has its own, which EPyMARL
                alone takes, and which teams with opposed aims need.
            reward_scalarisation: Whether the common reward is the "sum" or the "mean" of all N.
            symlog: Whether observations and state are compressed by sign(x) ln(1 + |x|), as these
                programs pass metres to their networks as they are.
            replay_dir: Folder for `save_replay`; pictures are kept with it alone.
            action: "discrete", "discrete_27", or another one with choices.
            **options: Options of `parallel_env`.

        Raises:
            ValueError: An option cannot be, or does not exist; the nearest names are told.
        """
        self._tells_apart = choose("flavour", flavour, FLAVOURS)
        self._join: Callable[[np.ndarray], Any] = choose(
            "reward_scalarisation", reward_scalarisation, SCALARISATIONS
        )
        # Options are checked before worlds are made, which takes longer
        spec = EnvSpec(task, 1, {**options, "action": action})
        _check(spec, common_reward, self._tells_apart)
        self.aviary = Aviary(task, 1, action=action, **options)
        # How observations and rewards are told
        self._observer = self.aviary.observer
        self._symlog = symlog
        self._common = common_reward
        # Pictures of the episode, for a replay that is asked for
        self._folder = None if replay_dir is None else Path(replay_dir)
        self._pictures: list[np.ndarray] = []
        self._replays = 0
        # What PyMARL reads off an environment
        self.n_agents = self.aviary.num_drones
        self.episode_limit = self.aviary.options.horizon
        # State of the episode
        self._seed: int | None = None
        self._present = np.zeros(self.n_agents, dtype=bool)
        self._observed = np.zeros((self.n_agents, self.get_obs_size()), np.float32)
        self._totals = EpisodeTotals()

    def seed(self, seed: int | None = None) -> None:
        """Seed the next `reset`; None goes on with the random numbers.

        Raises:
            ValueError: The seed is no whole number, or less than 0.
        """
        self._seed = None if seed is None else as_int("seed", seed, 0)

    @exclusive
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[list[np.ndarray], Any]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers; None takes that of `seed`, or goes on with them.
            options: See `ParallelAviary.reset`.

        Returns:
            Observations of all drones, and an empty info (EPyMARL) or the state (PyMARL).
        """
        seed = self._seed if seed is None else seed
        observations = self.aviary.reset(seeds=seed, **reset_options(options))
        self._seed = None
        self._pictures.clear()
        self._totals.forget(np.ones(1, dtype=bool))
        self._present[:] = True
        self._see(observations)
        return self.get_obs(), {} if self._tells_apart else self.get_state()

    @exclusive
    def step(self, actions: Any) -> tuple[Any, ...]:
        """Fly one decision.

        Args:
            actions: (N,) choices, a tensor, an array or a list; those of drones that are gone are
                ignored.

        Returns:
            EPyMARL: observations, reward, terminated, truncated, info. PyMARL: reward, terminated,
            info. The reward is a number, or without `common_reward` a list of N. The info is made
            of numbers that programs add up. Its "episode_limit" is True where nothing but the
            horizon ended the episode of a drone. With an episode's end come the shares of drones
            with "success" and "collision", and the mean drone's "conflicts" and return of each
            reward term.

        Raises:
            ValueError: An action cannot be; nobody has flown then.
            RuntimeError: Before the first reset, after an episode's end, or after `close`.
        """
        self.aviary.require_started()
        flown = self.aviary.alive[0].copy()
        if not flown.any():
            raise RuntimeError("the episode is over: call reset()")
        choices = np.where(flown, self._choices(actions), STAY)
        step = self.aviary.step(choices[None, :, None])
        self._totals.add(step, flown[None])
        # A drone that the horizon stopped goes on as far as values are concerned
        self._present = flown & ~step.terminated[0]
        self._see(step.observations)
        over = not self.aviary.alive.any()
        limit = over and bool(step.truncated[0, flown].any())
        info: dict[str, Any] = {"episode_limit": limit}
        if over:
            # Programs make files of these names
            totals = self._totals.of_world(0).items()
            info |= {name.replace("/", "_"): total for name, total in totals}
        reward = self._reward(step.rewards[0])
        if self._tells_apart:
            return self.get_obs(), reward, over and not limit, limit, info
        return reward, over, info

    def _choices(self, actions: Any) -> np.ndarray:
        """Make (N,) float64 of what programs give."""
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
        """Make one reward of all (N,), or list them."""
        if self._common:
            return float(self._join(rewards))
        own: list[float] = rewards.tolist()
        return own

    def _see(self, observations: Any) -> None:
        """Keep what drones observe, from (1, N, D); zeros of those that are gone."""
        seen = np.where(self._present[:, None], observations[0], 0.0)
        self._observed = self._compressed(seen)

    def _compressed(self, values: np.ndarray) -> np.ndarray:
        shown: np.ndarray = compress(values) if self._symlog else values
        return shown.astype(np.float32)

    def get_obs(self) -> list[np.ndarray]:
        """List the observations of all drones, N arrays (D,) float32."""
        return list(self._observed.copy())

    def get_obs_agent(self, agent_id: int) -> np.ndarray:
        """Return the observation of one drone, (D,) float32."""
        seen: np.ndarray = self._observed[self._drone(agent_id)]
        return seen.copy()

    def get_obs_size(self) -> int:
        """Count the numbers of an observation."""
        return int(np.prod(self._observer.space().shape or ()))

    @exclusive
    def get_state(self) -> np.ndarray:
        """Return the global state, (K,) float32; see `Aviary.state`."""
        return self._compressed(self.aviary.state()[0])

    def get_state_size(self) -> int:
        """Count the numbers of the global state."""
        return len(self.aviary.global_state.low)

    def get_avail_actions(self) -> list[list[int]]:
        """List 1 for each action that is available and 0 for the others, of each drone."""
        return [self.get_avail_agent_actions(i) for i in range(self.n_agents)]

    def get_avail_agent_actions(self, agent_id: int) -> list[int]:
        """List what is available to one drone: all, or once it is gone the action 0 alone."""
        here = self._present[self._drone(agent_id)]
        return [int(here or choice == STAY) for choice in range(self.get_total_actions())]

    def _drone(self, agent_id: int) -> int:
        return as_int("agent_id", agent_id, 0, self.n_agents - 1)

    def get_total_actions(self) -> int:
        """Count the actions of a drone."""
        return int(self.aviary.action.choices or 0)

    def get_env_info(self) -> dict[str, int]:
        """Tell sizes: state_shape, obs_shape, n_actions, n_agents and episode_limit."""
        return {
            "state_shape": self.get_state_size(),
            "obs_shape": self.get_obs_size(),
            "n_actions": self.get_total_actions(),
            "n_agents": self.n_agents,
            "episode_limit": self.episode_limit,
        }

    def get_stats(self) -> dict[str, float]:
        """Tell nothing: the info of an episode's last step has its statistics."""
        return {}

    def get_print_info(self) -> None:
        """Tell nothing to print, as pymarlzooplus asks."""

    @exclusive
    def render(self) -> np.ndarray | None:
        """Take a picture, and keep it for `save_replay` where there is a folder for that.

        Returns:
            (height, width, 3) uint8 with render_mode "rgb_array", else None.
        """
        picture = self.aviary.render()
        if picture is not None and self._folder is not None:
            self._pictures.append(picture)
        return picture

    @exclusive
    def save_replay(self) -> None:
        """Write the pictures of this episode to a new .gif in the folder `replay_dir`.

        Raises:
            RuntimeError: There is no folder, or no picture was taken.
        """
        if self._folder is None or not self._pictures:
            raise RuntimeError(
                "there are no pictures for a replay: give the environment replay_dir and "
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
        """Free the engine; a second call does nothing."""
        self.aviary.close()


def _check(spec: EnvSpec, common_reward: bool, tells_apart: bool) -> None:
    """Raise ValueError for environments that these programs cannot take."""
    if spec.action.choices is None:
        raise ValueError(
            f"action is {spec.action.name!r}: these programs store whole numbers as actions, for "
            f"MADDPG too; choose 'discrete' or 'discrete_27'"
        )
    space = spec.observer.space()
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(
            f"a drone observes {shown(space)}: these programs take a vector; choose "
            f"observation_format='vector' and an observation without pictures"
        )
    if not common_reward and not tells_apart:
        raise ValueError("common_reward is False: of these programs EPyMARL alone takes that")


def make_pymarl(
    flavour: str, map_name: TaskSource | None = None, key: TaskSource | None = None, **env_args: Any
) -> PymarlEnv:
    """Make an environment of what stands in `env_args` of a configuration.

    Args:
        flavour: As of `PymarlEnv`.
        map_name: The task; the programs also name results after it.
        key: The task, by the other name that the programs know.
        **env_args: Options of `PymarlEnv`.

    Raises:
        ValueError: There is no task, or an option cannot be.
    """
    task = key if map_name is None else map_name
    if task is None:
        raise ValueError("env_args have no map_name: give the task, such as map_name='crossing'")
    return PymarlEnv(task, flavour, **env_args)


def register_pymarl(
    registry: MutableMapping[str, Any], name: str = "bulletuav", flavour: str = "epymarl"
) -> None:
    """Enter the environment into a program's registry.

    Args:
        registry: `envs.REGISTRY` of PyMARL or EPyMARL, `pymarlzooplus.envs.REGISTRY`.
        name: Name for `env` in configurations.
        flavour: As of `PymarlEnv`.

    Raises:
        ValueError: There is no such flavour.
    """
    choose("flavour", flavour, FLAVOURS)
    registry[name] = functools.partial(make_pymarl, flavour)
