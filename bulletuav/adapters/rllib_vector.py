"""Worlds of one of RLlib's runners flown at once, as RLlib itself steps them one after the other.

    config.env_runners(env_runner_cls=BatchEnvRunner, num_envs_per_env_runner=16)

The rest of a configuration with `DroneMultiAgentEnv` stays as it is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Dict

from bulletuav.adapters.rllib import ALL, DroneMultiAgentEnv, compressed, shown_space, take_task
from bulletuav.adapters.totals import EpisodeTotals
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.reset_options import reset_options
from bulletuav.envs.spaces import drone_action_space
from bulletuav.errors import as_int, missing, numbers_of, shown
from bulletuav.tasks.observations.observer import Observation, part

try:
    from ray.rllib.callbacks.utils import make_callback
    from ray.rllib.env.multi_agent_env import MultiAgentEnv
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
    from ray.rllib.env.vector.vector_multi_agent_env import VectorMultiAgentEnv
except ImportError:
    raise missing("learning with RLlib", "rllib") from None

OF_EVALUATION = 1_000_000
"""What RLlib adds to the seeds of runners that evaluate"""
ByWorld = list[dict[str, Any]]
"""For each world values by agent"""
Results = tuple[ByWorld, ByWorld, ByWorld, ByWorld, ByWorld]
"""Observations, rewards, terminated, truncated and infos of a step"""


class World(MultiAgentEnv):  # type: ignore[misc]  # has no types
    """Names and spaces of one world, which RLlib asks for; the `DroneVectorEnv` flies it.

    Attributes:
        outcome: As of `DroneMultiAgentEnv`.
    """

    def __init__(self, spaces: tuple[dict[str, Any], dict[str, Any]]) -> None:
        """Take observation and action spaces, each by agent."""
        self.observation_spaces, self.action_spaces = spaces
        self.possible_agents = list(self.observation_spaces)
        self.agents = self.possible_agents[:]
        super().__init__()
        self.outcome: dict[str, float] = {}


class DroneVectorEnv(Environment, VectorMultiAgentEnv):  # type: ignore[misc]  # has no types
    """RLlib's `VectorMultiAgentEnv` of W worlds, all flown at once; ends as `DroneMultiAgentEnv`.

    A world whose episode is over starts anew in the step after, whose actions for it are ignored.

    Attributes:
        aviary: The batched core.
        num_envs: W.
        envs: For each world what RLlib asks of it alone.
        single_observation_spaces: Observation space of each agent.
        single_action_spaces: Action space of each agent.
    """

    def __init__(self, config: Mapping[str, Any], num_envs: int) -> None:
        """Make the worlds.

        Args:
            config: What stands in `env_config`, see `DroneMultiAgentEnv`; without stages and teams.
            num_envs: W.

        Raises:
            ValueError: There is no task, or an option cannot be.
        """
        options = dict(config)
        task = take_task(options)
        # Stages and teams would need other worlds for each environment
        for name in ("stages", "team"):
            if name in options:
                raise ValueError(
                    f"env_config has {name!r}, and worlds that are flown at once have one stage "
                    f"and all teams: leave env_runner_cls out"
                )
        # The worlds, all in one batch
        self._symlog = options.pop("symlog", False)
        self.num_envs = as_int("num_envs_per_env_runner", num_envs, 1)
        self.aviary = Aviary(task, num_envs, **options)
        self.render_mode = self.aviary.options.render_mode
        self.metadata = {"autoreset_mode": "next_step"}
        # Spaces of one world and of its agents
        self._agents = [f"drone_{i}" for i in range(self.aviary.num_drones)]
        space = shown_space(self.aviary.observer.space(), self._symlog)
        self.single_observation_spaces = dict.fromkeys(self._agents, space)
        self.single_action_spaces = {
            agent: drone_action_space(self.aviary.action, i) for i, agent in enumerate(self._agents)
        }
        self.single_observation_space = Dict(self.single_observation_spaces)
        self.single_action_space = Dict(self.single_action_spaces)
        spaces = (self.single_observation_spaces, self.single_action_spaces)
        # RLlib wants one environment a world; these only tell their spaces
        self.envs = [World(spaces) for _ in range(num_envs)]
        self._totals = EpisodeTotals()

    @exclusive
    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByWorld, ByWorld]:
        """Start new episodes in all worlds.

        Args:
            seed: World k has seed + k, or the k-th seed of a sequence; None goes on with the random
                numbers.
            options: As of `ParallelAviary.reset`; the places are those of every world.

        Returns:
            For each world observations and empty infos, by agent.
        """
        everywhere = np.ones(self.num_envs, dtype=bool)
        observations = self._start(everywhere, seed, **reset_options(options))
        everyone = np.ones(self.aviary.alive.shape, dtype=bool)
        return self._by_agent(observations, everyone), self._empty_infos(everyone)

    def _start(self, worlds: np.ndarray, seed: Any = None, **places: Any) -> Observation:
        self._totals.forget(worlds)
        return self.aviary.reset(worlds, seed, **places)

    @exclusive
    def step(self, actions: Sequence[Mapping[str, Any]]) -> Results:
        """Fly one decision of all worlds, and start those anew whose episode was over.

        Args:
            actions: For each world an action for each of its agents that fly.

        Returns:
            For each world observations, rewards, terminated, truncated and infos, by agent.

        Raises:
            ValueError: An action is missing or cannot be; nobody has flown then.
            RuntimeError: Before the first reset, or after `close`.
        """
        aviary = self.aviary
        aviary.require_started()
        flown = aviary.alive.copy()
        fresh = ~np.any(flown, axis=1)
        step = aviary.step(self._numbers(actions, flown))
        self._totals.add(step, flown)
        observations = self._start(fresh) if fresh.any() else step.observations
        # Those of worlds that began anew are there, too
        there = flown | fresh[:, None]
        over = ~fresh & ~np.any(aviary.alive, axis=1)
        cut = over & np.any(step.truncated & flown, axis=1)
        infos = self._empty_infos(there)
        for w, i in np.argwhere(flown & ~aviary.alive).tolist():
            infos[w][self._agents[i]] = self._totals.of_drone(w, i)
        for w in np.flatnonzero(over).tolist():
            self.envs[w].outcome = self._totals.of_world(w)
        rewards, terminated = (
            self._by_agent(one, there) for one in (step.rewards.tolist(), step.terminated.tolist())
        )
        for w, ends in enumerate(terminated):
            ends[ALL] = bool(over[w] and not cut[w])
        truncated: ByWorld = [{ALL: bool(one)} for one in cut]
        return self._by_agent(observations, there), rewards, terminated, truncated, infos

    def _numbers(self, actions: Sequence[Mapping[str, Any]], flown: np.ndarray) -> np.ndarray:
        """Make (W, N, A) of the actions of the drones that fly."""
        numbers = np.zeros((*flown.shape, self.aviary.action.low.shape[-1]))
        for w, i in zip(*np.nonzero(flown), strict=True):
            agent = self._agents[i]
            if agent not in actions[w]:
                raise ValueError(f"actions of world {w} lack {agent!r}: {shown(list(actions[w]))}")
            own = np.atleast_1d(actions[w][agent])
            size = self.aviary.action.size(i)
            if own.shape != (size,):
                raise ValueError(
                    f"action of {agent!r} in world {w} has shape {own.shape}: {(size,)} is needed"
                )
            numbers[w, i, :size] = numbers_of(f"parts of the action of {agent} are", own)
        return numbers

    def _by_agent(self, values: Any, there: np.ndarray) -> ByWorld:
        """Share (W, N, ...) out to the drones of a mask (W, N)."""
        if isinstance(values, list):
            return [
                {self._agents[i]: row[i] for i in np.flatnonzero(mask)}
                for row, mask in zip(values, there, strict=True)
            ]
        if self._symlog:
            values = compressed(values)
        return [
            {self._agents[i]: part(values, (w, i)) for i in np.flatnonzero(mask)}
            for w, mask in enumerate(there)
        ]

    def _empty_infos(self, there: np.ndarray) -> ByWorld:
        return [{self._agents[i]: {} for i in np.flatnonzero(mask)} for mask in there]

    @exclusive
    def render(self) -> tuple[np.ndarray | None, ...]:
        """Take a picture of each world."""
        return tuple(self.aviary.render(world) for world in range(self.num_envs))

    @exclusive
    def close(self, **_: Any) -> None:
        """Free the engine; a second call does nothing."""
        self.aviary.close()


class BatchEnvRunner(MultiAgentEnvRunner):  # type: ignore[misc]  # has no types
    """RLlib's `MultiAgentEnvRunner`, whose environments are a `DroneVectorEnv`.

    All worlds of all runners have different seeds; by RLlib's own, the second world of a runner
    flies from the same places as the first one of the next.

    Attributes:
        env: The worlds.
        num_envs: How many there are.
    """

    env: DroneVectorEnv | None
    num_envs: int

    def make_env(self) -> None:
        """Make the worlds, `num_envs_per_env_runner` of them.

        Raises:
            ValueError: The configuration is of another environment, or an option cannot be.
        """
        config = self.config
        if config.env is not DroneMultiAgentEnv:
            raise ValueError(
                f"the environment is {shown(config.env)}: this runner flies DroneMultiAgentEnv"
            )
        # A second call replaces the worlds
        if self.env is not None:
            self.env.close()
        self.env = DroneVectorEnv(config.env_config, config.num_envs_per_env_runner)
        self.num_envs = self.env.num_envs
        # RLlib resets before the first sample, with a seed of this runner's own
        self._needs_initial_reset = True
        self._seed = self._first_seed()
        # Users' callbacks, as RLlib's own runner calls them
        make_callback(
            "on_environment_created",
            callbacks_objects=self._callbacks,
            callbacks_functions=config.callbacks_on_environment_created,
            kwargs={
                "env_runner": self,
                "metrics_logger": self.metrics,
                "env": self.env,
                "env_context": config.env_config,
            },
        )

    def _first_seed(self) -> int | None:
        """Tell the seed of the first world, where there are seeds."""
        seed = self.config.seed
        if seed is None:
            return None
        runner = self.worker_index or 0
        return int(seed + runner * self.num_envs + OF_EVALUATION * self.config.in_evaluation)
