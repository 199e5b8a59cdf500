"""Learning: stable-baselines3's PPO on `hover` beside the same PPO on gym-pybullet-drones' HoverAviary; medians.

    python benchmarks/learning.py --peer CHECKOUT --out out/learning

Each run is a process of its own, one thread, in an environment made on the first run below `--environments`; runs of both
follow each other, `--rounds` times, each a learner that begins, with the round as its seed. Writes learning.md and .csv.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from compare import HERE, PACKAGES, SINGLE_THREAD, Row, install, report
from rich.console import Console
from rich.progress import Progress

GOAL = 5.0  # times as fast as the peer
PEER, AGAINST = "gym-pybullet-drones-ppo", "gym-pybullet-drones (HoverAviary)"
PACKAGES[PEER] = [
    "torch==2.13.0",
    "stable_baselines3==2.9.2",
    "gymnasium==1.2.2",
    "numpy==2.4.6",
    "pybullet==3.2.7",
    "matplotlib",
    "pillow",
    "scipy",
    "transforms3d",
    "setuptools<81",
]
SETTINGS = {  # the first: PPO's defaults
    "1 environment": {"environments": 1, "n_steps": 2048, "batch_size": 64, "n_epochs": 10},
    "16 environments": {"environments": 16, "n_steps": 128, "batch_size": 256, "n_epochs": 10},
    "64 environments": {"environments": 64, "n_steps": 32, "batch_size": 1024, "n_epochs": 10},
}


class Run(NamedTuple):
    """What a learner told: seconds and counts; see peers/learn.py."""

    wall: float
    cpu: float
    environment: float
    resets: float
    frames: int
    episodes: int


RATES = {  # of a run; its goal
    "frames/CPU-s": (lambda run: run.frames / run.cpu, GOAL),
    "frames/s": (lambda run: run.frames / run.wall, None),
    "frames/CPU-s, resets left out": (lambda run: run.frames / (run.cpu - run.resets), None),
}
PARTS = {  # of a run
    "PPO itself": lambda run: run.cpu - run.environment,
    "steps": lambda run: run.environment - run.resets,
    "resets": lambda run: run.resets,
}


def run(command: Sequence[Path | str], context: dict[str, int], frames: int, seed: int) -> Run:
    """One learner. Raises RuntimeError with its own last words when it fails."""
    question = json.dumps({**context, "frames": frames, "seed": seed})
    ended = subprocess.run(
        [*command, question],
        capture_output=True,
        text=True,
        env={**os.environ, **SINGLE_THREAD},
        cwd=tempfile.gettempdir(),
    )
    if ended.returncode:
        said = ended.stderr.strip().splitlines() or [""]
        raise RuntimeError(f"a learner ended with code {ended.returncode}: {said[-1]}")
    return Run(**json.loads(ended.stdout))


def rows(title: str, ours: Sequence[Run], theirs: Sequence[Run]) -> list[Row]:
    """Medians of both, and of their ratio, at each of the rates."""
    result = []
    for unit, (rate, goal) in RATES.items():
        here, there = [rate(one) for one in ours], [rate(one) for one in theirs]
        ratio = statistics.median(a / b for a, b in zip(here, there, strict=True))
        result.append(
            Row(
                title, AGAINST, unit, statistics.median(here), statistics.median(there), ratio, goal
            )
        )
    return result


def parts(title: str, runs: Sequence[Run]) -> str:
    """Where the time of a frame goes, medians: a line of Markdown."""
    times = [
        statistics.median(1e6 * part(one) / one.frames for one in runs) for part in PARTS.values()
    ]
    share = statistics.median(1 - one.environment / one.cpu for one in runs)
    length = statistics.median(one.frames / max(1, one.episodes) for one in runs)
    return (
        f"| {title} | "
        + " | ".join(f"{time:.3g}" for time in times)
        + f" | {share:.0%} | {length:.0f} |"
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add(
        "--peer",
        type=Path,
        required=True,
        metavar="CHECKOUT",
        help="folder of the sources of gym-pybullet-drones",
    )
    add(
        "--out",
        type=Path,
        default=Path("out/learning"),
        metavar="DIR",
        help="folder for the files (out/learning)",
    )
    environments = Path.home() / ".cache" / "bulletuav-peers"
    add(
        "--environments",
        type=Path,
        default=environments,
        metavar="DIR",
        help=f"where it is installed ({environments})",
    )
    add("--rounds", type=int, default=5, help="runs of each (5)")
    add(
        "--frames",
        type=int,
        default=10240,
        help="frames of one run, the first rollout not counted (10240)",
    )
    arguments = parser.parse_args(argv)
    if min(arguments.rounds, arguments.frames) < 1:
        parser.error(
            f"--rounds {arguments.rounds}, --frames {arguments.frames}: numbers above 0 are needed"
        )
    if not (arguments.peer / "gym_pybullet_drones").is_dir():
        parser.error(
            f"{arguments.peer} is no checkout of gym-pybullet-drones: it has no folder gym_pybullet_drones"
        )
    ours = [sys.executable, HERE / "peers" / "learn_bulletuav.py"]
    python = install(PEER, arguments.environments.resolve())
    theirs = [python, HERE / "peers" / "learn_gym_pybullet_drones.py", arguments.peer.resolve()]
    table, words = (
        [],
        [
            "",
            "CPU-microseconds a frame:",
            "",
            f"| | {' | '.join(PARTS)} | share of PPO | frames an episode |",
        ],
    )
    words.append("|---" * (len(PARTS) + 3) + "|")
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("learning", total=len(SETTINGS) * arguments.rounds)
        for title, context in SETTINGS.items():
            runs: list[list[Run]] = [[], []]
            for seed in range(arguments.rounds):
                for told, command in zip(runs, (ours, theirs), strict=True):
                    told.append(run(command, context, arguments.frames, seed))
                progress.advance(task)
            table += rows(title, *runs)
            words += [
                parts(f"{title}, {name}", told)
                for name, told in zip(("bulletuav", AGAINST), runs, strict=True)
            ]
    report(table, words, arguments.out, "learning")


if __name__ == "__main__":
    main()
