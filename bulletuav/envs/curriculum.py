"""Curriculum: difficulty follows the success rate, as a PettingZoo environment that any trainer can use."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv

from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.parallel import ParallelAviary, check_agents
from bulletuav.envs.spaces import drone_action_space
from bulletuav.errors import as_int, as_sequence, choose, finite, shown
from bulletuav.tasks import TaskSource

MOST_STAGES, MOST_WINDOW = 100, 1_000_000
DIFFICULTIES = tuple({"difficulty": name} for name in ("easy", "medium", "hard", "extreme"))


class Curriculum:
    """Which of `count` stages to fly.

    One up when the success rate of the last `window` episodes is `up` or more, one down when it is below `down`; the window
    starts anew at each change.
    """

    def __init__(self, count: int, up: float = 0.8, down: float = 0.2, window: int = 20):
        """Raises ValueError for rates or a window that cannot be."""
        self.count, self.window = (
            as_int("stages", count, 1, MOST_STAGES),
            as_int("window", window, 1, MOST_WINDOW),
        )
        self.up, self.down = finite("up", up), finite("down", down)
        if not 0 <= self.down < self.up <= 1:
            raise ValueError(
                f"down {self.down:g} and up {self.up:g}: 0 <= down < up <= 1 is needed"
            )
        self.stage = 0
        self._recent: deque[float] = deque(maxlen=self.window)

    @property
    def success_rate(self) -> float:
        """Of the episodes in the window, NaN before the first."""
        return float(np.mean(self._recent)) if self._recent else np.nan

    def record(self, success: float) -> None:
        """Take the success of an episode at this stage, from 0 to 1."""
        self._recent.append(success)
        if len(self._recent) < self.window:
            return
        rate = self.success_rate
        step = int(rate >= self.up and self.stage + 1 < self.count) - int(
            rate < self.down and self.stage > 0
        )
        if step:
            self.stage += step
            self._recent.clear()

    def state(self) -> dict[str, Any]:
        """Where it stands, for `restore`."""
        return {"stage": self.stage, "recent": list(self._recent)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`."""
        self.stage = state["stage"]
        self._recent = deque(state["recent"], maxlen=self.window)


class CurriculumAviary(Environment, ParallelEnv):
    """`pettingzoo.ParallelEnv` whose episodes come from the stage that `curriculum` says; infos tell it as "stage".

    Agents are those of the largest stage; in smaller ones the last of them do not take part. Observation spaces are as wide
    as the widest stage's, states are padded with zeros. An episode's success is the share of its drones that succeeded.
    """

    def __init__(
        self,
        task: TaskSource,
        stages: Sequence[Mapping[str, Any]],
        curriculum: Curriculum,
        **options: Any,
    ):
        """`stages`: options of each, easiest first, beside the common ones. Raises ValueError where their spaces differ."""
        self._task, self.curriculum = task, curriculum
        self._options = [{**options, **stage} for stage in stages]
        plans = [EnvSpec(task, 1, stage) for stage in self._options]
        self._widest = max(plans, key=lambda plan: plan.options.num_drones)
        self.observation = common_observation(plans)
        drones = self._widest.options.num_drones
        self.possible_agents = [f"drone_{i}" for i in range(drones)]
        self.agents: list[str] = []
        self.observation_spaces = dict.fromkeys(self.possible_agents, self.observation)
        self.action_spaces = {
            agent: drone_action_space(self._widest.action, i)
            for i, agent in enumerate(self.possible_agents)
        }
        self.metadata = {
            "name": f"bulletuav_{plans[0].task.name}_curriculum_v0",
            "render_modes": ["rgb_array", "human"],
        }
        self._made: dict[int, ParallelAviary] = {}
        self._successes: dict[str, float] = {}
        self._rng = np.random.default_rng(plans[0].options.seed)
        self._current: ParallelAviary | None = None
        self.render_mode = plans[0].options.render_mode

    @property
    def env(self) -> ParallelAviary:
        """The environment of the episode that goes on. Raises RuntimeError before the first reset."""
        if self._current is None:
            raise RuntimeError("the environment has not been started: call reset() first")
        return self._current

    def observation_space(self, agent: str) -> Space:
        """The agent's observation space, the same object each time."""
        return choose("agent", agent, self.observation_spaces)

    def action_space(self, agent: str) -> Space:
        """The agent's action space, the same object each time."""
        return choose("agent", agent, self.action_spaces)

    @exclusive
    def reset(self, seed: int | None = None, options: dict | None = None) -> tuple[dict, dict]:
        """Start a new episode, of another stage if the last ones ask for it.

        With `seed`, or the option of that name, all later ones follow from it and from the stage, which stays.
        """
        if self._successes and not self.agents:  # an episode that was left early tells nothing
            self.curriculum.record(float(np.mean(list(self._successes.values()))))
        self._successes = {}
        if seed is not None:
            self._rng = np.random.default_rng(as_int("seed", seed, 0))
        stage = self.curriculum.stage
        if stage not in self._made:
            self._made[stage] = ParallelAviary(self._task, **self._options[stage])
        self._current = self._made[stage]
        observations, infos = self.env.reset(seed=int(self._rng.integers(2**31)))
        self.agents = self.env.agents[:]
        return observations, self._with_level(infos)

    @exclusive
    def step(self, actions: dict[str, np.ndarray]) -> tuple[dict, dict, dict, dict, dict]:
        """As `ParallelAviary.step`; actions of agents that take no part in this stage are not looked at."""
        env = self.env
        env.aviary.require_started()
        check_agents(actions, self.agents, self.possible_agents)
        actions = {agent: action for agent, action in actions.items() if agent in self.agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        self._successes |= {agent: info["success"] for agent, info in infos.items()}
        self.agents = self.env.agents[:]
        return observations, rewards, terminated, truncated, self._with_level(infos)

    def _with_level(self, infos: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
        return {
            agent: {**info, "stage": float(self.curriculum.stage)} for agent, info in infos.items()
        }

    def state(self) -> np.ndarray:
        """Global state as `ParallelAviary.state`, with zeros for drones that the stage has not."""
        state = self.env.state()
        drones = len(self.possible_agents)
        padded = np.zeros(len(self._widest.state_observer.labels) * drones, dtype=np.float32)
        padded[: state.size] = state
        return padded

    def render(self) -> np.ndarray | None:
        """A picture of the episode that goes on."""
        return self.env.render()

    @exclusive
    def close(self) -> None:
        """Free the engines; a second call does nothing."""
        for env in self._made.values():
            env.close()


def common_observation(plans: Sequence[EnvSpec]) -> Space:
    """The space that holds the observations of all. Raises ValueError where they differ in more than their bounds."""
    spaces = [plan.observer.space() for plan in plans]
    if len(spaces) == 1:
        return spaces[0]
    if not all(isinstance(space, Box) and space.shape == spaces[0].shape for space in spaces):
        raise ValueError(
            f"the stages' observations have shapes {[space.shape for space in spaces]}: choose vectors whose size does not "
            f"depend on the number of drones, such as 'neighbours' instead of 'all_neighbours' and 'identity'"
        )
    if len({plan.action.name for plan in plans}) > 1:
        raise ValueError(
            f"the stages' actions are {[plan.action.name for plan in plans]}: one kind for all is needed"
        )
    return Box(
        np.min([plan.observer.low for plan in plans], axis=0),
        np.max([plan.observer.high for plan in plans], axis=0),
    )


def check_stages(stages: Any) -> None:
    """Raise ValueError unless stages are a list of dicts of options."""
    listed = as_sequence("stages", stages, most=MOST_STAGES)
    if not all(isinstance(stage, Mapping) for stage in listed):
        raise ValueError(f"stages is {shown(stages)}: a list of names with values is needed")


def curriculum_env(
    task: TaskSource,
    stages: Sequence[Mapping[str, Any]] = DIFFICULTIES,
    up: float = 0.8,
    down: float = 0.2,
    window: int = 20,
    **options: Any,
) -> CurriculumAviary:
    """The task as a PettingZoo environment that grows harder with success; see `Curriculum` and `CurriculumAviary`.

    `stages`: options of each stage, easiest first, by default the difficulties; `options` are common to all.
    """
    check_stages(stages)
    return CurriculumAviary(task, stages, Curriculum(len(stages), up, down, window), **options)
