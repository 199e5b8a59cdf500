"""`bulletuav benchmark`: how fast this machine is."""

import argparse
import itertools
from collections.abc import Sequence

from rich.table import Table

from bulletuav.analysis.benchmark import (
    ENGINE_CASES,
    ROUNDS,
    SWARM_SIZES,
    BenchmarkResult,
    measure_speed,
)
from bulletuav.commands.output import print_table
from bulletuav.commands.progress import show_progress
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.aviary import Aviary

SECONDS = 0.3
"""CPU time of one measurement, s"""
DECISIONS = 500
"""How many decisions are flown to measure stages"""
ABOUT = {
    "help": "measure this machine: drone-substeps per CPU-second of every dynamics",
    "description": (
        "Print drone-substeps per CPU-second of every dynamics, the same for the bare calls of "
        "the engine, and how long resets take. With --stages, print how long each stage of a "
        "decision of a task takes instead."
    ),
    "epilog": """examples:
  bulletuav benchmark
  bulletuav benchmark --drones 1 10 100 --seconds 1
  bulletuav benchmark --stages crossing""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add swarm sizes, and how long to measure."""
    parser.add_argument(
        "--drones",
        type=int,
        nargs="+",
        metavar="N",
        help=f"swarm sizes (default: {' '.join(map(str, SWARM_SIZES))})",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        help=f"CPU time of one measurement (default: {SECONDS})",
    )
    parser.add_argument("--stages", metavar="TASK", help="measure the stages of this task")


def run(arguments: argparse.Namespace) -> None:
    """Measure and print."""
    if arguments.stages is not None:
        if arguments.drones is not None or arguments.seconds is not None:
            raise ValueError("--stages measures a task as it is: leave --drones and --seconds out")
        _print_stages(arguments.stages)
        return
    sizes = tuple(SWARM_SIZES if arguments.drones is None else arguments.drones)
    seconds = SECONDS if arguments.seconds is None else arguments.seconds
    if min(sizes) < 1 or not seconds > 0:
        raise ValueError(f"--drones {sizes}, --seconds {seconds}: numbers above 0 are needed")
    # Every case is measured several times in turn, so that all meet the same disturbances.
    total = len(sizes) * (len(DYNAMICS) + len(ENGINE_CASES)) * ROUNDS
    done = itertools.count(1)
    with show_progress("measuring", total, "measurements") as report:
        results = measure_speed(sizes, seconds, lambda: report(next(done)))
    print_table(_table(results, sizes))
    print(
        "bare step: only the engine's step\n"
        "engine calls: the step, and for every drone a wrench applied and a state read"
    )


def _print_stages(task: str) -> None:
    """Measure the stages of a decision of a task, and print them."""
    aviary = Aviary(task)
    try:
        aviary.reset(seeds=0)
        profile = aviary.profile(DECISIONS)
    finally:
        aviary.close()
    count, dynamics = aviary.num_drones, aviary.options.dynamics_name
    table = Table(
        title=f"{task}, {count} drone{'s' * (count > 1)}, {dynamics}: microseconds of each stage"
    )
    table.add_column("stage", no_wrap=True)
    table.add_column("us", justify="right")
    table.add_column("what it does")
    for stage in aviary.simulation.stages:
        table.add_row(stage.name, f"{profile[stage.name]:.1f}", stage.summary)
    table.add_row("all", f"{sum(profile.values()):.1f}", f"mean of {DECISIONS} decisions at random")
    print_table(table)


def _table(results: Sequence[BenchmarkResult], sizes: Sequence[int]) -> Table:
    """Lay out the rates: a row for each dynamics or floor, a column for each swarm size."""
    table = Table(
        title="drone-substeps per CPU-second, one thread, 240 Hz, all forces; "
        "below it the time of a reset of the world"
    )
    table.add_column("dynamics", no_wrap=True)
    for size in sizes:
        table.add_column(f"N = {size}", justify="right")
    for name in dict.fromkeys(result.name for result in results):
        row = [result for result in results if result.name == name]
        table.add_row(name, *map(_cell, row))
    return table


def _cell(result: BenchmarkResult) -> str:
    """Write the rate of a case and, where it has one, its reset time."""
    rate = f"{result.rate:.3g}"
    return rate if result.name in ENGINE_CASES else f"{rate}\n{result.reset_ms:.2f} ms"
