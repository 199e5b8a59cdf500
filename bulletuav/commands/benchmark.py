"""`bulletuav benchmark`: how fast this machine is."""

import argparse
import itertools
from collections.abc import Sequence

from rich.table import Table

from bulletuav.analysis.benchmark import FLOORS, ROUNDS, SIZES, Result, measure
from bulletuav.commands.output import print_table
from bulletuav.commands.progress import show_progress
from bulletuav.dynamics import DYNAMICS

ABOUT = {
    "help": "measure this machine: drone-substeps per CPU-second of every dynamics",
    "description": (
        "Print drone-substeps per CPU-second of every dynamics, the same for the bare calls of "
        "the engine, and how long resets take."
    ),
    "epilog": """examples:
  bulletuav benchmark
  bulletuav benchmark --drones 1 10 100 --seconds 1""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add swarm sizes, and how long to measure."""
    parser.add_argument(
        "--drones",
        type=int,
        nargs="+",
        default=list(SIZES),
        metavar="N",
        help="swarm sizes",
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=0.3,
        help="CPU time of one measurement (default: 0.3)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Measure and print."""
    sizes = tuple(arguments.drones)
    if min(sizes) < 1 or not arguments.seconds > 0:
        raise ValueError(
            f"--drones {sizes}, --seconds {arguments.seconds}: numbers above 0 are needed"
        )
    # Every case is measured several times in turn, so that all meet the same disturbances.
    total = len(sizes) * (len(DYNAMICS) + len(FLOORS)) * ROUNDS
    done = itertools.count(1)
    with show_progress("measuring", total, "measurements") as report:
        results = measure(sizes, arguments.seconds, lambda: report(next(done)))
    print_table(_table(results, sizes))
    print(
        "bare step: only the engine's step\n"
        "engine calls: the step, and for every drone a wrench applied and a state read"
    )


def _table(results: Sequence[Result], sizes: Sequence[int]) -> Table:
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


def _cell(result: Result) -> str:
    """Write the rate of a case and, where it has one, its reset time."""
    rate = f"{result.rate:.3g}"
    return rate if result.name in FLOORS else f"{rate}\n{result.reset_ms:.2f} ms"
