"""Curriculum: the difficulty follows the success rate, in an environment for any trainer."""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Space
from pettingzoo import ParallelEnv

from bulletuav.envs.common_spaces import common_labels, common_observation
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import LabelledEnvironment, exclusive
from bulletuav.envs.global_state import slices
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.parallel import (
    AgentResults,
    ByAgent,
    InfosByAgent,
    ParallelAviary,
    check_agents,
)
from bulletuav.envs.reset_options import reset_options
from bulletuav.envs.snapshot import EnvironmentSnapshot, require_environment_snapshot
from bulletuav.envs.spaces import drone_action_space
from bulletuav.envs.viewer import require_single
from bulletuav.errors import as_int, as_sequence, find_choice, finite, shown
from bulletuav.sensors.base import Label
from bulletuav.tasks import TaskSource

MAX_STAGES = 100
MAX_WINDOW = 1_000_000  # episodes
EXTRA_FIELDS = ("flown", "curriculum", "successes", "generator")
"""Fields of a snapshot in addition to the world"""
DIFFICULTIES = tuple({"difficulty": name} for name in ("easy", "medium", "hard", "extreme"))
"""Stages that every task has"""


class Curriculum:
    """The current stage, which follows the success rate of the last episodes.

    The stage goes up by one if the success rate of the last `window` episodes is `up` or more, and
    down by one if it is below `down`. The window is cleared at each change.

    Attributes:
        count: Number of stages.
        stage: Current stage, from 0.
        up: Success rate at which the stage goes up.
        down: Success rate below which the stage goes down.
        window: Number of episodes in the success rate.
    """

    def __init__(self, count: int, up: float = 0.8, down: float = 0.2, window: int = 20) -> None:
        """Start at the first stage.

        Raises:
            ValueError: If numbers are invalid; 0 <= down < up <= 1 is needed.
        """
        self.count = as_int("stages", count, 1, MAX_STAGES)
        self.window = as_int("window", window, 1, MAX_WINDOW)
        self.up = finite("up", up)
        self.down = finite("down", down)
        if not 0 <= self.down < self.up <= 1:
            raise ValueError(
                f"down {self.down:g} and up {self.up:g}: 0 <= down < up <= 1 is needed"
            )
        self.stage = 0
        self._recent: deque[float] = deque(maxlen=self.window)

    @property
    def success_rate(self) -> float:
        """Mean success of the episodes in the window, NaN before the first."""
        return float(np.mean(self._recent)) if self._recent else np.nan

    def __copy__(self) -> "Curriculum":
        """Return an independent copy, with the episodes in the window."""
        again = Curriculum(self.count, self.up, self.down, self.window)
        again.restore(self.state())
        return again

    def record(self, success: float) -> None:
        """Record an episode at the current stage, and change the stage if due.

        Args:
            success: Success of the episode, from 0 to 1.
        """
        self._recent.append(success)
        if len(self._recent) < self.window:
            return
        # At most one of them is true, as down is below up
        rate = self.success_rate
        goes_up = rate >= self.up and self.stage + 1 < self.count
        goes_down = rate < self.down and self.stage > 0
        if goes_up or goes_down:
            self.stage += 1 if goes_up else -1
            self._recent.clear()

    def state(self) -> dict[str, Any]:
        """Return the state of the curriculum, for `restore`."""
        return {"stage": self.stage, "recent": list(self._recent)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state that `state` returned."""
        self.stage = state["stage"]
        self._recent = deque(state["recent"], maxlen=self.window)


class CurriculumAviary(LabelledEnvironment, ParallelEnv):  # type: ignore[misc]  # has no types
    """`pettingzoo.ParallelEnv` whose episodes come from the current stage of a curriculum.

    Infos have the stage as "stage". The agents are those of the largest stage; in smaller ones the
    last agents do not take part. Bounds of observations hold for all stages, and states are padded
    with zeros. The success of an episode is the fraction of its drones that succeeded.

    Attributes:
        curriculum: State of the curriculum.
        possible_agents: Names of the agents of the largest stage.
        agents: Names of the agents whose episode is running.
        observation_spaces: Observation space of each agent.
        action_spaces: Action space of each agent.
        metadata: PettingZoo's metadata.
        render_mode: None, "rgb_array", "human", "web" or "foxglove".
    """

    def __init__(
        self,
        task: TaskSource,
        stages: Sequence[Mapping[str, Any]],
        curriculum: Curriculum,
        **options: Any,
    ) -> None:
        """Check all stages; the environment of each is created when it is first flown.

        Args:
            task: A name from `list_tasks()`, `module:Name`, or a task class.
            stages: Options of each stage in addition to the common ones, easiest first.
            curriculum: Selects the stage.
            **options: Common options; see `parallel_env`.

        Raises:
            ValueError: If an option is invalid, or the spaces of the stages differ.
        """
        self._task = task
        self.curriculum = curriculum
        self._options = [{**options, **stage} for stage in stages]
        specs = [EnvSpec(task, 1, stage) for stage in self._options]
        widest = max(specs, key=lambda spec: spec.options.num_drones)
        self._observer = widest.observer
        self._labels = common_labels(specs)
        # The same observation space for all, action spaces of the drones of the largest stage
        drones = widest.options.num_drones
        self.possible_agents = [f"drone_{i}" for i in range(drones)]
        self.agents: list[str] = []
        self.observation_spaces = dict.fromkeys(self.possible_agents, common_observation(specs))
        self.action_spaces = {
            agent: drone_action_space(widest.action, i)
            for i, agent in enumerate(self.possible_agents)
        }
        # Each part of the state is as wide as in the stage in which it is widest
        sizes: dict[str, int] = {}
        for spec in specs:
            for name, part in spec.state.parts.items():
                sizes[name] = max(sizes.get(name, 0), part.stop - part.start)
        self._parts, self._state_size = slices(sizes), sum(sizes.values())
        self.metadata = {
            "name": f"bulletuav_{specs[0].task.name}_curriculum_v{specs[0].task.version}",
            "render_modes": list(RENDER_MODES),
        }
        self.render_mode = specs[0].options.render_mode
        require_single(self.render_mode, len(specs))
        # The environment of each stage that was flown, and the success of each agent's episode
        self._envs: dict[int, ParallelAviary] = {}
        self._current: ParallelAviary | None = None
        self._closed = False
        self._successes: dict[str, float] = {}
        self._rng = np.random.default_rng(specs[0].options.seed)

    def _require_open(self) -> None:
        if self._closed:
            raise RuntimeError("this environment is closed: make a new one")

    @property
    def env(self) -> ParallelAviary:
        """Environment of the running episode.

        Raises:
            RuntimeError: If called before the first reset or after `close`.
        """
        self._require_open()
        if self._current is None:
            raise RuntimeError("the environment has not been started: call reset() first")
        return self._current

    @property
    def observation_labels(self) -> list[Label]:
        """Name, unit and bounds of each number that one drone observes, for all stages."""
        return list(self._labels)

    def observation_space(self, agent: str) -> Space[Any]:
        """Return the agent's observation space, the same object each time."""
        return find_choice("agent", agent, self.observation_spaces)

    def action_space(self, agent: str) -> Space[Any]:
        """Return the agent's action space, the same object each time."""
        return find_choice("agent", agent, self.action_spaces)

    @exclusive
    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, InfosByAgent]:
        """Start a new episode, at the stage that the curriculum selects.

        Args:
            seed: With a seed, or the option of that name, all later episodes follow from the seed
                and the current stage. None continues the random numbers.
            options: See `ParallelAviary.reset`, for the drones of the stage.

        Returns:
            Observations and infos, by agent.

        Raises:
            RuntimeError: If called after `close`.
        """
        self._require_open()
        reset_options(options)  # before the curriculum and the random numbers change
        # An episode that was abandoned does not count
        if self._successes and not self.agents:
            successes = list(self._successes.values())
            self.curriculum.record(float(np.mean(successes)))
            self._successes = {}
        if seed is not None:
            self._rng = np.random.default_rng(as_int("seed", seed, 0))
        env = self._env_of(self.curriculum.stage)
        observations, infos = env.reset(int(self._rng.integers(2**31)), options)
        # Last: if no start is found, the present episode continues
        self._current, self._successes, self.agents = env, {}, env.agents[:]
        return observations, self._with_stage(infos)

    def _env_of(self, stage: int) -> ParallelAviary:
        """Return the environment of a stage, created on first use."""
        if stage not in self._envs:
            self._envs[stage] = ParallelAviary(self._task, **self._options[stage])
        return self._envs[stage]

    @property
    def np_random(self) -> np.random.Generator:
        """Random generator of the episode; see `ParallelAviary.np_random`."""
        return self.env.np_random

    @exclusive
    def step(self, actions: dict[str, np.ndarray]) -> AgentResults:
        """Simulate one decision of all active agents; see `ParallelAviary.step`.

        Args:
            actions: An action for each of `agents`; those of agents that take no part are ignored.

        Returns:
            Observations, rewards, terminated, truncated and infos, by agent.
        """
        env = self.env
        env.aviary.require_started()
        check_agents(actions, self.agents, self.possible_agents)
        actions = {agent: action for agent, action in actions.items() if agent in self.agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        self._successes |= {agent: info["success"] for agent, info in infos.items()}
        self.agents = env.agents[:]
        return observations, rewards, terminated, truncated, self._with_stage(infos)

    def _with_stage(self, infos: InfosByAgent) -> InfosByAgent:
        stage = float(self.curriculum.stage)
        return {agent: {**info, "stage": stage} for agent, info in infos.items()}

    @exclusive
    def set_condition(self, agents: Any = None, **changes: Any) -> None:
        """Change drones or the wind in flight; see `ParallelAviary.set_condition`."""
        self.env.set_condition(agents, **changes)

    @exclusive
    def save_state(self) -> EnvironmentSnapshot:
        """Save the complete state with the curriculum; see `Aviary.save_state`."""
        env = self.env
        (flown,) = (stage for stage, one in self._envs.items() if one is env)
        beside = {
            "flown": flown,
            "curriculum": self.curriculum.state(),
            "successes": dict(self._successes),
            "generator": self._rng.bit_generator.state,
        }
        return EnvironmentSnapshot("curriculum_env", env.save_state(), beside)

    @exclusive
    def load_state(self, snapshot: EnvironmentSnapshot) -> ByAgent:
        """Restore a saved state at its stage; see `ParallelAviary.load_state`."""
        self._require_open()
        require_environment_snapshot(snapshot, "curriculum_env", EXTRA_FIELDS)
        beside = snapshot.beside
        # A curriculum with fewer stages has no such world
        last = max(beside["flown"], beside["curriculum"]["stage"])
        if last >= self.curriculum.count:
            raise ValueError(
                f"the snapshot is of stage {last}, and this curriculum has "
                f"{self.curriculum.count} stages: load it where the stages are the same"
            )
        # The worlds first: if they raise, the curriculum is unchanged
        env = self._env_of(beside["flown"])
        observations = env.load_state(snapshot.flight)
        self._current, self.agents = env, env.agents[:]
        self.curriculum.restore(beside["curriculum"])
        self._successes = dict(beside["successes"])
        self._rng.bit_generator.state = beside["generator"]
        return observations

    @exclusive
    def state_hash(self) -> str:
        """Compute a hash of the state of the current world; see `Aviary.state_hash`."""
        return self.env.state_hash()

    @exclusive
    def state(self) -> np.ndarray:
        """Return the global state, with zeros for drones that the stage does not have.

        Returns:
            (K,) float32, with each part as wide as in the stage in which it is widest; see
            `Aviary.state`.
        """
        state = self.env.state()
        padded = np.zeros(self._state_size, dtype=np.float32)
        for name, own in self.env.aviary.global_state.parts.items():
            first = self._parts[name].start
            padded[first : first + own.stop - own.start] = state[own]
        return padded

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render the running episode; see `ParallelAviary.render`."""
        return self.env.render()

    @exclusive
    def close(self) -> None:
        """Free the engines. Further calls do nothing."""
        self._closed = True
        for env in self._envs.values():
            env.close()


def check_stages(stages: Any) -> None:
    """Check that stages are a list of dicts of options.

    Raises:
        ValueError: If they are not.
    """
    listed = as_sequence("stages", stages, most=MAX_STAGES)
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
    """Create a `pettingzoo.ParallelEnv` of a task whose difficulty follows the success rate.

    Args:
        task: A name from `list_tasks()`, `module:Name`, or a task class.
        stages: Options of each stage, easiest first; by default the difficulties.
        up: Success rate at which the stage goes up.
        down: Success rate below which the stage goes down.
        window: Number of episodes in the success rate; see `Curriculum`.
        **options: Options common to all stages; see `parallel_env`.

    Returns:
        The environment; infos contain the stage.

    Raises:
        ValueError: If an option is invalid, or the spaces of the stages differ.
    """
    check_stages(stages)
    curriculum = Curriculum(len(stages), up=up, down=down, window=window)
    return CurriculumAviary(task, stages, curriculum, **options)
