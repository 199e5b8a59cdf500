"""Vectorised environment for RLlib: all worlds of an env runner are stepped in one batch.

RLlib itself steps the environments of a runner one after the other.

    config.env_runners(env_runner_cls=BatchEnvRunner, num_envs_per_env_runner=16)

The rest of a configuration with `DroneMultiAgentEnv` remains unchanged.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Dict, Space

from bulletuav.adapters.rllib import (
    ALL,
    DroneMultiAgentEnv,
    compressed,
    masked,
    masked_space,
    shown_space,
    take_task,
)
from bulletuav.adapters.totals import EpisodeTotals
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.reset_options import reset_options
from bulletuav.envs.spaces import drone_action_space
from bulletuav.errors import as_int, missing_extra, numbers_of, shown
from bulletuav.tasks.observations.observer import part

try:
    from ray.rllib.callbacks.utils import make_callback
    from ray.rllib.env.multi_agent_env import MultiAgentEnv
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
    from ray.rllib.env.vector.vector_multi_agent_env import VectorMultiAgentEnv
except ImportError:
    raise missing_extra("learning with RLlib", "rllib") from None

EVALUATION_SEED_OFFSET = 1_000_000
"""Offset that RLlib adds to the seeds of evaluation runners"""
ByWorld = list[dict[str, Any]]
"""Values by agent, for each world"""
Results = tuple[ByWorld, ByWorld, ByWorld, ByWorld, ByWorld]
"""Observations, rewards, terminated, truncated and infos of a step"""


class WorldSpaces(MultiAgentEnv):  # type: ignore[misc]  # has no types
    """Agents and spaces of one world, which RLlib reads; `DroneVectorEnv` steps the world.

    Attributes:
        outcome: As of `DroneMultiAgentEnv`.
    """

    def __init__(self, spaces: tuple[dict[str, Any], dict[str, Any]]) -> None:
        """Set observation and action spaces, each by agent."""
        self.observation_spaces, self.action_spaces = spaces
        self.possible_agents = list(self.observation_spaces)
        self.agents = self.possible_agents[:]
        super().__init__()
        self.outcome: dict[str, float] = {}


class DroneVectorEnv(Environment, VectorMultiAgentEnv):  # type: ignore[misc]  # has no types
    """`VectorMultiAgentEnv` of W worlds, which are stepped in one batch.

    Ends of episodes are reported as in `DroneMultiAgentEnv`. A world whose episode is over is reset
    in the next step, which ignores the actions of this world.

    Attributes:
        aviary: The batched environment.
        num_envs: Number of worlds W.
        envs: Agents, spaces and outcome of each world, which RLlib reads.
        single_observation_spaces: Observation space of each agent.
        single_action_spaces: Action space of each agent.
    """

    def __init__(self, config: Mapping[str, Any], num_envs: int) -> None:
        """Create the worlds.

        Args:
            config: The `env_config` of `DroneMultiAgentEnv`, without stages and teams.
            num_envs: Number of worlds W.

        Raises:
            ValueError: If there is no task, or an option is invalid.
        """
        options = dict(config)
        task = take_task(options)
        # Stages and teams would need different worlds for each environment
        for name in ("stages", "team"):
            if name in options:
                raise ValueError(
                    f"env_config has {name!r}, but worlds in one batch have one stage "
                    f"and all teams: leave env_runner_cls out"
                )
        self._symlog = options.pop("symlog", False)
        self._masks = bool(options.get("action_masks", False))
        self.num_envs = as_int("num_envs_per_env_runner", num_envs, 1)
        self.aviary = Aviary(task, num_envs, **options)
        self.render_mode = self.aviary.options.render_mode
        self.metadata = {"autoreset_mode": "next_step"}
        # Spaces of one world and its agents
        self._agents = [f"drone_{i}" for i in range(self.aviary.num_drones)]
        self.single_action_spaces = {
            agent: drone_action_space(self.aviary.action, i) for i, agent in enumerate(self._agents)
        }
        self.single_observation_spaces = {
            agent: self._shown_space(i) for i, agent in enumerate(self._agents)
        }
        self.single_observation_space = Dict(self.single_observation_spaces)
        self.single_action_space = Dict(self.single_action_spaces)
        spaces = (self.single_observation_spaces, self.single_action_spaces)
        # RLlib needs one environment for each world, of which it reads the spaces
        self.envs = [WorldSpaces(spaces) for _ in range(num_envs)]
        self._totals = EpisodeTotals(self.aviary)

    def _shown_space(self, drone: int) -> Space[Any]:
        space = shown_space(self.aviary.observer.of(drone).space(), self._symlog)
        action = self.single_action_spaces[self._agents[drone]]
        return masked_space(space, action) if self._masks else space

    @exclusive
    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByWorld, ByWorld]:
        """Start new episodes in all worlds.

        Args:
            seed: World k gets seed + k, or the k-th seed of a sequence; None continues the random
                sequences.
            options: As in `ParallelAviary.reset`; values without a row for each world
                apply to all.

        Returns:
            Observations and empty infos by agent, for each world.
        """
        observations = self.aviary.reset(None, seed, **reset_options(options))
        everyone = self.aviary.alive.copy()
        return self._shown(observations, everyone), self._empty_infos(everyone)

    @exclusive
    def step(self, actions: Sequence[Mapping[str, Any]]) -> Results:
        """Step all worlds by one decision, and reset those whose episode is over.

        Args:
            actions: Actions of the active agents by agent, for each world.

        Returns:
            Observations, rewards, terminated, truncated and infos by agent, for each world.

        Raises:
            ValueError: If an action is missing or invalid; the state is then unchanged.
            RuntimeError: Before the first reset, or after `close`.
        """
        aviary = self.aviary
        aviary.require_started()
        flown = aviary.alive.copy()
        fresh = ~np.any(flown, axis=1)
        step = aviary.step(self._numbers(actions, flown))
        observations = aviary.reset(fresh) if fresh.any() else step.observations
        # All drones of worlds that were reset are present, too
        there = flown | (fresh[:, None] & aviary.alive)
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
        return self._shown(observations, there), rewards, terminated, truncated, infos

    def _numbers(self, actions: Sequence[Mapping[str, Any]], flown: np.ndarray) -> np.ndarray:
        """Return actions (W, N, A) of the active drones, zeros for the others."""
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
        """Convert values (W, N, ...) to dicts by agent, for the drones of a mask (W, N)."""
        if isinstance(values, list):
            return [
                {self._agents[i]: row[i] for i in np.flatnonzero(mask)}
                for row, mask in zip(values, there, strict=True)
            ]
        return [
            {self._agents[i]: part(values, (w, i)) for i in np.flatnonzero(mask)}
            for w, mask in enumerate(there)
        ]

    def _shown(self, observations: Any, there: np.ndarray) -> ByWorld:
        """Return the observations (W, N, ...) that RLlib receives, by agent."""
        if self._symlog:
            observations = compressed(observations)
        own = self.aviary.observer.unpadded
        seen = [
            {self._agents[i]: own(part(observations, (w, i)), i) for i in present.tolist()}
            for w, present in enumerate(map(np.flatnonzero, there))
        ]
        if not self._masks:
            return seen
        masks = self._by_agent(self.aviary.action_masks(), there)
        return [
            {agent: masked(one, own[agent]) for agent, one in by_agent.items()}
            for by_agent, own in zip(seen, masks, strict=True)
        ]

    def _empty_infos(self, there: np.ndarray) -> ByWorld:
        return [{self._agents[i]: {} for i in np.flatnonzero(mask)} for mask in there]

    @exclusive
    def render(self) -> tuple[np.ndarray | None, ...]:
        """Render an image of each world."""
        return tuple(self.aviary.render(world) for world in range(self.num_envs))

    @exclusive
    def close(self, **_: Any) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        self.aviary.close()


class BatchEnvRunner(MultiAgentEnvRunner):  # type: ignore[misc]  # has no types
    """RLlib's `MultiAgentEnvRunner` with a `DroneVectorEnv`.

    All worlds of all runners have different seeds. With RLlib's own seeds, the second world of a
    runner would start from the same positions as the first world of the next runner.

    Attributes:
        env: The vectorised environment.
        num_envs: Number of worlds.
    """

    env: DroneVectorEnv | None
    num_envs: int

    def make_env(self) -> None:
        """Create `num_envs_per_env_runner` worlds.

        Raises:
            ValueError: If the configuration has another environment, or an option is invalid.
        """
        config = self.config
        if config.env is not DroneMultiAgentEnv:
            raise ValueError(
                f"the environment is {shown(config.env)}: BatchEnvRunner needs DroneMultiAgentEnv"
            )
        # Repeated calls replace the worlds
        if self.env is not None:
            self.env.close()
        self.env = DroneVectorEnv(config.env_config, config.num_envs_per_env_runner)
        self.num_envs = self.env.num_envs
        # RLlib resets before the first sample, with the seed of this runner
        self._needs_initial_reset = True
        self._seed = self._first_seed()
        # Call user callbacks as RLlib's own runner does
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
        """Return the seed of the first world, or None without a configured seed."""
        seed = self.config.seed
        if seed is None:
            return None
        runner = self.worker_index or 0
        return int(
            seed + runner * self.num_envs + EVALUATION_SEED_OFFSET * self.config.in_evaluation
        )
