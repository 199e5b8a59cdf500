"""PettingZoo environments: one world whose agents leave when their episode ends."""

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from bulletuav.envs.action_masks import ACTION_MASK
from bulletuav.envs.agents import share, take
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.infos import lazy_infos
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.reset_options import reset_options
from bulletuav.envs.snapshot import EnvironmentSnapshot, Snapshot, require_environment_snapshot
from bulletuav.envs.spaces import drone_action_space, drone_numbers
from bulletuav.envs.teams import team_rows
from bulletuav.errors import as_sequence, find_choice, shown, unknown
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation, part

ByAgent = dict[str, Any]
"""One value for each agent, by its name"""
InfosByAgent = dict[str, dict[str, Any]]
"""Infos of each agent, by its name: numbers, and the mask of actions"""
AgentResults = tuple[ByAgent, dict[str, float], dict[str, bool], dict[str, bool], InfosByAgent]
"""Observations, rewards, terminated, truncated and infos of a step, each by agent"""


class ParallelAviary(LabelledEnvironment, ParallelEnv):  # type: ignore[misc]  # has no types
    """`pettingzoo.ParallelEnv` of one task, with agents `drone_0` ... `drone_{N-1}`.

    Attributes:
        aviary: The batched core with W = 1.
        possible_agents: Names of all agents.
        agents: Names of the agents whose episode is running.
        observation_spaces: Observation space of each agent.
        action_spaces: Action space of each agent.
        state_space: Space of the global state.
        group_map: Agents of each team, by its name, in TorchRL's format.
        metadata: PettingZoo's metadata, and "group_map".
        render_mode: None, "rgb_array", "human", "web" or "foxglove".
    """

    def __init__(self, task: TaskSource, **options: Any) -> None:
        """Create the environment; see `parallel_env`."""
        self.aviary = Aviary(task, 1, **options)
        self._observer = self.aviary.observer
        common = self.aviary.options
        self.metadata = {
            "name": f"bulletuav_{self.aviary.task.name}_v{self.aviary.task.version}",
            "render_modes": list(RENDER_MODES),
            "render_fps": common.decision_hz,
            "is_parallelizable": True,
        }
        self.render_mode = common.render_mode
        self.possible_agents = [f"drone_{i}" for i in range(common.num_drones)]
        self.agents: list[str] = []
        self.group_map = {
            team: [self.possible_agents[i] for i in rows]
            for team, rows in team_rows(self.aviary.task).items()
        }
        self.metadata["group_map"] = self.group_map
        self._rows = {agent: i for i, agent in enumerate(self.possible_agents)}
        action = self.aviary.action
        # Actions of the same size can be copied together
        alike = {action.size(i) for i in range(common.num_drones)} == {action.low.shape[1]}
        self._together = alike and action.choices is None
        observer = self.aviary.observer
        self.observation_spaces = {
            agent: observer.of(i).space() for i, agent in enumerate(self.possible_agents)
        }
        self._is_padded = len(observer.kinds) > 1
        self.action_spaces = {
            agent: drone_action_space(self.aviary.action, i)
            for i, agent in enumerate(self.possible_agents)
        }
        state = self.aviary.global_state
        self.state_space = Box(state.low, state.high, dtype=np.float32)

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the agent's observation space, the same object each time."""
        return find_choice("agent", agent, self.observation_spaces)

    def action_space(self, agent: str) -> Space[Any]:
        """Return the agent's action space, the same object each time."""
        return find_choice("agent", agent, self.action_spaces)

    @property
    def np_random(self) -> np.random.Generator:
        """Random generator of the episode, for wrappers such as SuperSuit's frame skip.

        The numbers that they draw also follow from the seed, and the generator is part of the saved
        state.

        Raises:
            RuntimeError: If called before the first reset or after `close`.
        """
        self.aviary.require_started()
        return self.aviary.rng[0]

    @exclusive
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, InfosByAgent]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers; None continues them.
            options: Any of "start", "goal", "velocity", "quaternion", "rates" and "charge", which
                are set instead of drawn; see `Aviary.reset`.

        Returns:
            Observations and infos, by agent.
        """
        observations = self.aviary.reset(seeds=seed, **reset_options(options))
        flies = self.aviary.alive[0].tolist()
        self.agents = [one for one, row in self._rows.items() if flies[row]]
        rows = self._living_rows()
        first = self.aviary.first_info()
        infos = self._infos(lambda: first, rows)
        return self._by_agent(observations, rows), infos

    @exclusive
    def step(self, actions: dict[str, np.ndarray]) -> AgentResults:
        """Simulate one decision of all active agents.

        Args:
            actions: An action for each of `agents`; those of agents that have left are ignored.

        Returns:
            Observations, rewards, terminated, truncated and infos, by agent, of those that flew. If
            all have left, five empty dicts.

        Raises:
            ValueError: If an action is missing, invalid, or for an unknown agent. Nothing is
                simulated then.
            RuntimeError: If called before the first reset or after `close`.
        """
        aviary, agents = self.aviary, self.agents
        aviary.require_started()
        rows = None if len(agents) == len(self.possible_agents) else self._living_rows()
        if not self._together or not take(actions, agents, rows, aviary.given):
            self._take(actions)
        if not agents:
            return {}, {}, {}, {}, {}
        aviary.decide()
        observations, ends = aviary.observations(), (aviary.terminated, aviary.truncated)
        shared = ends[0] if isinstance(observations, dict) else observations
        results = share(agents, rows, shared, aviary.rewards, *ends)
        seen, rewards, terminated, truncated, any_ended = results
        if isinstance(observations, dict):
            seen = self._by_agent(observations, rows)
        elif self._is_padded:
            seen = self._unpadded(seen)
        infos = self._infos(aviary.info_table(), rows)
        # Agents leave after the step that ended their episode
        if any_ended:
            self.agents = [one for one in agents if not terminated[one] and not truncated[one]]
        return seen, rewards, terminated, truncated, infos

    def _living_rows(self) -> list[int] | None:
        """Return the rows of the active agents in the batch; None for all."""
        if len(self.agents) == len(self.possible_agents):
            return None
        return [self._rows[agent] for agent in self.agents]

    def _take(self, actions: Any) -> None:
        """Check and copy actions one by one.

        Raises:
            ValueError: If actions are invalid.
        """
        given, agents = self.aviary.given, self.agents
        check_agents(actions, agents, self._rows)
        for agent in agents:
            row = self._rows[agent]
            given[0, row] = drone_numbers(self.aviary.action, row, actions[agent])

    def require_action(self, agent: str, action: Any) -> None:
        """Raise ValueError for an invalid action of an agent."""
        row = self._rows[agent]
        self.aviary.require_action(row, drone_numbers(self.aviary.action, row, action))

    def _by_agent(self, observations: Observation, rows: list[int] | None) -> ByAgent:
        """Split observations (1, N, ...) by active agent."""
        if isinstance(observations, dict):
            return {agent: part(observations, (0, self._rows[agent])) for agent in self.agents}
        seen = dict(zip(self.agents, _rows_of(observations, rows), strict=True))
        return self._unpadded(seen) if self._is_padded else seen

    def _unpadded(self, seen: ByAgent) -> ByAgent:
        """Cut padded vectors to the numbers that each agent observes."""
        observer = self.aviary.observer
        return {agent: observer.unpadded(one, self._rows[agent]) for agent, one in seen.items()}

    def _infos(
        self, make_infos: Callable[[], dict[str, np.ndarray]], rows: list[int] | None
    ) -> InfosByAgent:
        """Split infos (1, N) by active agent."""
        agents = self.agents

        def make() -> InfosByAgent:
            info = dict(make_infos())
            masks = info.pop(ACTION_MASK, None)
            living = [_rows_of(array, rows) for array in info.values()]
            table = np.array(living, dtype=float).T.tolist()
            by_agent: InfosByAgent = {
                agent: dict(zip(info, row, strict=True))
                for agent, row in zip(agents, table, strict=True)
            }
            if masks is not None:
                for agent, mask in zip(agents, _rows_of(masks, rows), strict=True):
                    by_agent[agent][ACTION_MASK] = mask
            return by_agent

        return lazy_infos(make)

    @exclusive
    def set_condition(self, agents: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight, from the next decision on.

        Args:
            agents: Name of an agent, several names, or None for all.
            **changes: See `Aviary.set_condition`, like the errors.
        """
        rows = None
        if agents is not None:
            listed = [agents] if isinstance(agents, str) else as_sequence("agents", agents)
            rows = [find_choice("agent", agent, self._rows) for agent in listed]
        self.aviary.set_condition(rows, **changes)

    @exclusive
    def save_state(self) -> Snapshot:
        """Save the complete state; see `Aviary.save_state`."""
        return self.aviary.save_state()

    @exclusive
    def load_state(self, snapshot: Snapshot) -> ByAgent:
        """Restore a saved state; see `Aviary.load_state`.

        Returns:
            Observations by agent, of those that fly.
        """
        observations = self.aviary.load_state(snapshot)
        flies = self.aviary.alive[0]
        self.agents = [one for one, row in self._rows.items() if flies[row]]
        return self._by_agent(observations, self._living_rows())

    @exclusive
    def state_hash(self) -> str:
        """Compute a hash of the state; see `Aviary.state_hash`."""
        return self.aviary.state_hash()[0]

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state for centralised critics.

        Returns:
            (K,) float32; see `Aviary.state`.
        """
        state: np.ndarray = self.aviary.state()[0]
        return state

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


def _rows_of(array: np.ndarray, rows: list[int] | None) -> np.ndarray:
    """Return rows of the only world of an array (1, N, ...)."""
    one: np.ndarray = array[0] if rows is None else array[0, rows]
    return one


def check_agents(actions: Any, agents: Sequence[str], possible: Collection[str]) -> None:
    """Check that each agent has an action.

    Args:
        actions: Value of the argument.
        agents: Agents that need an action.
        possible: Agents that may have one.

    Raises:
        ValueError: If actions are not a dict, an agent is missing, or an agent is unknown.
    """
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions are {shown(actions)}: a dict with an action for each of {list(agents)} is "
            f"needed"
        )
    missing = [agent for agent in agents if agent not in actions]
    if len(actions) > len(agents) or missing:
        for agent in actions:
            if agent not in possible:
                raise unknown("agent in actions:", agent, possible)
    if missing:
        raise ValueError(f"actions lack {missing}: give one for each of {list(agents)}")


def parallel_env(task: TaskSource, **options: Any) -> ParallelAviary:
    """Create a `pettingzoo.ParallelEnv` of a task, with agents `drone_0` ... `drone_{N-1}`.

    Args:
        task: A name from `list_tasks()`, `module:Name`, or a task class.
        **options: Options common to all tasks (`bulletuav.envs.options.EnvOptions`) and those of
            the task (its `Config`).

    Returns:
        The environment.

    Raises:
        ValueError: If an option is invalid; the message names the value and the remedy.
    """
    return ParallelAviary(task, **options)


TURN_FIELDS = (
    *("agents", "_live_agents", "_actions", "_agent_selector", "agent_selection", "new_agents"),
    *("new_values", "_observations", "rewards", "_cumulative_rewards", "terminations"),
    *("truncations", "infos", "_skip_agent_selection"),
)
"""Attributes in which PettingZoo's conversion stores the turns since the last decision"""


class TurnAviary(LabelledEnvironment, OrderEnforcingWrapper):  # type: ignore[misc]  # has no types
    """`pettingzoo.AECEnv` of one task, whose agents take turns; by PettingZoo's own conversion."""

    def __init__(self, task: TaskSource, **options: Any) -> None:
        """Create the environment; see `parallel_env`."""
        parallel = ParallelAviary(task, **options)
        super().__init__(parallel_to_aec_wrapper(parallel))
        self._parallel, self._observer = parallel, parallel.aviary.observer

    @exclusive
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        """Start a new episode; see `ParallelAviary.reset`."""
        super().reset(seed, options)

    @exclusive
    def step(self, action: Any) -> None:
        """Store the action of the selected agent; the last agent's action starts the simulation.

        Raises:
            ValueError: If the action is invalid; the agent remains selected.
            RuntimeError: If called before the first reset or after `close`.
        """
        self._parallel.aviary.require_started()
        agent = self.agent_selection
        if agent in self.agents and not (self.terminations[agent] or self.truncations[agent]):
            # PettingZoo cannot undo it once all agents had their turns
            self._parallel.require_action(agent, action)
        super().step(action)

    @exclusive
    def observe(self, agent: str) -> Any:
        """Return a copy of the agent's last observation, as PettingZoo keeps the original."""
        return copy.deepcopy(super().observe(agent))

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state; see `ParallelAviary.state`."""
        return self._parallel.state()

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render the world; see `ParallelAviary.render`."""
        return self._parallel.render()

    @exclusive
    def close(self) -> None:
        """Free the engine. Further calls do nothing."""
        super().close()

    @exclusive
    def set_condition(self, agents: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `ParallelAviary.set_condition`."""
        self._parallel.set_condition(agents, **changes)

    @exclusive
    def save_state(self) -> EnvironmentSnapshot:
        """Save the complete state with the turns of agents; see `Aviary.save_state`."""
        turn = {name: getattr(self.env, name, None) for name in TURN_FIELDS}
        return EnvironmentSnapshot("aec_env", self._parallel.save_state(), copy.deepcopy(turn))

    @exclusive
    def load_state(self, snapshot: EnvironmentSnapshot) -> None:
        """Restore a saved state; see `Aviary.load_state`."""
        require_environment_snapshot(snapshot, "aec_env", TURN_FIELDS)
        self._parallel.load_state(snapshot.flight)
        for name, value in copy.deepcopy(dict(snapshot.beside)).items():
            setattr(self.env, name, value)
        self._has_reset = self._has_updated = True

    @exclusive
    def state_hash(self) -> str:
        """Compute a hash of the state of the world; see `Aviary.state_hash`."""
        return self._parallel.state_hash()


def aec_env(task: TaskSource, **options: Any) -> TurnAviary:
    """Create a `pettingzoo.AECEnv` of a task; see `parallel_env`."""
    return TurnAviary(task, **options)
