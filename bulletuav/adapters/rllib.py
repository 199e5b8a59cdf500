"""Environment of RLlib's new API stack: agents in order, and ends that are taken for what they are.

config = (
    PPOConfig()
    .environment(DroneMultiAgentEnv, env_config={"task": "crossing", "num_drones": 4})
    .multi_agent(**policies("crossing", by="swarm"))
    .callbacks(on_episode_end=log_outcomes)
)
"""

import contextlib
import functools
import socket
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from pettingzoo import ParallelEnv

from bulletuav.adapters.self_play import team_env
from bulletuav.envs.curriculum import curriculum_env
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.parallel import parallel_env
from bulletuav.envs.teams import team_rows
from bulletuav.errors import choose, missing, shown
from bulletuav.policies.features import symlog
from bulletuav.tasks import TaskSource

try:
    import ray
    import torch
    from ray.rllib.env.multi_agent_env import MultiAgentEnv
except ImportError:
    raise missing("learning with RLlib", "rllib") from None

__all__ = ["DroneMultiAgentEnv", "connect", "log_outcomes", "policies", "rows_function"]

ALL = "__all__"
"""Key under which RLlib is told that an episode is over"""
KINDS = {"swarm": "drones", "team": None, "drone": None}
"""Who shares a policy, and the policy's name where there is but one"""
CONNECT_TIMEOUT = 5.0
"""Time within which a cluster must answer, s"""


class DroneMultiAgentEnv(Environment, MultiAgentEnv):  # type: ignore[misc]  # has no types
    """`ray.rllib.env.MultiAgentEnv` of one task, with agents `drone_0` ... `drone_{N-1}`.

    Of a drone whose episode ended nothing is told any more. When all are done, terminated or
    truncated say so under "__all__". The horizon is told under that key alone: RLlib 2.60 takes an
    episode for terminated whose agents are all truncated one by one, and learns that nothing comes
    after. Infos are empty, but where a drone's episode ends: then they tell it "success",
    "collision", "conflicts" and the return of each reward term.

    Attributes:
        env: The environment that it is made from.
        possible_agents: Names of all agents.
        agents: Names of the agents whose episode goes on; after the last step, of those that flew.
        observation_spaces: Observation space of each agent.
        action_spaces: Action space of each agent.
        outcome: What the infos told of the episode that ended last, the mean of all drones.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(self, config: Mapping[str, Any]) -> None:
        """Make the environment.

        Args:
            config: What stands in `env_config`. "task" is needed. With "stages" (and "up", "down",
                "window") it is a `curriculum_env`, with "team" and "opponents" a `team_env`, else
                a `parallel_env`. All others are options of these, and "symlog": whether vectors
                that drones observe are compressed by sign(x) ln(1 + |x|).

        Raises:
            ValueError: There is no task, or an option cannot be.
        """
        options = dict(config)
        task = take_task(options)
        self._symlog = options.pop("symlog", False)
        self.env = _make(task, options)
        self.possible_agents = list(self.env.possible_agents)
        self.agents = self.possible_agents[:]
        self._agent_ids = set(self.possible_agents)
        super().__init__()
        self.render_mode = self.env.render_mode
        self.observation_spaces = {
            agent: shown_space(self.env.observation_space(agent), self._symlog)
            for agent in self.possible_agents
        }
        self.action_spaces = {agent: self.env.action_space(agent) for agent in self.possible_agents}
        self.outcome: dict[str, float] = {}
        self._totals: dict[str, dict[str, float]] = {}

    @exclusive
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Seed of the random numbers; None goes on with them.
            options: See `ParallelAviary.reset`.

        Returns:
            Observations and empty infos, by agent.
        """
        seen, _ = self.env.reset(seed, options or None)
        self.agents = list(seen)
        self._totals = {agent: {} for agent in seen}
        return self._shown(seen), {agent: {} for agent in seen}

    @exclusive
    def step(
        self, action_dict: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Fly one decision.

        Args:
            action_dict: An action for each of `agents`.

        Returns:
            Observations, rewards, terminated, truncated and infos, by agent, of those that flew.

        Raises:
            ValueError: An action cannot be.
            RuntimeError: Before the first reset, or after `close`.
        """
        seen, rewards, terminated, truncated, infos = self.env.step(action_dict)
        self._add(infos)
        ended = [agent for agent in seen if agent not in self.env.agents]
        told = {agent: self._totals[agent] if agent in ended else {} for agent in seen}
        over = not self.env.agents
        cut = over and any(truncated.values())
        if over:
            self._conclude()
        self.agents = self.env.agents[:] or self.agents
        terminated = {**terminated, ALL: over and not cut}
        return self._shown(seen), rewards, terminated, {ALL: cut}, told

    def _shown(self, seen: Mapping[str, Any]) -> dict[str, Any]:
        if not self._symlog:
            return dict(seen)
        return {agent: compressed(one) for agent, one in seen.items()}

    def _add(self, infos: Mapping[str, Mapping[str, float]]) -> None:
        """Add a step to the totals of the drones that flew it."""
        for agent, info in infos.items():
            total = self._totals[agent]
            for name, value in info.items():
                if name.startswith("reward/") or name == "conflicts":
                    total[name] = total.get(name, 0.0) + value
            total["success"] = info["success"]
            total["collision"] = max(total.get("collision", 0.0), info["collision"])

    def _conclude(self) -> None:
        """Work the outcome out of all drones' totals."""
        all_of = list(self._totals.values())
        self.outcome = {
            name: float(np.mean([total[name] for total in all_of])) for name in all_of[0]
        }

    @exclusive
    def render(self) -> np.ndarray | None:
        """Take a picture; see `ParallelAviary.render`."""
        picture: np.ndarray | None = self.env.render()
        return picture

    @exclusive
    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self.env.close()


def compressed(vectors: np.ndarray) -> np.ndarray:
    """Compress vectors by sign(x) ln(1 + |x|), to float32."""
    return symlog(vectors).astype(np.float32)


def shown_space(space: Space[Any], is_compressed: bool) -> Space[Any]:
    """Make the space of what RLlib is shown of observations.

    Args:
        space: Space of a drone's observations.
        is_compressed: Whether they are compressed.

    Raises:
        ValueError: They are to be, and are no vectors.
    """
    if not is_compressed:
        return space
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(
            f"symlog is for vectors, and a drone observes {shown(space)}: leave it out, or choose "
            f"observation_format='vector' and an observation without pictures"
        )
    return Box(compressed(space.low), compressed(space.high), dtype=np.float32)


def take_task(options: dict[str, Any]) -> TaskSource:
    """Take the task out of an `env_config`, which holds the other options then.

    Raises:
        ValueError: There is none, or there is a seed.
    """
    if "seed" in options:
        raise ValueError(
            "env_config has a seed, which all copies of the environment would share: give "
            "config.debugging(seed=...), of which RLlib makes one for each"
        )
    task: TaskSource | None = options.pop("task", None)
    if task is None:
        raise ValueError("env_config has no task: give one, such as {'task': 'crossing'}")
    return task


def _make(task: TaskSource, options: dict[str, Any]) -> ParallelEnv:
    """Make the environment that an `env_config` asks for."""
    if "stages" in options:
        return curriculum_env(task, **options)
    if "team" in options:
        return team_env(task, **options)
    return parallel_env(task, **options)


def log_outcomes(*, metrics_logger: Any, env: Any, env_index: int, **_: Any) -> None:
    """Log how an episode ended, for RLlib's `callbacks(on_episode_end=log_outcomes)`.

    Means of the last 100 episodes are in the results of `train` below "env_runners": "success",
    "collision", "conflicts", and "reward/goal" and the like.

    Args:
        metrics_logger: RLlib's logger.
        env: RLlib's vector of environments.
        env_index: Which of them ended.
        **_: What else RLlib tells.
    """
    for name, value in env.envs[env_index].unwrapped.outcome.items():
        metrics_logger.log_value(name, value, reduce="mean", window=100)


def policies(
    task: TaskSource, by: str = "swarm", train: Sequence[str] | None = None, **options: Any
) -> dict[str, Any]:
    """Say which drones share a policy, for `config.multi_agent(**policies(...))`.

    Args:
        task: The task, as in `env_config`.
        by: "swarm", one policy "drones" for all; "team", one for each team, by its name; or
            "drone", one for each drone.
        train: Names of the policies that learn; all when left out.
        **options: Options of the task, as in `env_config`.

    Returns:
        `policies`, `policy_mapping_fn` and `policies_to_train`.

    Raises:
        ValueError: There is no such grouping or policy, or an option cannot be.
    """
    one = choose("by", by, KINDS)
    # The task tells the teams; no world is made for that
    kind = EnvSpec(task, 1, options).task
    agents = [f"drone_{i}" for i in range(len(kind.team))]
    # The name of the policy of each agent
    if by == "team":
        rows = team_rows(kind).items()
        names = {agents[i]: team for team, members in rows for i in members}
    else:
        names = {agent: one or agent for agent in agents}
    # Each name once, in the order of the drones
    known = list(dict.fromkeys(names.values()))
    chosen = (
        known
        if train is None
        else [choose("policy", name, {k: k for k in known}) for name in train]
    )
    return {
        "policies": set(known),
        "policy_mapping_fn": functools.partial(_policy_of, names),
        "policies_to_train": chosen,
    }


def _policy_of(names: Mapping[str, str], agent_id: str, episode: Any, **_: Any) -> str:
    """Tell RLlib the policy of an agent."""
    return names[agent_id]


def rows_function(algorithm: Any, policy: str = "drones") -> Callable[[np.ndarray], np.ndarray]:
    """Make a function of rows of observations from a policy that RLlib learns.

    `bulletuav.evaluate`, `find_policy` and `team_env` take it as a policy: it does the most likely
    action, as the policy has learned by then.

    Args:
        algorithm: The algorithm, with `DroneMultiAgentEnv`.
        policy: Name of the policy.

    Returns:
        Function from (M, D) observations to (M, A) actions, or (M,) choices.

    Raises:
        ValueError: There is no such policy, or it remembers earlier rows.
    """
    names = list(algorithm.config.policies)
    module = algorithm.get_module(choose("policy", policy, {name: name for name in names}))
    if module.is_stateful():
        raise ValueError(f"policy {policy!r} remembers what it saw: rows have no order for it")
    is_compressed = algorithm.config.env_config.get("symlog", False)
    kind = module.get_inference_action_dist_cls()
    space = module.action_space

    def rows(observations: np.ndarray) -> np.ndarray:
        seen = compressed(observations) if is_compressed else observations
        with torch.no_grad():
            told = module.forward_inference({"obs": torch.as_tensor(seen)})
        likely = kind.from_logits(told["action_dist_inputs"]).to_deterministic().sample().numpy()
        if not isinstance(space, Box):
            return np.asarray(likely)
        # Networks give [-1, 1] for any bounds
        share = (np.clip(likely, -1.0, 1.0) + 1.0) / 2.0
        return np.asarray(space.low + share * (space.high - space.low))

    return rows


def connect(address: str | None = None, **options: Any) -> None:
    """Connect to a Ray cluster, or start Ray on this machine alone, without a dashboard.

    Args:
        address: "HOST:PORT" of the cluster's head, or "auto" for one of this machine.
        **options: Further arguments of `ray.init`.

    Raises:
        ValueError: The address is none.
        ConnectionError: Nobody answers there.
    """
    if address is None:
        ray.init(include_dashboard=False, **options)
        return
    remedy = (
        "start its head by `ray start --head --port=6379` and give HOST:6379, or no address to run "
        "on this machine alone"
    )
    if address != "auto":
        _require_answer(address, remedy)
    try:
        ray.init(address=address, **options)
    except ConnectionError:
        raise ConnectionError(f"there is no Ray cluster at {address!r}: {remedy}") from None


def _require_answer(address: str, remedy: str) -> None:
    """Raise an error where nobody listens, for which Ray would wait for a minute."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise ValueError(f"address is {shown(address)}: HOST:PORT or 'auto' is needed; {remedy}")
    with contextlib.suppress(OSError), socket.create_connection((host, int(port)), CONNECT_TIMEOUT):
        return
    raise ConnectionError(f"there is no Ray cluster at {address!r}: {remedy}")
