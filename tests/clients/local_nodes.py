"""Ray clusters of several nodes on one machine, whose nodes can be killed.

Nodes are those of Ray's own `Cluster`: each has a raylet, an object store and workers of its own.
Import this module before Ray, which reads variables of the environment when it is imported.
"""

# ruff: noqa: E402 - Ray reads variables when it is imported
import contextlib
import os
import tempfile
from pathlib import Path

FOLDER = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
os.environ.update(HOME=FOLDER.name, RAY_TMPDIR=FOLDER.name)
os.environ.update(RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0")

import ray
from ray.cluster_utils import Cluster

NODE = {"num_cpus": 1, "object_store_memory": 100 * 2**20, "include_dashboard": False}
"""Options of each node; the object store is small"""


@contextlib.contextmanager
def start_nodes(count):
    """Start a cluster of a head and other nodes with one CPU each, and stop it at the end.

    Yields:
        The cluster, and the nodes other than the head.
    """
    Path(FOLDER.name, "ray").mkdir(exist_ok=True)  # where Ray writes the address of the cluster
    cluster = Cluster(initialize_head=True, head_node_args=NODE)
    try:
        nodes = [add_node(cluster) for _ in range(count - 1)]
        cluster.wait_for_nodes()
        yield cluster, nodes
    finally:
        ray.shutdown()
        cluster.shutdown()


def add_node(cluster):
    """Add a node to a cluster, and return it."""
    return cluster.add_node(**NODE)


def kill_node(cluster, node):
    """Kill the processes of a node by SIGKILL; its workers die with them."""
    cluster.remove_node(node, allow_graceful=False)


def node_pid(node):
    """Return the process of a node's raylet, which is the parent of its workers."""
    return node.all_processes["raylet"][0].process.pid
