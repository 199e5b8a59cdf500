"""`--ray` on clusters of 2 and 4 nodes, of which one is lost by `kill -9` every few seconds.

The nodes are those of Ray's own `Cluster`: each has a raylet and processes of its own, on one
machine. The files must be those of a single process. By hand, as CI has no Ray:

    python tests/clients/ray_cluster.py
"""

# ruff: noqa: E402 - Ray reads variables when it is imported
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FOLDER = tempfile.TemporaryDirectory(prefix="ray", ignore_cleanup_errors=True)
os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache"))
os.environ.update(HOME=FOLDER.name, RAY_TMPDIR=FOLDER.name)
os.environ.update(RAY_AUTH_MODE="disabled", RAY_USAGE_STATS_ENABLED="0")

from ray.cluster_utils import Cluster

COMMAND = [
    *[sys.executable, "-m", "bulletuav", "evaluate", "crossing", "--policy", "orca"],
    *["--episodes", "600", "--seed", "5", "--dynamics", "point_mass"],
]
EVERY = 6.0
"""Time between two losses, s"""
NODE = {"num_cpus": 1, "include_dashboard": False}


def fly(count, folder):
    """Evaluate on so many nodes; tell how many were lost meanwhile."""
    cluster = Cluster(initialize_head=True, head_node_args=NODE)
    nodes = [cluster.add_node(**NODE) for _ in range(count - 1)]
    cluster.wait_for_nodes()
    flight = subprocess.Popen([*COMMAND, "--out", folder, "--ray", cluster.address])
    lost = 0
    while True:
        try:
            assert flight.wait(EVERY) == 0, "the evaluation failed"
            break
        except subprocess.TimeoutExpired:
            # Never the head
            cluster.remove_node(nodes.pop(0), allow_graceful=False)
            nodes.append(cluster.add_node(**NODE))
            lost += 1
    cluster.shutdown()
    return lost


def files(folder):
    """Bytes of each file of an evaluation."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def main():
    """Fly alone and on clusters, and compare."""
    place = Path(FOLDER.name)
    began = time.perf_counter()
    subprocess.run([*COMMAND, "--out", place / "alone"], check=True)
    print(f"one process: {time.perf_counter() - began:.1f} s", flush=True)
    for count in (2, 4):
        folder = place / f"nodes{count}"
        began = time.perf_counter()
        lost = fly(count, folder)
        assert files(folder) == files(place / "alone"), f"{count} nodes gave other files"
        assert lost, "no node was lost: fly more episodes"
        took = time.perf_counter() - began
        print(f"{count} nodes: {took:.1f} s, {lost} nodes killed, the same files", flush=True)


if __name__ == "__main__":
    main()
