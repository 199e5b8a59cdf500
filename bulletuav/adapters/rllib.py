"""Environment for RLlib's new API stack, with correct terminations and truncations.

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
from gymnasium.spaces import Box, Dict, Discrete, Space
from pettingzoo import ParallelEnv

from bulletuav.adapters.self_play import team_env
from bulletuav.envs.action_masks import ACTION_MASK
from bulletuav.envs.curriculum import curriculum_env
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.environment import Environment, exclusive
from bulletuav.envs.options import RENDER_MODES
from bulletuav.envs.parallel import parallel_env
from bulletuav.envs.teams import team_rows
from bulletuav.errors import find_choice, missing_extra, shown
from bulletuav.policies.features import symlog
from bulletuav.tasks import TaskSource

try:
    import ray
    import torch
    from ray.rllib.env.multi_agent_env import MultiAgentEnv
except ImportError:
    raise missing_extra("learning with RLlib", "rllib") from None

__all__ = ["DroneMultiAgentEnv", "connect", "log_outcomes", "policies", "rows_function"]

OBSERVATIONS = "observations"
"""Key of the observation next to the mask, RLlib's convention"""
ALL = "__all__"
"""Key of the end of the whole episode in RLlib's dicts"""
GROUPINGS = {"swarm": "drones", "team": None, "drone": None}
"""Groupings of drones that share a policy, and the name of the policy if there is only one"""
CONNECT_TIMEOUT = 5.0
"""Connection timeout of a cluster, s"""


class DroneMultiAgentEnv(Environment, MultiAgentEnv):  # type: ignore[misc]  # has no types
    """`ray.rllib.env.MultiAgentEnv` of one task, with agents `drone_0` ... `drone_{N-1}`.

    After its episode has ended, a drone is absent from all dicts. When all drones are done,
    "__all__" in terminated or truncated is True. The horizon is reported under "__all__" only:
    RLlib 2.60 treats an episode whose agents are all truncated one by one as terminated, and would
    not bootstrap its value. Infos are empty except at the end of the episode of a drone, where they
    have "success", "collision", "conflicts" and the return of each reward term of that drone.

    Attributes:
        env: The wrapped environment.
        possible_agents: Names of all agents.
        agents: Names of the active agents; after the last step, those that were active in it.
        observation_spaces: Observation space of each agent.
        action_spaces: Action space of each agent.
        outcome: Infos of the last finished episode, averaged over all drones.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(self, config: Mapping[str, Any]) -> None:
        """Make the environment.

        Args:
            config: The `env_config`. "task" is required. With "stages" (and "up", "down", "window")
                the environment is a `curriculum_env`, with "team" and "opponents" a `team_env`,
                else a `parallel_env`. All other entries are options of these, except "symlog": if
                True, vector observations are compressed by sign(x) ln(1 + |x|). With "action_masks"
                observations are dicts of "observations" and "action_mask", (choices,) float32, as
                RLlib's `ActionMaskingTorchRLModule` reads them.

        Raises:
            ValueError: If there is no task, or an option is invalid.
        """
        options = dict(config)
        task = take_task(options)
        self._symlog = options.pop("symlog", False)
        self._masks = bool(options.get("action_masks", False))
        self.env = _make(task, options)
        self.possible_agents = list(self.env.possible_agents)
        self.agents = self.possible_agents[:]
        self._agent_ids = set(self.possible_agents)
        super().__init__()
        self.render_mode = self.env.render_mode
        self.observation_spaces = {
            agent: self._shown_space(agent) for agent in self.possible_agents
        }
        self.action_spaces = {agent: self.env.action_space(agent) for agent in self.possible_agents}
        self.outcome: dict[str, float] = {}
        self._totals: dict[str, dict[str, float]] = {}

    def _shown_space(self, agent: str) -> Space[Any]:
        space = shown_space(self.env.observation_space(agent), self._symlog)
        return masked_space(space, self.env.action_space(agent)) if self._masks else space

    @exclusive
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start a new episode.

        Args:
            seed: Random seed; None continues the random sequence.
            options: See `ParallelAviary.reset`.

        Returns:
            Observations and empty infos, by agent.
        """
        seen, infos = self.env.reset(seed, options or None)
        self.agents = list(seen)
        self._totals = {agent: {} for agent in seen}
        return self._shown(seen, infos), {agent: {} for agent in seen}

    @exclusive
    def step(
        self, action_dict: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Any]]:
        """Step the environment by one decision.

        Args:
            action_dict: An action for each agent in `agents`.

        Returns:
            Observations, rewards, terminated, truncated and infos of the active agents, by agent.

        Raises:
            ValueError: If an action is invalid.
            RuntimeError: Before the first reset, or after `close`.
        """
        seen, rewards, terminated, truncated, infos = self.env.step(action_dict)
        self._add(infos)
        ended = [agent for agent in seen if agent not in self.env.agents]
        outcomes = {agent: self._totals[agent] if agent in ended else {} for agent in seen}
        over = not self.env.agents
        cut = over and any(truncated.values())
        if over:
            self._compute_outcome()
        self.agents = self.env.agents[:] or self.agents
        terminated = {**terminated, ALL: over and not cut}
        return self._shown(seen, infos), rewards, terminated, {ALL: cut}, outcomes

    def _shown(self, seen: Mapping[str, Any], infos: Mapping[str, Any]) -> dict[str, Any]:
        shown_by_agent = dict(seen)
        if self._symlog:
            shown_by_agent = {agent: compressed(one) for agent, one in seen.items()}
        if self._masks:
            return {
                agent: masked(one, infos[agent][ACTION_MASK])
                for agent, one in shown_by_agent.items()
            }
        return shown_by_agent

    def _add(self, infos: Mapping[str, Mapping[str, float]]) -> None:
        """Add the infos of a step to the totals of the active drones."""
        for agent, info in infos.items():
            total = self._totals[agent]
            for name, value in info.items():
                if name.startswith("reward/") or name == "conflicts":
                    total[name] = total.get(name, 0.0) + value
            total["success"] = info["success"]
            total["collision"] = max(total.get("collision", 0.0), info["collision"])

    def _compute_outcome(self) -> None:
        """Compute the outcome: the mean of the totals over all drones."""
        all_of = list(self._totals.values())
        self.outcome = {
            name: float(np.mean([total[name] for total in all_of])) for name in all_of[0]
        }

    @exclusive
    def render(self) -> np.ndarray | None:
        """Render an image; see `ParallelAviary.render`."""
        picture: np.ndarray | None = self.env.render()
        return picture

    @exclusive
    def close(self) -> None:
        """Disconnect from the physics engine; further calls do nothing."""
        self.env.close()


def compressed(vectors: np.ndarray) -> np.ndarray:
    """Return sign(x) ln(1 + |x|) of each number, as float32."""
    return symlog(vectors).astype(np.float32)


def shown_space(space: Space[Any], is_compressed: bool) -> Space[Any]:
    """Return the observation space that RLlib receives.

    Args:
        space: Observation space of a drone.
        is_compressed: If True, observations are compressed by `compressed`.

    Raises:
        ValueError: If observations to be compressed are not vectors.
    """
    if not is_compressed:
        return space
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(
            f"symlog is for vectors, and a drone observes {shown(space)}: leave it out, or choose "
            f"observation_format='vector' and an observation without images"
        )
    return Box(compressed(space.low), compressed(space.high), dtype=np.float32)


def masked(observation: np.ndarray, mask: np.ndarray) -> dict[str, np.ndarray]:
    """Return the observation (D,) of a drone with the mask (choices,) of its moves."""
    return {ACTION_MASK: mask.astype(np.float32), OBSERVATIONS: observation}


def masked_space(space: Space[Any], action_space: Space[Any]) -> Dict:
    """Return the space of the results of `masked`.

    Raises:
        ValueError: If a drone observes more than a vector, which RLlib's module needs.
    """
    if not isinstance(space, Box) or len(space.shape) != 1:
        raise ValueError(
            f"action_masks with RLlib is for vectors, and a drone observes {shown(space)}: leave "
            f"it out, or choose observation_format='vector' and an observation without images"
        )
    assert isinstance(action_space, Discrete), "masks need a discrete action"
    mask = Box(0.0, 1.0, (int(action_space.n),), dtype=np.float32)
    return Dict({ACTION_MASK: mask, OBSERVATIONS: space})


def take_task(options: dict[str, Any]) -> TaskSource:
    """Remove the task from an `env_config`, and return it.

    Raises:
        ValueError: If there is no task, or there is a seed.
    """
    if "seed" in options:
        raise ValueError(
            "env_config has a seed, which all copies of the environment would share: use "
            "config.debugging(seed=...), from which RLlib derives one for each"
        )
    task: TaskSource | None = options.pop("task", None)
    if task is None:
        raise ValueError("env_config has no task: give one, such as {'task': 'crossing'}")
    return task


def _make(task: TaskSource, options: dict[str, Any]) -> ParallelEnv:
    """Make the environment of an `env_config` without its task."""
    if "stages" in options:
        return curriculum_env(task, **options)
    if "team" in options:
        return team_env(task, **options)
    return parallel_env(task, **options)


def log_outcomes(*, metrics_logger: Any, env: Any, env_index: int, **_: Any) -> None:
    """Log the outcome of an episode, for RLlib's `callbacks(on_episode_end=log_outcomes)`.

    The results of `train` have the means of the last 100 episodes below "env_runners": "success",
    "collision", "conflicts", and the returns of reward terms such as "reward/goal".

    Args:
        metrics_logger: The metrics logger of RLlib.
        env: The vector environment of RLlib.
        env_index: Index of the environment whose episode ended.
        **_: Further arguments of RLlib, which are ignored.
    """
    for name, value in env.envs[env_index].unwrapped.outcome.items():
        metrics_logger.log_value(name, value, reduce="mean", window=100)


def policies(
    task: TaskSource, by: str = "swarm", train: Sequence[str] | None = None, **options: Any
) -> dict[str, Any]:
    """Return the assignment of drones to policies, for `config.multi_agent(**policies(...))`.

    Args:
        task: The task, as in `env_config`.
        by: "swarm": one policy "drones" for all; "team": one for each team, with the name of the
            team; "drone": one for each drone.
        train: Names of the policies that learn; all if None.
        **options: Options of the task, as in `env_config`.

    Returns:
        `policies`, `policy_mapping_fn` and `policies_to_train`.

    Raises:
        ValueError: If the grouping or a policy is unknown, or an option is invalid.
    """
    one = find_choice("by", by, GROUPINGS)
    # The task defines the teams; no world is needed
    spec = EnvSpec(task, 1, options)
    kind = spec.task
    if by == "swarm" and len(spec.observer.kinds) > 1:
        raise ValueError(
            "by is 'swarm', and teams observe different blocks: choose by='team', or one "
            "observation for all"
        )
    agents = [f"drone_{i}" for i in range(len(kind.team))]
    # Name of the policy of each agent
    if by == "team":
        rows = team_rows(kind).items()
        names = {agents[i]: team for team, members in rows for i in members}
    else:
        names = {agent: one or agent for agent in agents}
    # Unique names, in the order of the drones
    known = list(dict.fromkeys(names.values()))
    chosen = (
        known
        if train is None
        else [find_choice("policy", name, {k: k for k in known}) for name in train]
    )
    return {
        "policies": set(known),
        "policy_mapping_fn": functools.partial(_policy_of, names),
        "policies_to_train": chosen,
    }


def _policy_of(names: Mapping[str, str], agent_id: str, episode: Any, **_: Any) -> str:
    """Return the name of the policy of an agent."""
    return names[agent_id]


def rows_function(algorithm: Any, policy: str = "drones") -> Callable[[np.ndarray], np.ndarray]:
    """Return a function from observations to actions of a policy that RLlib trains.

    `bulletuav.evaluate`, `find_policy` and `team_env` accept it as a policy. It returns the most
    likely action of the current weights, without masks.

    Args:
        algorithm: RLlib algorithm with `DroneMultiAgentEnv`.
        policy: Name of the policy.

    Returns:
        Function from (M, D) observations to (M, A) actions, or (M,) discrete actions.

    Raises:
        ValueError: If the policy is unknown, or recurrent.
    """
    names = list(algorithm.config.policies)
    module = algorithm.get_module(find_choice("policy", policy, {name: name for name in names}))
    if module.is_stateful():
        raise ValueError(
            f"policy {policy!r} is recurrent: only policies without memory are supported"
        )
    is_compressed = algorithm.config.env_config.get("symlog", False)
    kind = module.get_inference_action_dist_cls()
    space = module.action_space
    has_masks = algorithm.config.env_config.get("action_masks", False)

    def rows(observations: np.ndarray) -> np.ndarray:
        seen = compressed(observations) if is_compressed else observations
        observed: Any = torch.as_tensor(seen)
        if has_masks:
            observed = {
                ACTION_MASK: torch.ones(len(seen), int(space.n)),
                OBSERVATIONS: observed,
            }
        with torch.no_grad():
            outputs = module.forward_inference({"obs": observed})
        likely = kind.from_logits(outputs["action_dist_inputs"]).to_deterministic().sample().numpy()
        if not isinstance(space, Box):
            return np.asarray(likely)
        # The output of the network is in [-1, 1], whatever the bounds of the action
        share = (np.clip(likely, -1.0, 1.0) + 1.0) / 2.0
        return np.asarray(space.low + share * (space.high - space.low))

    return rows


def connect(address: str | None = None, **options: Any) -> None:
    """Connect to a Ray cluster, or start Ray on this machine, without a dashboard.

    Args:
        address: "HOST:PORT" of the head node, "auto" for a cluster of this machine, or None.
        **options: Further arguments of `ray.init`.

    Raises:
        ValueError: If the address is invalid.
        ConnectionError: If no cluster answers at the address.
    """
    if address is None:
        ray.init(include_dashboard=False, **options)
        return
    remedy = (
        "start its head by `ray start --head --port=6379` and give HOST:6379, or no address to run "
        "on this machine alone"
    )
    if address != "auto":
        _require_connection(address, remedy)
    try:
        ray.init(address=address, **options)
    except ConnectionError:
        raise ConnectionError(f"there is no Ray cluster at {address!r}: {remedy}") from None


def _require_connection(address: str, remedy: str) -> None:
    """Raise ConnectionError if nothing listens at HOST:PORT; Ray itself waits for a minute."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit():
        raise ValueError(f"address is {shown(address)}: HOST:PORT or 'auto' is needed; {remedy}")
    with contextlib.suppress(OSError), socket.create_connection((host, int(port)), CONNECT_TIMEOUT):
        return
    raise ConnectionError(f"there is no Ray cluster at {address!r}: {remedy}")
