"""Train drones with RLlib's PPO (or APPO) to cross an airspace, and compare with a random policy.

Four drones share one policy. Training uses `point_mass`, which is fast; the evaluation uses
`bullet` with all forces. A line for each iteration shows success and return. The worlds of a runner
are stepped in one batch. Ray writes its files to a temporary folder.

Run it:

    python examples/rllib_ppo.py
    python examples/rllib_ppo.py --algo appo --runners 2
    python examples/rllib_ppo.py --runners 8 --address HOST:6379

With an address it trains on that Ray cluster. Takes about 4 minutes on one core. Needs the extra
`rllib`.
"""

# ruff: noqa: E402 - Ray reads environment variables when it is imported
import argparse
import math
import os
import tempfile
import time
from pathlib import Path
from typing import Any

# Ray writes to HOME; the cache of compiled kernels keeps its folder
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
FOLDER = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
os.environ.update(HOME=FOLDER.name, RAY_USAGE_STATS_ENABLED="0", OMP_NUM_THREADS="1")
os.environ.setdefault("RAY_AUTH_MODE", "disabled")

import ray
import torch
from ray.rllib.algorithms.appo import APPOConfig
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

import bulletuav
from bulletuav.adapters.rllib import (
    DroneMultiAgentEnv,
    connect,
    log_outcomes,
    policies,
    rows_function,
)
from bulletuav.adapters.rllib_vector import BatchEnvRunner

TASK = {"difficulty": "easy", "num_drones": 4}
BATCH = 2048  # decisions of all worlds
# Smaller than the default weights of the task, so that returns are of the order of 1
WEIGHTS = {
    "progress": 0.05,
    "goal": 2.0,
    "conflict": -3.0,
    "warning": -0.1,
    "collision": -5.0,
    "out_of_bounds": -5.0,
    "energy": -0.0005,
    "time": -0.02,
}


def parse_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--algo", choices=("ppo", "appo"), default="ppo")
    parser.add_argument("--iterations", type=int, default=160)
    parser.add_argument("--runners", type=int, default=0, help="number of env runner processes")
    parser.add_argument("--worlds", type=int, default=16, help="worlds of each env runner")
    parser.add_argument("--episodes", type=int, default=50, help="episodes of each evaluation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--address", help="HOST:PORT of a Ray cluster (default: this machine)")
    return parser.parse_args()


def configure(args: argparse.Namespace) -> Any:
    """Return the configuration of the algorithm."""
    made = {"ppo": PPOConfig, "appo": APPOConfig}[args.algo]()
    env_config = {
        "task": "crossing",
        "dynamics": "point_mass",
        "weights": WEIGHTS,
        "symlog": True,
        **TASK,
    }
    falling = [[0, 1e-3], [args.iterations * BATCH, 1e-5]]
    config = (
        made.environment(DroneMultiAgentEnv, env_config=env_config)
        .env_runners(
            env_runner_cls=BatchEnvRunner,
            num_env_runners=args.runners,
            num_envs_per_env_runner=args.worlds,
            rollout_fragment_length=64,
        )
        .learners(num_learners=0)
        .multi_agent(**policies("crossing", by="swarm", **TASK))
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64]))
        .callbacks(on_episode_end=log_outcomes)
        .debugging(seed=args.seed, log_level="ERROR")
        .training(lr=falling, gamma=0.99, train_batch_size_per_learner=BATCH)
    )
    if args.algo == "ppo":
        config.training(lambda_=0.95, minibatch_size=1024, num_epochs=5, use_kl_loss=False)
    return config


def train(algorithm: Any, iterations: int) -> None:
    """Train, and print success and return of training episodes."""
    began = time.perf_counter()
    for k in range(iterations):
        results = algorithm.train()["env_runners"]
        steps = int(results["num_env_steps_sampled_lifetime"])
        seconds = time.perf_counter() - began
        text = f"iteration {k + 1}, {steps} decisions, {seconds:.0f} s"
        # Without finished episodes there are no results
        drone = results.get("episode_return_mean", math.nan) / TASK["num_drones"]
        if math.isfinite(drone):
            text += f": success {results['success']:.2f}, return of a drone {drone:.2f}"
        print(text, flush=True)


def compare(algorithm: Any, args: argparse.Namespace) -> None:
    """Evaluate the trained and a random policy in `bullet`, on seeds not used in training."""
    learned = rows_function(algorithm)
    for name, policy in (("learned", learned), ("random", "random")):
        result = bulletuav.evaluate("crossing", policy, episodes=args.episodes, seed=1000, **TASK)
        estimates = result.estimates()
        rows = (f"{metric} {show(estimates[metric])}" for metric in ("return", "drone_success"))
        print(f"{name}: {', '.join(rows)}")


def show(estimate: Any) -> str:
    """Format a mean with its confidence interval."""
    return f"{estimate.mean:.2f} [{estimate.low:.2f}, {estimate.high:.2f}]"


def main() -> None:
    """Train and compare."""
    args = parse_arguments()
    torch.set_num_threads(1)  # networks this small are no faster on more
    local = {} if args.address else {"_temp_dir": FOLDER.name, "num_cpus": args.runners + 1}
    connect(args.address, log_to_driver=False, **local)
    algorithm = configure(args).build_algo()
    train(algorithm, args.iterations)
    compare(algorithm, args)
    algorithm.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
