"""Measure the cost of the environments and of trainers' adapters relative to one of them.

    python benchmarks/trainers.py
    python benchmarks/trainers.py --task hover --worlds 64 --dynamics point_mass --rounds 9
    python benchmarks/trainers.py --worlds 1 --drones 1 --dynamics rigid_body --against pettingzoo

Each case flies the same worlds from the same seeds with the same actions, and resets worlds as
they end: the flights are equal, decision by decision. All take turns in one process with one
thread, and the median of the rounds counts. Cases whose library is
not installed are left out, by name.
"""

import argparse
import math
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import bulletuav

Step = Callable[[], int | None]
"""Flies one decision of all worlds, or as many as it returns"""


def random_actions(env: Any) -> np.ndarray:
    """Make actions (W, N, A) float32 for all decisions."""
    shape = (env.num_envs, env.num_drones, *env.action_space.shape)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def batched(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly the batched environment itself."""
    env = bulletuav.batch_env(task, worlds, autoreset_mode="Disabled", **options)
    actions = random_actions(env)
    env.reset(seed=0)

    def step() -> None:
        env.step(actions)
        if (ended := env.ended).any():
            env.reset(options={"reset_mask": ended})

    return step


def pettingzoo(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly PettingZoo's parallel environment, one for each world."""
    envs = [bulletuav.parallel_env(task, **options) for _ in range(worlds)]
    names = envs[0].possible_agents
    space = envs[0].action_spaces[names[0]]
    actions = np.random.default_rng(0).uniform(-1, 1, (worlds, len(names), *space.shape))
    given = [dict(zip(names, own, strict=True)) for own in actions.astype(np.float32)]
    for k, env in enumerate(envs):
        env.reset(seed=k)

    def step() -> None:
        for env, own in zip(envs, given, strict=True):
            env.step(own if len(env.agents) == len(own) else {one: own[one] for one in env.agents})
            if not env.agents:
                env.reset()

    return step


def gymnasium_one(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly Gymnasium's environment, one for each world."""
    from bulletuav.envs.gymnasium import CentralAviary

    envs = [CentralAviary(task, **options) for _ in range(worlds)]
    size = math.prod(envs[0].action_space.shape or ())
    actions = np.random.default_rng(0).uniform(-1, 1, (worlds, size)).astype(np.float32)
    for k, env in enumerate(envs):
        env.reset(seed=k)

    def step() -> None:
        for env, own in zip(envs, actions, strict=True):
            _, _, terminated, truncated, _ = env.step(own)
            if terminated or truncated:
                env.reset()

    return step


def gymnasium_vector(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly Gymnasium's vector environment, which resets in the same step."""
    from gymnasium.vector import AutoresetMode

    from bulletuav.envs.gymnasium import CentralVectorAviary

    env = CentralVectorAviary(task, worlds, AutoresetMode.SAME_STEP, **options)
    shape = env.action_space.shape or ()
    actions = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    env.reset(seed=0)

    def step() -> None:
        env.step(actions)

    return step


def stable_baselines3(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly the vector environment of stable-baselines3."""
    from bulletuav.adapters.sb3 import DroneVecEnv

    env = DroneVecEnv(task, worlds, **options)
    shape = (env.num_envs, *(env.action_space.shape or ()))
    actions = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    env.seed(0)
    env.reset()

    def step() -> None:
        env.step(actions)

    return step


def tensors(env: Any) -> Step:
    """Fly an environment of TorchRL, resets included."""
    import torch

    torch.set_num_threads(1)
    actions = {group: torch.as_tensor(rows) for group, rows in group_actions(env).items()}
    env.set_seed(0)
    flight = [env.reset()]

    def step() -> None:
        for group, rows in actions.items():
            flight[0].set((group, "action"), rows)
        _, flight[0] = env.step_and_maybe_reset(flight[0])

    return step


def group_actions(env: Any) -> dict[str, np.ndarray]:
    """Share the actions of `random_actions` out to groups."""
    everyone = random_actions(env.base_env.batch if hasattr(env, "base_env") else env.batch)
    return {
        group: everyone[:, [int(agent.removeprefix("drone_")) for agent in agents]]
        for group, agents in env.group_map.items()
    }


def torchrl(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly the native environment of TorchRL."""
    from bulletuav.adapters.torchrl import DroneTensorEnv

    return tensors(DroneTensorEnv(task, worlds, **options))


def torchrl_rollout(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly rollouts of TorchRL, one after the other."""
    from bulletuav.adapters.torchrl import DroneTensorEnv

    env = DroneTensorEnv(task, worlds, **options)
    return rollouts(env, group_actions(env))


def torchrl_fixed(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Make rollouts of an environment that copies fixed tensors: what TorchRL itself takes."""
    from torchrl.envs import EnvBase

    from bulletuav.adapters.torchrl import DroneTensorEnv

    flown = DroneTensorEnv(task, worlds, **options)
    first = flown.reset()
    after = flown.rand_step(first.clone())["next"]

    class FixedEnv(EnvBase):
        def _reset(self, tensordict: Any = None, **_: Any) -> Any:
            return first.clone()

        def _step(self, tensordict: Any) -> Any:
            return after.clone()

        def _set_seed(self, seed: int | None) -> None:
            pass

    env = FixedEnv(batch_size=flown.batch_size)
    for name in ("action", "observation", "reward", "done"):
        setattr(env, f"full_{name}_spec", getattr(flown, f"full_{name}_spec").clone())
    return rollouts(env, group_actions(flown))


def rollouts(env: Any, actions: dict[str, np.ndarray]) -> Step:
    """Make rollouts, each of which starts where the one before has ended."""
    import torch

    torch.set_num_threads(1)
    given = {group: torch.as_tensor(rows) for group, rows in actions.items()}

    def policy(tensordict: Any) -> Any:
        for group, rows in given.items():
            tensordict.set((group, "action"), rows)
        return tensordict

    env.set_seed(0)
    flight = [env.reset()]

    def step() -> int:
        flown = env.rollout(
            ROLLED, policy, tensordict=flight[0], auto_reset=False, break_when_any_done=False
        )
        flight[0] = env.step_mdp(flown[:, -1])
        return ROLLED

    return step


def torchrl_state(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly it with the global state."""
    from bulletuav.adapters.torchrl import DroneTensorEnv

    return tensors(DroneTensorEnv(task, worlds, return_state=True, **options))


def benchmarl(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly what BenchMARL collects from: state, info and the transform that sums rewards."""
    from torchrl.envs import TransformedEnv

    from bulletuav.adapters.benchmarl import DroneTask

    flown = DroneTask[task.upper()].get_task(options)
    env = flown.get_env_fun(worlds, continuous_actions=True, seed=0, device="cpu")()
    return tensors(TransformedEnv(env, flown.get_reward_sum_transform(env)))


def pymarl(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly the environment of PyMARL, one for each world, asked for all that its runners ask."""
    from bulletuav.adapters.pymarl import PymarlEnv

    envs = [PymarlEnv(task, "pymarl", symlog=True, **options) for _ in range(worlds)]
    for k, env in enumerate(envs):
        env.reset(seed=k)
    rng = np.random.default_rng(0)
    actions = rng.integers(envs[0].get_total_actions(), size=(worlds, envs[0].n_agents))

    def step() -> None:
        for env, own in zip(envs, actions, strict=True):
            if env.step(own)[1]:
                env.reset()
            env.get_obs(), env.get_state(), env.get_avail_actions()

    return step


def rllib_config(task: str, worlds: int, options: dict[str, Any]) -> Any:
    """Make RLlib's configuration of PPO with one policy for all."""
    from ray.rllib.algorithms.ppo import PPOConfig

    from bulletuav.adapters.rllib import DroneMultiAgentEnv, policies

    return (
        PPOConfig()
        .environment(DroneMultiAgentEnv, env_config={"task": task, "symlog": True, **options})
        .env_runners(num_env_runners=0, num_envs_per_env_runner=worlds)
        .multi_agent(**policies(task, **options))
        .debugging(seed=0)
    )


def dicts(env: Any, worlds: int) -> Step:
    """Fly a vector of environments of RLlib: dicts of agents in, dicts of agents out."""
    agents = list(env.single_action_spaces)
    rng = np.random.default_rng(0)
    shape = (worlds, len(agents), *env.single_action_spaces[agents[0]].shape)
    actions = [
        dict(zip(agents, rows, strict=True))
        for rows in rng.uniform(-1, 1, shape).astype(np.float32)
    ]
    flown = [env.reset(seed=0)[0]]

    def step() -> None:
        given = [
            {agent: own[agent] for agent in seen}
            for own, seen in zip(actions, flown[0], strict=True)
        ]
        seen, _, terminated, truncated, _ = env.step(given)
        # Next, drones act whose episode goes on, and all of a world that starts anew
        flown[0] = [
            {} if ends["__all__"] or cut["__all__"] else [one for one in row if not ends.get(one)]
            for row, ends, cut in zip(seen, terminated, truncated, strict=True)
        ]

    return step


def rllib(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly RLlib's own vector, which steps one world after the other."""
    from ray.rllib.env.vector.sync_vector_multi_agent_env import SyncVectorMultiAgentEnv

    from bulletuav.adapters.rllib import DroneMultiAgentEnv

    config = {"task": task, "symlog": True, **options}
    return dicts(SyncVectorMultiAgentEnv([lambda: DroneMultiAgentEnv(config)] * worlds), worlds)


def rllib_at_once(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Fly the vector whose worlds are flown at once."""
    from bulletuav.adapters.rllib_vector import DroneVectorEnv

    return dicts(DroneVectorEnv({"task": task, "symlog": True, **options}, worlds), worlds)


def rllib_runner(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Collect with RLlib's runner: network, connectors and episodes included."""
    from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner

    return sampler(MultiAgentEnvRunner, rllib_config(task, worlds, options), worlds)


def rllib_runner_at_once(task: str, worlds: int, options: dict[str, Any]) -> Step:
    """Collect with the runner whose worlds are flown at once."""
    from bulletuav.adapters.rllib_vector import BatchEnvRunner

    return sampler(BatchEnvRunner, rllib_config(task, worlds, options), worlds)


def sampler(kind: Any, config: Any, worlds: int) -> Step:
    """Make a runner, whose step collects one decision of all worlds."""
    import torch

    torch.set_num_threads(1)
    runner = kind(config=config)

    def step() -> int:
        runner.sample(num_timesteps=SAMPLED * worlds)
        return SAMPLED

    return step


ROLLED = 64
"""Decisions of a rollout"""
SAMPLED = 16
"""Decisions that a runner collects at a time"""
CASES = {
    "batch_env": batched,
    "pettingzoo": pettingzoo,
    "gymnasium": gymnasium_one,
    "gymnasium,vector": gymnasium_vector,
    "sb3": stable_baselines3,
    "torchrl": torchrl,
    "torchrl, rollout": torchrl_rollout,
    "torchrl, fixed tensors": torchrl_fixed,
    "torchrl, state": torchrl_state,
    "benchmarl": benchmarl,
    "pymarl": pymarl,
    "rllib": rllib,
    "rllib, at once": rllib_at_once,
    "rllib, runner": rllib_runner,
    "rllib, runner at once": rllib_runner_at_once,
}
"""Function that makes each case, by its name"""


def took(step: Step, decisions: int) -> float:
    """Measure a decision of all worlds, mean of so many, s of CPU time."""
    begin, count = time.process_time(), 0
    while count < decisions:
        count += step() or 1
    return (time.process_time() - begin) / count


def main() -> None:
    """Measure all cases in turn."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="crossing")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--drones", type=int, default=8)
    parser.add_argument("--dynamics", default="bullet")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--decisions", type=int, default=10, help="of each case in each round")
    parser.add_argument("--against", choices=CASES, default="batch_env", help="the reference case")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    given = parser.parse_args()
    options = {"num_drones": given.drones, "dynamics": given.dynamics}
    steps: dict[str, Step] = {}
    for name in dict.fromkeys([given.against, *given.cases]):
        try:
            steps[name] = CASES[name](given.task, given.worlds, options)
        except ImportError as error:
            sys.stdout.write(f"{name} is left out: {error}\n")
    for step in steps.values():
        took(step, given.decisions)  # compiles
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(given.rounds):
        for name, step in steps.items():
            times[name].append(took(step, given.decisions))
    drones = given.worlds * given.drones
    sys.stdout.write(f"| case | us | decisions of drones / CPU-s | time of {given.against} |\n")
    sys.stdout.write("|---|---:|---:|---:|\n")
    for name, own in times.items():
        # Against the case of the same round, as the machine's speed changes
        ratios = [one / base for one, base in zip(own, times[given.against], strict=True)]
        middle = statistics.median(own)
        sys.stdout.write(
            f"| {name} | {1e6 * middle:.4g} | {drones / middle:.4g} | "
            f"{statistics.median(ratios):.2f} |\n"
        )


if __name__ == "__main__":
    main()
