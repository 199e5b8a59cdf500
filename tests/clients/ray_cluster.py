"""`bulletuav evaluate --ray` on clusters of 2 and 4 local nodes, which are killed one by one.

Each node but the head is killed by SIGKILL while it flies episodes, so that the head finishes the
evaluation. The files must be those of a single process, byte for byte. Prints a line of JSON for
each cluster.

    python tests/clients/ray_cluster.py
    python tests/clients/ray_cluster.py --nodes 4 --episodes 2000
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

from local_nodes import FOLDER, kill_node, node_pid, start_nodes

TASK_NAME = "ray::done_by_one"
"""Title of a worker's process while it runs a task of `map_on_cluster`"""
POLL = 0.01
"""Time between two looks at the evaluation, s"""


def command(episodes):
    """Return the command line of the evaluation."""
    return [
        *[sys.executable, "-m", "bulletuav", "evaluate", "crossing", "--policy", "orca"],
        *["--episodes", str(episodes), "--seed", "5", "--dynamics", "point_mass"],
    ]


def count_episodes(folder):
    """Return the number of episodes that an evaluation has written."""
    path = folder / "episodes.csv"
    return max(0, len(path.read_bytes().splitlines()) - 1) if path.is_file() else 0


def is_flying(node):
    """Return True if a worker of a node runs a task."""
    listed = ["ps", "--ppid", str(node_pid(node)), "-o", "args="]
    workers = subprocess.run(listed, stdout=subprocess.PIPE, text=True).stdout
    return TASK_NAME in workers


def fly(count, episodes, folder):
    """Evaluate on a cluster, kill nodes meanwhile, and return the episodes finished before each.

    Raises:
        RuntimeError: If the evaluation fails, or ends before all these nodes are killed.
    """
    killed = []
    with start_nodes(count) as (cluster, nodes):
        flight = subprocess.Popen(
            [*command(episodes), "--out", folder, "--ray", cluster.address],
            stdout=subprocess.DEVNULL,
        )
        for k, node in enumerate(nodes):
            # The k-th of n - 1 nodes is killed when at least k / n of the episodes are flown
            while count_episodes(folder) <= k * episodes // count or not is_flying(node):
                if flight.poll() is not None:
                    raise RuntimeError(
                        f"the evaluation ended ({flight.returncode}) after {len(killed)} of "
                        f"{len(nodes)} losses: fly more episodes"
                    )
                time.sleep(POLL)
            killed.append(count_episodes(folder))
            kill_node(cluster, node)
        if flight.wait() != 0:
            raise RuntimeError(f"the evaluation failed: exit status {flight.returncode}")
    return killed


def read_files(folder):
    """Return the bytes of each file of an evaluation."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def main():
    """Evaluate in one process and on clusters, and compare the files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--nodes", type=int, nargs="+", default=(2, 4), help="sizes of clusters")
    parser.add_argument("--episodes", type=int, default=400)
    given = parser.parse_args()
    place = Path(FOLDER.name)
    began = time.perf_counter()
    local = [*command(given.episodes), "--out", place / "local"]
    subprocess.run(local, check=True, stdout=subprocess.DEVNULL)
    report(nodes=0, episodes=given.episodes, killed=[], began=began)
    for count in given.nodes:
        folder = place / f"nodes{count}"
        began = time.perf_counter()
        killed = fly(count, given.episodes, folder)
        assert read_files(folder) == read_files(place / "local"), f"{count} nodes: other files"
        report(nodes=count, episodes=given.episodes, killed=killed, began=began)


def report(began, **row):
    """Print a line of JSON with the seconds since the start."""
    print(json.dumps({**row, "seconds": round(time.perf_counter() - began, 1)}), flush=True)


if __name__ == "__main__":
    main()
