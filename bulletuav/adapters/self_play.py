"""Environments in which one team learns while policies control the other teams.

An opponent can be fixed (the name of a policy, or the folder of a run), or learn as well: a
function of observations is called at every decision.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, Space
from pettingzoo import ParallelEnv

from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.parallel import (
    AgentResults,
    ByAgent,
    InfosByAgent,
    ParallelAviary,
    check_agents,
)
from bulletuav.envs.reset_options import check_setting
from bulletuav.envs.snapshot import EnvironmentSnapshot, require_environment_snapshot
from bulletuav.envs.teams import team_names, team_rows
from bulletuav.errors import find_choice, numbers_of, shown
from bulletuav.policies import Policy, PolicySource, find_policy
from bulletuav.policies.versus import TeamPolicies, joint_options
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation

Opponents = PolicySource | Mapping[str, PolicySource]
"""Policy of all other teams, or policies by the name of the team"""


class TeamAviary(LabelledEnvironment, ParallelEnv):  # type: ignore[misc]  # has no types
    """`pettingzoo.ParallelEnv` of one team of a task, with opponents controlled by policies.

    Attributes:
        env: The environment of all teams, with its `aviary`.
        team: Name of the team.
        possible_agents: Agents of the team.
        agents: Agents of the team whose episode has not ended.
        observation_spaces: Observation space of each agent.
        action_spaces: Action space of each agent.
        metadata: Metadata of the environment of all teams; "group_map" has only this team.
    """

    def __init__(
        self, task: TaskSource, team: str, opponents: Opponents, trust: bool = False, **options: Any
    ) -> None:
        """Make the environment; see `team_env`."""
        # Options of the call override those with which opponents were trained
        sources = opponents.values() if isinstance(opponents, Mapping) else (opponents,)
        needed = joint_options([find_policy(one, task, trust).options for one in sources])
        self.env = ParallelAviary(task, **{**needed, **options})
        self._trust = trust
        groups = self.env.group_map
        self.team = team
        self.possible_agents: list[str] = find_choice("team", team, groups)
        self.group_map = {team: self.possible_agents}
        # The drones of a team observe the same blocks
        self._observer = self.env.aviary.observer.of(team_rows(self.env.aviary.task)[team][0])
        self.metadata = {**self.env.metadata, "group_map": self.group_map}
        self.render_mode = self.env.render_mode
        self.agents: list[str] = []
        spaces = (self.env.observation_spaces, self.env.action_spaces)
        self.observation_spaces, self.action_spaces = (
            {agent: one[agent] for agent in self.possible_agents} for one in spaces
        )
        self._policy: Policy | None = None
        self._seen: ByAgent = {}
        self.opponents = opponents

    @property
    def opponents(self) -> Opponents:
        """Policy of the other teams; a new one takes effect at the next reset."""
        return self._opponents

    @opponents.setter
    def opponents(self, opponents: Opponents) -> None:
        aviary, task = self.env.aviary, self.env.aviary.task
        others = [name for name in team_names(task) if name != self.team]
        each = opponents if isinstance(opponents, Mapping) else dict.fromkeys(others, opponents)
        if sorted(each) != sorted(others):
            raise ValueError(
                f"opponents are {shown(list(each))}: a policy for each of {', '.join(others)} is "
                f"needed"
            )
        found = [find_policy(source, type(task), self._trust) for source in each.values()]
        makers = [one.__call__ for one in found]
        # The actions of the team itself come from the caller
        self._made = TeamPolicies(aviary, [*makers, makers[0]], [*each, self.team])
        self._opponents = opponents

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the observation space of an agent, the same object in each call."""
        return find_choice("agent", agent, self.observation_spaces)

    def action_space(self, agent: str) -> Space[Any]:
        """Return the action space of an agent, the same object in each call."""
        return find_choice("agent", agent, self.action_spaces)

    @exclusive
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, InfosByAgent]:
        """Start a new episode; see `ParallelAviary.reset`.

        Returns:
            Observations and infos, by agent of the team.
        """
        self._seen, infos = self.env.reset(seed, options)
        self._policy = self._made
        self._policy.reset(np.ones(1, dtype=bool))
        self.agents = self.possible_agents[:]
        return self._select_team(self._seen), self._select_team(infos)

    @property
    def np_random(self) -> np.random.Generator:
        """Random generator of the episode; see `ParallelAviary.np_random`."""
        return self.env.np_random

    @exclusive
    def step(self, actions: dict[str, np.ndarray]) -> AgentResults:
        """Step the environment by one decision; see `ParallelAviary.step`.

        Args:
            actions: An action for each agent in `agents`.

        Returns:
            Observations, rewards, terminated, truncated and infos, by agent of the team.

        Raises:
            ValueError: If an action is missing or invalid, or is for an agent outside the team.
            RuntimeError: Before the first reset, or after `close`.
        """
        self.env.aviary.require_started()
        check_agents(actions, self.agents, self.possible_agents)
        if not self.agents:
            return {}, {}, {}, {}, {}
        results = self.env.step({**self._opponent_actions(), **actions})
        self._seen = {agent: results[0][agent] for agent in self.env.agents}
        self.agents = [agent for agent in self.agents if agent in self.env.agents]
        seen, rewards, terminated, truncated, infos = map(self._select_team, results)
        return seen, rewards, terminated, truncated, infos

    def _select_team(self, by_agent: Mapping[str, Any]) -> dict[str, Any]:
        """Select the entries of the agents of the team."""
        return {agent: by_agent[agent] for agent in self.possible_agents if agent in by_agent}

    def _opponent_actions(self) -> ByAgent:
        """Return the actions of the active opponents from their policies."""
        env = self.env
        assert self._policy is not None  # there was a reset
        actions = self._policy.act(self._stack_observations(), env.aviary.swarm)[0]
        opposed: ByAgent = {}
        for i, agent in enumerate(env.possible_agents):
            if agent in env.agents and agent not in self.possible_agents:
                is_choice = isinstance(env.action_spaces[agent], Discrete)
                size = env.aviary.action.size(i)
                opposed[agent] = int(actions[i, 0]) if is_choice else actions[i, :size]
        return opposed

    def _stack_observations(self) -> Observation:
        """Stack the last observations, (1, N, ...), with zeros for drones that have left."""
        env, space = self.env, self.env.aviary.observer.space()
        if not isinstance(space, Dict):
            return _stack(self._seen, env.possible_agents, space)[None]
        entries: Observation = {}
        for name, one in space.items():
            seen = {agent: observed[name] for agent, observed in self._seen.items()}
            entries[name] = _stack(seen, env.possible_agents, one)[None]
        return entries

    @exclusive
    def set_condition(self, agents: Any = None, **changes: Any) -> None:
        """Change drones of any team, or the wind; see `ParallelAviary.set_condition`."""
        self.env.set_condition(agents, **changes)

    @exclusive
    def save_state(self) -> EnvironmentSnapshot:
        """Save the state of the simulation and the memory of the opponents' policies.

        Weights of opponents that learn are not saved; see `Aviary.save_state`.
        """
        flight = self.env.save_state()
        assert self._policy is not None  # there was a reset
        return EnvironmentSnapshot("team_env", flight, self._policy.memory())

    @exclusive
    def load_state(self, snapshot: EnvironmentSnapshot) -> ByAgent:
        """Restore a saved state; see `Aviary.load_state`.

        Returns:
            Observations of the active agents of the team, by agent.

        Raises:
            ValueError: If the snapshot does not match this environment or its policies.
        """
        require_environment_snapshot(snapshot, "team_env")
        before = self._made.memory()
        self._made.restore(snapshot.beside)
        try:
            self._seen = self.env.load_state(snapshot.flight)
        except ValueError:  # it is of another form
            self._made.restore(before)
            raise
        self._policy = self._made
        self.agents = [agent for agent in self.possible_agents if agent in self.env.agents]
        return self._select_team(self._seen)

    @exclusive
    def state_hash(self) -> str:
        """Hash the state of the world; see `Aviary.state_hash`."""
        return self.env.state_hash()

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render an image; see `ParallelAviary.render`."""
        return self.env.render()

    @exclusive
    def close(self) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        self.env.close()


def _stack(seen: ByAgent, agents: list[str], space: Space[Any]) -> np.ndarray:
    """Stack observations of agents, (N, ...), with zeros for missing ones, and as padding."""
    stacked = np.zeros((len(agents), *(space.shape or ())), dtype=space.dtype)
    for row, agent in zip(stacked, agents, strict=True):
        if agent in seen:
            row[: len(seen[agent])] = seen[agent]
    return stacked


class CentralTeamAviary(LabelledEnvironment, gymnasium.Env[Any, Any]):
    """`gymnasium.Env` of one team: a central agent that controls all its drones.

    The observation is the concatenation of the observations of the drones, with zeros for drones
    that have left. The reward is the mean reward of the drones. With one drone the environment is
    that of the drone.

    Attributes:
        env: The `TeamAviary`.
        observation_space: Box of the concatenated observations of the drones.
        action_space: Box of the concatenated actions of the drones.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(
        self, task: TaskSource, team: str, opponents: Opponents, trust: bool = False, **options: Any
    ) -> None:
        """Make the environment; see `team_env`."""
        self.env = TeamAviary(task, team, opponents, trust, **options)
        self._observer = self.env._observer
        self.render_mode = self.env.render_mode
        self._agents = self.env.possible_agents
        boxes = self.env.observation_spaces, self.env.action_spaces
        self.observation_space, self.action_space = (self._joined(one) for one in boxes)
        aviary = self.env.env.aviary
        sizes = [aviary.action.size(i) for i in team_rows(aviary.task)[team]]
        self._split_indices = np.cumsum(sizes)[:-1]
        self._config = aviary.task.config

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute; raise AttributeError for options, which setting would not change."""
        if type(self) is CentralTeamAviary and "_config" in vars(self):
            check_setting(self, name, self._config)
        super().__setattr__(name, value)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute that a wrapper passes on; see `gymnasium.Env.set_wrapper_attr`."""
        check_setting(self, name, self._config)
        return super().set_wrapper_attr(name, value, force=force)

    def _joined(self, spaces: Mapping[str, Space[Any]]) -> Box:
        """Return the concatenated box of the drones."""
        each = [spaces[agent] for agent in self._agents]
        for space in each:
            if not isinstance(space, Box) or len(space.shape) != 1:
                raise ValueError(
                    f"central=True joins vectors of numbers, and a drone has {shown(space)}: "
                    f"choose observation_format='vector' and a continuous action"
                )
        low, high = (np.concatenate([getattr(one, k) for one in each]) for k in ("low", "high"))
        return Box(low, high, dtype=np.float32)

    @property
    def opponents(self) -> Opponents:
        """Policy of the other teams; a new one takes effect at the next reset."""
        return self.env.opponents

    @opponents.setter
    def opponents(self, opponents: Opponents) -> None:
        self.env.opponents = opponents

    @exclusive
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new episode; see `TeamAviary.reset`.

        Returns:
            The observation, and infos by agent.
        """
        super().reset(seed=seed)
        seen, infos = self.env.reset(seed, options)
        return self._observed(seen), dict(infos)

    @exclusive
    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Step the environment by one decision; see `TeamAviary.step`.

        Args:
            action: An element of `action_space`.

        Returns:
            The observation, reward, terminated, truncated, and infos by agent.

        Raises:
            ValueError: If the action is invalid.
        """
        numbers = numbers_of("action is", action)
        if numbers.shape != self.action_space.shape:
            raise ValueError(
                f"action has shape {numbers.shape}: {self.action_space.shape} is needed"
            )
        parts = np.split(numbers, self._split_indices)
        given = dict(zip(self._agents, parts, strict=True))
        flying = {agent: given[agent] for agent in self.env.agents}
        seen, rewards, _, truncated, infos = self.env.step(flying)
        is_over = not self.env.agents
        cut = is_over and any(truncated.values())
        mean = sum(rewards.values()) / len(self._agents)
        return self._observed(seen), mean, is_over and not cut, cut, dict(infos)

    def _observed(self, seen: ByAgent) -> np.ndarray:
        space = self.env.observation_spaces[self._agents[0]]
        flat: np.ndarray = _stack(seen, self._agents, space).ravel()
        return flat

    @exclusive
    def set_condition(self, agents: Any = None, **changes: Any) -> None:
        """Change drones of any team, or the wind; see `ParallelAviary.set_condition`."""
        self.env.set_condition(agents, **changes)

    @exclusive
    def save_state(self) -> EnvironmentSnapshot:
        """Save the state of the simulation and of policies; see `TeamAviary.save_state`."""
        return self.env.save_state()

    @exclusive
    def load_state(self, snapshot: EnvironmentSnapshot) -> np.ndarray:
        """Restore a saved state; see `TeamAviary.load_state`.

        Returns:
            The observation.
        """
        return self._observed(self.env.load_state(snapshot))

    @exclusive
    def state_hash(self) -> str:
        """Hash the state of the world; see `Aviary.state_hash`."""
        return self.env.state_hash()

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render an image; see `ParallelAviary.render`."""
        return self.env.render()

    @exclusive
    def close(self) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        self.env.close()


def team_env(
    task: TaskSource,
    team: str,
    opponents: Opponents,
    *,
    central: bool = False,
    trust: bool = False,
    **options: Any,
) -> TeamAviary | CentralTeamAviary:
    """Make an environment of one team of a task, with opponents controlled by policies.

        env = bulletuav.team_env("pursuit_evasion", "chasers", opponents="flee")
        env.opponents = "flee_gap"  # from the next reset on

    Args:
        task: One of `list_tasks()`, `module:Name`, or a task class.
        team: Name of the team, such as "chasers".
        opponents: Policy of all other teams: name, class, or folder of a run; a function of
            observations, which may be trained meanwhile; or a dict of these by team.
        central: If True, return a `gymnasium.Env` with one agent for the whole team.
        trust: If True, model files that can run code may be loaded.
        **options: Options of `parallel_env`.

    Returns:
        A `pettingzoo.ParallelEnv` with the agents of the team, or a `gymnasium.Env`.

    Raises:
        ValueError: If the team or a policy is unknown, or an option is invalid.
    """
    kind = CentralTeamAviary if central else TeamAviary
    return kind(task, team, opponents, trust, **options)
