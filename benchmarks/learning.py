"""Measure learning: PPO on `hover` beside the same PPO on gym-pybullet-drones' HoverAviary.

    python benchmarks/learning.py --peer CHECKOUT --out out/learning

Both use stable-baselines3. Each run is a process of its own, with one thread, in an environment
that is made on the first run, below `--environments`. Each begins to learn from nothing, with the
round as its seed. Runs of both follow each other, `--rounds` times. Writes medians to learning.md
and learning.csv.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from compare import Row, report
from rich.console import Console
from rich.progress import Progress
from simulators import HERE, install, single_thread_variables

GOAL = 5.0  # times as fast as the peer
PEER = "gym-pybullet-drones-ppo"  # its environment
AGAINST = "gym-pybullet-drones (HoverAviary)"
SETTINGS = {  # the first has PPO's defaults
    "1 environment": {"environments": 1, "n_steps": 2048, "batch_size": 64, "n_epochs": 10},
    "16 environments": {"environments": 16, "n_steps": 128, "batch_size": 256, "n_epochs": 10},
    "64 environments": {"environments": 64, "n_steps": 32, "batch_size": 1024, "n_epochs": 10},
}


class Run(NamedTuple):
    """What a learner measured; see peers/learn.py.

    Attributes:
        wall: Wall time of the run, s.
        cpu: Its CPU time, s.
        environment: CPU time of the environment's steps, resets included, s.
        resets: CPU time of the resets, s.
        frames: Transitions that were flown.
        episodes: Episodes that ended.
    """

    wall: float
    cpu: float
    environment: float
    resets: float
    frames: int
    episodes: int


RATES: dict[str, tuple[Callable[[Run], float], float | None]] = {
    "frames/CPU-s": (lambda run: run.frames / run.cpu, GOAL),
    "frames/s": (lambda run: run.frames / run.wall, None),
    "frames/CPU-s, resets left out": (lambda run: run.frames / (run.cpu - run.resets), None),
}
"""Rates of a run by their unit, and the goal of the ratio, if there is one"""
PARTS: dict[str, Callable[[Run], float]] = {
    "PPO itself": lambda run: run.cpu - run.environment,
    "steps": lambda run: run.environment - run.resets,
    "resets": lambda run: run.resets,
}
"""Parts of the CPU time of a run, s"""


def run(command: Sequence[Path | str], context: dict[str, int], frames: int, seed: int) -> Run:
    """Run one learner.

    Args:
        command: The command that starts it.
        context: Number of environments and options of PPO, one of `SETTINGS`.
        frames: Frames to learn from.
        seed: Seed of the learner.

    Raises:
        RuntimeError: It failed; the message has its own last words.
    """
    question = json.dumps({**context, "frames": frames, "seed": seed})
    ended = subprocess.run(
        [*command, question],
        capture_output=True,
        text=True,
        env=single_thread_variables(),
        cwd=tempfile.gettempdir(),
    )
    if ended.returncode:
        lines = ended.stderr.strip().splitlines() or [""]
        raise RuntimeError(f"a learner ended with code {ended.returncode}: {lines[-1]}")
    return Run(**json.loads(ended.stdout))


def rows(
    title: str, ours: Sequence[Run], theirs: Sequence[Run], has_goal: bool = True
) -> list[Row]:
    """Compare runs in pairs: medians of both, and of their ratio, at each of the rates.

    Args:
        title: What is compared.
        ours: Runs of bulletuav.
        theirs: Runs of the other simulator.
        has_goal: False with one environment, where PPO itself takes most of the time.
    """
    result = []
    for unit, (rate, goal) in RATES.items():
        our_rates = [rate(run) for run in ours]
        their_rates = [rate(run) for run in theirs]
        ratios = [our / their for our, their in zip(our_rates, their_rates, strict=True)]
        row = Row(
            title=title,
            against=AGAINST,
            unit=unit,
            ours=statistics.median(our_rates),
            theirs=statistics.median(their_rates),
            ratio=statistics.median(ratios),
            goal=goal if has_goal else None,
        )
        result.append(row)
    return result


def parts(title: str, runs: Sequence[Run]) -> str:
    """Tell where the time of a frame goes, in medians: a line of Markdown."""
    times = [
        statistics.median(1e6 * part(run) / run.frames for run in runs) for part in PARTS.values()
    ]
    share = statistics.median(1 - run.environment / run.cpu for run in runs)
    length = statistics.median(run.frames / max(1, run.episodes) for run in runs)
    cells = [title, *(f"{time:.3g}" for time in times), f"{share:.0%}", f"{length:.0f}"]
    return f"| {' | '.join(cells)} |"


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Parse and check the arguments."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--peer",
        type=Path,
        required=True,
        metavar="CHECKOUT",
        help="folder of the sources of gym-pybullet-drones",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/learning"),
        metavar="DIR",
        help="folder for the files (out/learning)",
    )
    environments = Path.home() / ".cache" / "bulletuav-peers"
    parser.add_argument(
        "--environments",
        type=Path,
        default=environments,
        metavar="DIR",
        help=f"folder where the peer is installed ({environments})",
    )
    parser.add_argument("--rounds", type=int, default=5, help="runs of each (5)")
    parser.add_argument(
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
            f"{arguments.peer} is no checkout of gym-pybullet-drones: "
            "it has no folder gym_pybullet_drones"
        )
    return arguments


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, write, print."""
    arguments = parse(argv)
    python = install(PEER, arguments.environments.resolve())
    commands = {
        "bulletuav": [sys.executable, HERE / "peers" / "learn_bulletuav.py"],
        AGAINST: [
            python,
            HERE / "peers" / "learn_gym_pybullet_drones.py",
            arguments.peer.resolve(),
        ],
    }
    table = []
    notes = [
        "",
        "CPU-microseconds a frame:",
        "",
        f"| | {' | '.join(PARTS)} | share of PPO | frames an episode |",
        "|---" * (len(PARTS) + 3) + "|",
    ]
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("learning", total=len(SETTINGS) * arguments.rounds)
        for title, context in SETTINGS.items():
            runs: dict[str, list[Run]] = {name: [] for name in commands}
            # Both learn in turn, so that they meet the same disturbances.
            for seed in range(arguments.rounds):
                for name, command in commands.items():
                    runs[name].append(run(command, context, arguments.frames, seed))
                progress.advance(task)
            table += rows(title, *runs.values(), has_goal=context["environments"] > 1)
            notes += [parts(f"{title}, {name}", learned) for name, learned in runs.items()]
    report(table, notes, arguments.out, "learning")


if __name__ == "__main__":
    main()
