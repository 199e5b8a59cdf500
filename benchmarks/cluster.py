"""Estimate what 100,000 drones cost as 100 worlds over a cluster, from measurements of one core.

    python benchmarks/cluster.py --out docs/results/cluster
    python benchmarks/cluster.py --losses docs/lab/cluster.md

Decisions of one world of 1,000 drones are timed on one core, and its messages are measured. A
simulation of the cost then draws these times for each world and core, waits for the slowest core,
and adds the time of the messages through one link of the head node. No cluster is used. Writes
cluster.md and cluster.png.

With `--losses` clusters of local nodes fly and train instead, while nodes are killed, by the
programs tests/clients/ray_cluster.py and rllib_cluster.py. Writes a page; needs the extra `rllib`.
"""

import argparse
import json
import math
import pickle
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot

import bulletuav
from bulletuav.files import replace_file
from bulletuav.policies import find_policy

WORLDS, DRONES = 100, 1000
CORES = (1, 2, 5, 10, 20, 25, 50, 100)
SHOWN = (1, 10, 25, 100)
"""Numbers of cores in the table"""
DECISIONS = 100
"""Decisions between two messages of a rollout"""
WEIGHTS = 4 * 100_000
"""Bytes of a policy that the head sends before a rollout: 100,000 parameters"""
CALL = 1e-3
"""Overhead of a remote call, s: an assumption, of the order that Ray's documentation names"""
CASES = {
    "crossing, point_mass": ("crossing", "straight", {"dynamics": "point_mass"}),
    "flocking, point_mass": ("flocking", "reynolds", {"dynamics": "point_mass"}),
    "crossing, rigid_body": ("crossing", "straight", {"dynamics": "rigid_body"}),
}
"""Task, policy and options by name"""
COLOURS = ("#1b6ca8", "#c8553d", "#5a8f3c")
CLIENTS = Path(__file__).parents[1] / "tests" / "clients"
PHASES = ("before", "runner killed", "node killed", "node added", "restored")
"""Phases of rllib_cluster.py"""
LOSSES = """\
# Clusters: losses of nodes

Written by `python benchmarks/cluster.py --losses docs/lab/cluster.md --episodes {episodes}` on
{date}, with Ray {ray}. The nodes are Ray's own, on one machine: each has a raylet, an object
store of 100 MiB and one CPU. They share two cores with other work, so the times show no speed. CI
runs both programs, RLlib's on 2 nodes. How to use a cluster: [Spread runs over processes and
machines](../howto/cluster.md).

## Evaluation

`bulletuav evaluate crossing --policy orca --dynamics point_mass --ray ADDRESS`. Every node but the
head is killed (SIGKILL) while it flies, so that the head alone finishes. The files are those of one
process, byte for byte, otherwise [the program](../../tests/clients/ray_cluster.py) fails.

| nodes | episodes | nodes killed after so many episodes | time (s) | files |
|---|---:|---|---:|---|
{evaluation}

## RLlib

PPO on `crossing` with a runner on each node. A runner is killed, then a node with all its
processes; another node joins; at last a second algorithm continues from a checkpoint with equal
weights. In each phase training continues until as many runners answer as there are nodes. The table
has the numbers of iterations, at least {least} in each phase. [The
program](../../tests/clients/rllib_cluster.py) fails if an iteration collects nothing.

| nodes | {phases} | time (s) |
|---|{dashes}---:|
{training}
"""
"""Page of the losses"""


class Network(NamedTuple):
    """Link of the head node.

    Attributes:
        bandwidth: Bytes/s.
        latency: One-way latency, s.
    """

    bandwidth: float
    latency: float


NETWORKS = {
    "1 Gbit/s, 0.2 ms": Network(1e9 / 8, 2e-4),
    "10 Gbit/s, 0.05 ms": Network(1e10 / 8, 5e-5),
    "100 Gbit/s, 0.01 ms": Network(1e11 / 8, 1e-5),
}


class World(NamedTuple):
    """Measurements of one world on one core.

    Attributes:
        times: Times of decisions with those of the policy, s.
        down: Bytes of a message with the actions of a decision.
        up: Bytes of a message with observations, rewards and ends.
    """

    times: np.ndarray
    down: int
    up: int


def measure(task: str, policy: str, options: dict[str, str], decisions: int) -> World:
    """Fly one world, and measure its decisions and messages."""
    aviary = bulletuav.Aviary(task, num_drones=DRONES, **options)
    pilot = find_policy(policy)(aviary)
    times, down, up = [], 0, 0
    observations = aviary.reset(seeds=0)
    pilot.reset(np.ones(1, dtype=bool))
    for k in range(decisions + 2):
        begin = time.process_time()
        actions = pilot.act(observations, aviary.swarm)
        step = aviary.step(actions)
        if k >= 2:  # which compile
            times.append(time.process_time() - begin)
        observations = step.observations
        down = size_of(actions.astype(np.float32))
        rewards = step.rewards.astype(np.float32)
        up = size_of((observations, rewards, step.terminated, step.truncated))
    aviary.close()
    return World(np.array(times), down, up)


def size_of(message: object) -> int:
    """Return the size of a pickled message, bytes."""
    return len(pickle.dumps(message, protocol=5))


def central(world: World, cores: int, network: Network, rng: np.random.Generator) -> float:
    """Simulate a decision with the policy on the head node: s for all worlds.

    Cores fly their worlds one after the other; the slowest core counts. Messages of all worlds
    follow each other through the head's link.
    """
    flown = rng.choice(world.times, (cores, math.ceil(WORLDS / cores))).sum(axis=1).max()
    sent = WORLDS * (world.down + world.up) / network.bandwidth
    return float(flown + sent + 2 * network.latency + CALL)


def rollout(world: World, cores: int, network: Network, rng: np.random.Generator) -> float:
    """Simulate a decision with the policy on the workers: mean of a rollout, s for all worlds.

    The head sends weights to each core, and gets all transitions after `DECISIONS` decisions.
    """
    draws = rng.choice(world.times, (cores, math.ceil(WORLDS / cores) * DECISIONS))
    sent = cores * WEIGHTS + WORLDS * DECISIONS * (world.down + world.up)
    latency = 2 * network.latency + CALL
    return float(draws.sum(axis=1).max() + sent / network.bandwidth + latency) / DECISIONS


def evaluation(world: World, cores: int, network: Network, rng: np.random.Generator) -> float:
    """Simulate a decision of an evaluation, which sends results only: s for all worlds."""
    draws = rng.choice(world.times, (cores, math.ceil(WORLDS / cores) * DECISIONS))
    return float(draws.sum(axis=1).max()) / DECISIONS


MODES = {
    "evaluation": evaluation,
    "rollouts": rollout,
    "policy on the head": central,
}


def simulate(mode: str, world: World, cores: int, network: Network) -> float:
    """Return decisions of all 100,000 drones per second: the median of 20 simulations."""
    rng = np.random.default_rng(0)
    return 1 / statistics.median(MODES[mode](world, cores, network, rng) for _ in range(20))


def table(measured: dict[str, World]) -> str:
    """Write the measurements and the simulated rates."""
    lines = [
        "# 100,000 drones over a cluster: simulated cost",
        "",
        f"One world of {DRONES:,} drones on one core ({platform.machine()}), with its policy:",
        "",
        "| case | decision, median, 95 % (ms) | actions (kB) | observations, rewards, ends (kB) |",
        "|---|---|---|---|",
    ]
    for name, world in measured.items():
        middle, most = np.percentile(1e3 * world.times, (50, 95))
        sizes = f"{world.down / 1e3:.1f} | {world.up / 1e3:.1f}"
        lines.append(f"| {name} | {middle:.1f}, {most:.1f} | {sizes} |")
    lines += [
        "",
        f"Simulated decisions of all {WORLDS * DRONES:,} drones per second, as {WORLDS} worlds, by "
        f"the number of cores:",
        "",
        f"| case | mode | link of the head | {' | '.join(map(str, SHOWN))} |",
        f"|---|---|---|{'---|' * len(SHOWN)}",
    ]
    for name, world in measured.items():
        for mode in MODES:
            for link, network in NETWORKS.items():
                if mode == "evaluation" and link != next(iter(NETWORKS)):
                    continue  # hardly uses the link
                rates = [f"{simulate(mode, world, cores, network):.3g}" for cores in SHOWN]
                used = "any" if mode == "evaluation" else link
                lines.append(f"| {name} | {mode} | {used} | {' | '.join(rates)} |")
    return "\n".join(lines) + "\n"


def draw(measured: dict[str, World], path: Path) -> None:
    """Draw rates against cores."""
    figure, places = pyplot.subplots(1, len(MODES), figsize=(10, 3.4), sharey=True)
    for axes, mode in zip(places, MODES, strict=True):
        for colour, (name, world) in zip(COLOURS, measured.items(), strict=True):
            for style, (link, network) in zip((":", "--", "-"), NETWORKS.items(), strict=True):
                rates = [simulate(mode, world, cores, network) for cores in CORES]
                label = f"{name}; {link}"
                if mode != "evaluation" or style == "-":
                    axes.loglog(CORES, rates, style, color=colour, label=label)
        axes.axhline(10, color="0.7", linewidth=0.8)
        axes.set(title=mode, xlabel="cores")
        axes.set_xticks(SHOWN, map(str, SHOWN))
        axes.grid(alpha=0.3)
    places[0].set_ylabel("decisions per second\nof 100,000 drones")
    handles, labels = places[-1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3, fontsize=7)
    figure.tight_layout(rect=(0, 0.2, 1, 1))
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def run_client(name: str, *arguments: str) -> list[dict[str, Any]]:
    """Run a program that kills nodes, and return the rows that it prints."""
    command = [sys.executable, str(CLIENTS / f"{name}.py"), *arguments]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def describe_losses(evaluation: list[dict[str, Any]], training: list[dict[str, Any]]) -> str:
    """Write the page of the losses from the rows of both programs."""
    flown = [
        f"| {row['nodes'] or 'one process'} | {row['episodes']} | "
        f"{', '.join(map(str, row['killed']))} | {row['seconds']:.0f} | "
        f"{'the same bytes' if row['nodes'] else ''} |"
        for row in evaluation
    ]
    trained = [
        f"| {row['nodes']} | {' | '.join(str(row['iterations'][name]) for name in PHASES)} | "
        f"{row['seconds']:.0f} |"
        for row in training
    ]
    return LOSSES.format(
        date=date.today().isoformat(),
        ray=version("ray"),
        episodes=evaluation[0]["episodes"],
        evaluation="\n".join(flown),
        phases=" | ".join(PHASES),
        dashes="---:|" * len(PHASES),
        least=min(row["iterations"]["before"] for row in training),
        training="\n".join(trained),
    )


def main(given: Sequence[str] | None = None) -> None:
    """Measure, simulate and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/results/cluster"))
    parser.add_argument("--decisions", type=int, default=60, help="decisions to time")
    parser.add_argument("--losses", type=Path, metavar="PAGE", help="kill nodes, and write a page")
    parser.add_argument("--episodes", type=int, default=400, help="with --losses: episodes to fly")
    arguments = parser.parse_args(given)
    if arguments.losses is not None:
        evaluation = run_client("ray_cluster", "--episodes", str(arguments.episodes))
        replace_file(arguments.losses, describe_losses(evaluation, run_client("rllib_cluster")))
        return
    measured = {name: measure(*case, arguments.decisions) for name, case in CASES.items()}
    text = table(measured)
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_file(arguments.out / "cluster.md", text)
    draw(measured, arguments.out / "cluster.png")
    print(text)


if __name__ == "__main__":
    main()
