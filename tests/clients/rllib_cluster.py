"""RLlib's PPO on clusters of 2 and 4 local nodes while runners and nodes are killed.

A runner is killed by SIGKILL, then a node with all its processes; another node joins, and at last a
second algorithm continues from a checkpoint. Training must collect in each iteration, and lost
runners must return where there is a free CPU. Prints a line of JSON for each cluster.

    python tests/clients/rllib_cluster.py
    python tests/clients/rllib_cluster.py --nodes 4 --iterations 10
"""

import argparse
import json
import os
import signal
import time
from pathlib import Path

import numpy as np
from local_nodes import FOLDER, add_node, kill_node, start_nodes
from ray import get_runtime_context
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

from bulletuav.adapters.rllib import DroneMultiAgentEnv, connect, log_outcomes, policies
from bulletuav.adapters.rllib_vector import BatchEnvRunner

OPTIONS = {"difficulty": "easy", "num_drones": 4, "dynamics": "point_mass", "horizon": 60}
TIMEOUT = 600.0
"""Maximum time until lost runners have returned, s; a start takes a minute on a busy machine"""


def configure(runners):
    """Configure PPO with a number of runners, which are started again after they are lost."""
    return (
        PPOConfig()
        .environment(DroneMultiAgentEnv, env_config={"task": "crossing", "symlog": True, **OPTIONS})
        .env_runners(
            env_runner_cls=BatchEnvRunner,
            num_env_runners=runners,
            num_envs_per_env_runner=4,
            rollout_fragment_length=64,
        )
        .learners(num_learners=0)
        .multi_agent(**policies("crossing", **OPTIONS))
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[32, 32]))
        .training(train_batch_size_per_learner=256 * runners, minibatch_size=256, num_epochs=2)
        .fault_tolerance(restart_failed_env_runners=True)
        .callbacks(on_episode_end=log_outcomes)
        .debugging(seed=0)
    )


def list_runners(algorithm):
    """Return the node and the process of each runner that answers."""
    group = algorithm.env_runner_group
    return list(
        group.foreach_env_runner(
            lambda runner: (get_runtime_context().get_node_id(), os.getpid()),
            local_env_runner=False,
            timeout_seconds=20,
        )
    )


def train_until(algorithm, runners, iterations):
    """Train until a number of runners answer, and return the number of iterations.

    Raises:
        RuntimeError: If an iteration collects nothing, or runners do not return.
    """
    collected = algorithm.metrics.peek(("env_runners", "num_env_steps_sampled_lifetime"), default=0)
    count = answering = 0
    began = time.perf_counter()
    while count < iterations or answering != runners:
        result = algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"]
        answering = algorithm.env_runner_group.num_healthy_remote_workers()
        if result <= collected:
            raise RuntimeError(f"iteration {algorithm.iteration} collected nothing")
        collected, count = result, count + 1
        if time.perf_counter() - began > TIMEOUT:
            raise RuntimeError(f"{answering} runners answer, not {runners}, after {TIMEOUT} s")
    return count


def weights(algorithm):
    """Return the weights of the policy as one array."""
    state = algorithm.get_module("drones").get_state()
    return np.concatenate([np.ravel(array) for _, array in sorted(state.items())])


def fly(count, iterations):
    """Train on a cluster, kill a runner and a node, and return the iterations of each phase."""
    phases = {}
    with start_nodes(count) as (cluster, nodes):
        connect(cluster.address, log_to_driver=False)
        algorithm = configure(count).build_algo()
        try:
            phases["before"] = train_until(algorithm, count, iterations)
            runners = list_runners(algorithm)
            assert len({node for node, _ in runners}) == count, f"runners are on {runners}"
            os.kill(runners[-1][1], signal.SIGKILL)
            phases["runner killed"] = train_until(algorithm, count, iterations)
            # No other node has a free CPU for the lost runner
            kill_node(cluster, nodes[-1])
            phases["node killed"] = train_until(algorithm, count - 1, iterations)
            add_node(cluster)
            phases["node added"] = train_until(algorithm, count, iterations)
            found = {node for node, _ in list_runners(algorithm)}
            assert len(found) == count, f"runners are on {found}"
            phases["restored"] = continue_from_checkpoint(algorithm, count, iterations)
        finally:
            algorithm.stop()
    return phases


def continue_from_checkpoint(algorithm, count, iterations):
    """Stop an algorithm, train another one from its checkpoint, and return the iterations."""
    path = algorithm.save_to_path(str(Path(FOLDER.name, f"checkpoint{count}")))
    last, trained = algorithm.iteration, weights(algorithm)
    algorithm.stop()
    restored = Algorithm.from_checkpoint(path)
    try:
        assert restored.iteration == last
        assert np.array_equal(weights(restored), trained)
        return train_until(restored, count, iterations)
    finally:
        restored.stop()


def main():
    """Train on clusters."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nodes", type=int, nargs="+", default=(2, 4), help="sizes of clusters")
    parser.add_argument("--iterations", type=int, default=2, help="in each phase, at least")
    given = parser.parse_args()
    for count in given.nodes:
        began = time.perf_counter()
        phases = fly(count, given.iterations)
        row = {"nodes": count, "iterations": phases}
        print(json.dumps({**row, "seconds": round(time.perf_counter() - began, 1)}), flush=True)


if __name__ == "__main__":
    main()
