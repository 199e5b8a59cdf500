"""The PettingZoo face: one world, agents `drone_0` ... that leave when their episode ends."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec_wrapper
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from bulletuav.envs.aviary import Aviary
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.spaces import drone_action_space, drone_numbers
from bulletuav.errors import choose, shown, unknown
from bulletuav.tasks import TaskSource
from bulletuav.tasks.observations.observer import Observation, part


class ParallelAviary(Environment, ParallelEnv):
    """`pettingzoo.ParallelEnv` of one task; `aviary` is the batched core with W = 1."""

    def __init__(self, task: TaskSource, **options: Any):
        self.aviary = Aviary(task, 1, **options)
        settings = self.aviary.options
        self.metadata = {
            "name": f"bulletuav_{self.aviary.task.name}_v0",
            "render_modes": ["rgb_array", "human"],
            "render_fps": settings.decision_hz,
            "is_parallelizable": True,
        }
        self.render_mode = settings.render_mode
        self.possible_agents = [f"drone_{i}" for i in range(settings.num_drones)]
        self.agents: list[str] = []
        observer, action, state = (
            self.aviary.observer,
            self.aviary.action,
            self.aviary.state_observer,
        )
        self.observation_spaces = {agent: observer.space() for agent in self.possible_agents}
        self.action_spaces = {
            agent: drone_action_space(action, i) for i, agent in enumerate(self.possible_agents)
        }
        drones = settings.num_drones
        self.state_space = Box(
            np.tile(state.low, drones), np.tile(state.high, drones), dtype=np.float32
        )

    def observation_space(self, agent: str) -> Space:
        """The agent's observation space, the same object each time."""
        return choose("agent", agent, self.observation_spaces)

    def action_space(self, agent: str) -> Space:
        """The agent's action space, the same object each time."""
        return choose("agent", agent, self.action_spaces)

    @exclusive
    def reset(self, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start a new episode; returns observations and infos by agent. `options` is PettingZoo's and not read."""
        observations = self.aviary.reset(seeds=seed)
        self.agents = self.possible_agents[:]
        return self._by_agent(observations), self._infos(self.aviary.first_info())

    @exclusive
    def step(self, actions: dict[str, np.ndarray]) -> tuple[dict, dict, dict, dict, dict]:
        """Fly one decision of all living agents.

        Args:
            actions: One for each of `agents`; those of agents that have left are not looked at.

        Returns:
            Observations, rewards, terminated, truncated and infos, by agent: of those that flew. Where all have left, five
            empty dicts.

        Raises:
            ValueError: An action is missing or bad, or for an agent that there never was; nobody has flown.
            RuntimeError: Before the first reset, or after `close`.
        """
        self.aviary.require_started()
        check_agents(actions, self.agents, self.possible_agents)
        if not self.agents:
            return {}, {}, {}, {}, {}
        batch = np.zeros((1, *self.aviary.action.low.shape))
        for i, agent in enumerate(self.possible_agents):
            if agent in self.agents:
                batch[0, i] = drone_numbers(self.aviary.action, i, actions[agent])
        step = self.aviary.step(batch)
        rewards, terminated, truncated = (
            {agent: kind(value) for agent, value in self._by_agent(array).items()}
            for array, kind in (
                (step.rewards, float),
                (step.terminated, bool),
                (step.truncated, bool),
            )
        )
        result = (
            self._by_agent(step.observations),
            rewards,
            terminated,
            truncated,
            self._infos(step.info),
        )
        self.agents = [
            agent for agent in self.agents if not (terminated[agent] or truncated[agent])
        ]
        return result

    def _by_agent(self, array: Observation) -> dict[str, Any]:
        return {
            agent: part(array, (0, i))
            for i, agent in enumerate(self.possible_agents)
            if agent in self.agents
        }

    def _infos(self, info: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
        columns = {name: self._by_agent(array) for name, array in info.items()}
        return {
            agent: {name: float(column[agent]) for name, column in columns.items()}
            for agent in self.agents
        }

    def state(self) -> np.ndarray:
        """(17 N,) float32 global state for centralised critics; see `Aviary.state`."""
        return self.aviary.state()[0]

    def render(self) -> np.ndarray | None:
        """A picture (height, width, 3) uint8 with render_mode "rgb_array"."""
        return self.aviary.render()

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self.aviary.close()


def check_agents(actions: Any, agents: Sequence[str], possible: Sequence[str]) -> None:
    """Raise ValueError unless `actions` is a dict with all of `agents`, and no others than `possible` ones."""
    if not isinstance(actions, Mapping):
        raise ValueError(
            f"actions are {shown(actions)}: a dict with an action for each of {list(agents)} is needed"
        )
    for agent in actions:
        if agent not in possible:
            raise unknown("agent in actions:", agent, possible)
    missing = [agent for agent in agents if agent not in actions]
    if missing:
        raise ValueError(f"actions lack {missing}: give one for each of {list(agents)}")


def parallel_env(task: TaskSource, **options: Any) -> ParallelAviary:
    """The task as a `pettingzoo.ParallelEnv` with agents `drone_0` ... `drone_{N-1}`.

    `task` is one of `list_tasks()`, or a class of your own; options are those common to all tasks
    (`bulletuav.envs.options.Options`) and the task's own (its `Config`). Raises ValueError that names the value and the
    remedy when one of them cannot be.
    """
    return ParallelAviary(task, **options)


class TurnAviary(Environment, OrderEnforcingWrapper):
    """`pettingzoo.AECEnv` of one task, through PettingZoo's own conversion; agents take turns."""

    def __init__(self, task: TaskSource, **options: Any):
        super().__init__(parallel_to_aec_wrapper(ParallelAviary(task, **options)))

    def observe(self, agent: str) -> Any:
        """A copy of the agent's last observation, which PettingZoo keeps."""
        return copy.deepcopy(super().observe(agent))


def aec_env(task: TaskSource, **options: Any) -> TurnAviary:
    """The task as a `pettingzoo.AECEnv`; see `parallel_env`."""
    return TurnAviary(task, **options)
