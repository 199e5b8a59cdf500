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
    """Evaluate on a cluster, and kill nodes meanwhile.

    Returns:
        The number of episodes finished before each loss; fewer than `count` - 1 numbers if the
        evaluation ended before.

    Raises:
        RuntimeError: If the evaluation fails.
    """
    killed = []
    with start_nodes(count) as (cluster, nodes):
        flight = subprocess.Popen(
            [*command(episodes), "--out", folder, "--ray", cluster.address],
            stdout=subprocess.DEVNULL,
        )
        while flight.poll() is None:
            # The k-th of n - 1 nodes is killed when at least k / n of the episodes are flown
            k = len(killed)
            due = k < len(nodes) and count_episodes(folder) > k * episodes // count
            if due and is_flying(nodes[k]):
                killed.append(count_episodes(folder))
                kill_node(cluster, nodes[k])
            time.sleep(POLL)
        if flight.returncode != 0:
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
    episodes = given.episodes
    for count in given.nodes:
        # A fast machine may fly all episodes before all nodes are killed
        while len(compare(count, episodes)) < count - 1:
            episodes *= 2


def compare(count, episodes):
    """Evaluate on a cluster, compare the files with those of one process, and return the losses."""
    local, folder = (Path(FOLDER.name, f"{nodes}_{episodes}") for nodes in (0, count))
    if not local.exists():
        began = time.perf_counter()
        subprocess.run([*command(episodes), "--out", local], check=True, stdout=subprocess.DEVNULL)
        report(nodes=0, episodes=episodes, killed=[], began=began)
    began = time.perf_counter()
    killed = fly(count, episodes, folder)
    assert read_files(folder) == read_files(local), f"{count} nodes: other files"
    report(nodes=count, episodes=episodes, killed=killed, began=began)
    return killed


def report(began, **row):
    """Print a line of JSON with the seconds since the start."""
    print(json.dumps({**row, "seconds": round(time.perf_counter() - began, 1)}), flush=True)


if __name__ == "__main__":
    main()
