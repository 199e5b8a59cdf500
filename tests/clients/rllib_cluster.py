"""RLlib on a cluster of 2 and of 4 nodes, of which one is lost by `kill -9` while it trains.

The nodes are those of Ray's own `Cluster`: each has a raylet, an object store and processes of its
own, on one machine. By hand, as CI has no Ray:

    python tests/clients/rllib_cluster.py
"""

# ruff: noqa: E402 - Ray reads variables when it is imported
import os
import signal
import tempfile
import time
from pathlib import Path

FOLDER = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
os.environ.update(HOME=FOLDER.name, RAY_TMPDIR=FOLDER.name)
os.environ.update(RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0")

import ray
from ray.cluster_utils import Cluster
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

from bulletuav.adapters.rllib import DroneMultiAgentEnv, connect, log_outcomes, policies
from bulletuav.adapters.rllib_vector import BatchEnvRunner

OPTIONS = {"difficulty": "easy", "num_drones": 4, "dynamics": "point_mass", "horizon": 60}
ITERATIONS, MOST = 4, 60
"""Iterations before a runner or a node is lost, and after; most that it takes to come back"""


def configure(runners):
    """Configure PPO with so many runners, which are made anew where they are lost."""
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


def places(algorithm):
    """Name the node of each runner that answers."""
    group = algorithm.env_runner_group
    told = group.foreach_env_runner(
        lambda runner: (ray.get_runtime_context().get_node_id(), os.getpid()),
        local_env_runner=False,
        timeout_seconds=20,
    )
    return list(told)


def train(algorithm, text):
    """Train an iteration, and tell what it collected: all decisions so far, runners that answer."""
    began = time.perf_counter()
    decisions = algorithm.train()["env_runners"]["num_env_steps_sampled_lifetime"]
    runners = algorithm.env_runner_group.num_healthy_remote_workers()
    seconds = time.perf_counter() - began
    print(
        f"  {text}, iteration {algorithm.iteration}: {decisions:.0f} decisions, "
        f"{runners} runners answer, {seconds:.1f} s",
        flush=True,
    )
    return decisions, runners


def train_on(algorithm, text, runners):
    """Train until so many runners answer, and at least `ITERATIONS`; each must collect."""
    before, count, answering = 0, 0, 0
    while count < ITERATIONS or answering != runners:
        decisions, answering = train(algorithm, text)
        assert decisions > before, "nothing was collected"
        before, count = decisions, count + 1
        assert count <= MOST, f"{answering} runners answer, not {runners}"


def fly(nodes):
    """Train on so many nodes with a runner each, lose a node, and train on."""
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, **options()})
    extra = [cluster.add_node(num_cpus=1, **options()) for _ in range(nodes - 1)]
    cluster.wait_for_nodes()
    connect(cluster.address, log_to_driver=False)
    algorithm = configure(nodes).build_algo()
    try:
        told = places(algorithm)
        assert len({node for node, _ in told}) == nodes, f"runners are on {told}"
        print(f"{nodes} nodes: a runner on each, processes {[pid for _, pid in told]}")
        train_on(algorithm, f"{nodes} nodes", nodes)
        # A runner dies: RLlib makes another one in its place
        victim = told[-1][1]
        os.kill(victim, signal.SIGKILL)
        print(f"{nodes} nodes: kill -9 of runner {victim}")
        train_on(algorithm, f"{nodes} nodes", nodes)
        again = places(algorithm)
        assert len({node for node, _ in again}) == nodes, f"runners are on {again}"
        print(f"{nodes} nodes: processes {[pid for _, pid in again]}")
        # A whole node dies, and no other one has room for its runner
        cluster.remove_node(extra[-1], allow_graceful=False)
        print(f"{nodes} nodes: one is killed with all its processes")
        train_on(algorithm, f"{nodes - 1} of {nodes} nodes", nodes - 1)
    finally:
        algorithm.stop()
        ray.shutdown()
        cluster.shutdown()


def options():
    """Give what all nodes need: little memory, and no dashboard."""
    return {"object_store_memory": 100 * 2**20, "include_dashboard": False}


def main():
    """Fly on 2 and on 4 nodes, and see what a missing cluster says."""
    # Where Ray notes the address of the cluster
    Path(FOLDER.name, "ray").mkdir()
    for nodes in (2, 4):
        fly(nodes)
    try:
        connect("127.0.0.1:1")
    except ConnectionError as error:
        print(f"no cluster: {error}")


if __name__ == "__main__":
    main()
