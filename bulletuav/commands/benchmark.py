"""`bulletuav benchmark`: how fast this machine is."""

import argparse
import itertools

from rich.console import Console
from rich.table import Table

from bulletuav.analysis.benchmark import FLOORS, ROUNDS, SIZES, measure
from bulletuav.commands.progress import telling
from bulletuav.dynamics import DYNAMICS

ABOUT = {
    "help": "measure this machine: drone-substeps per CPU-second of every dynamics",
    "description": "Print drone-substeps per CPU-second of every dynamics beside the engine's floor, and reset times.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Swarm sizes, and how long to measure."""
    parser.add_argument(
        "--drones", type=int, nargs="+", default=list(SIZES), metavar="N", help="swarm sizes"
    )
    parser.add_argument(
        "--seconds", type=float, default=0.3, help="CPU time of one measurement (default: 0.3)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Measure and print."""
    sizes = tuple(arguments.drones)
    if min(sizes) < 1 or not arguments.seconds > 0:
        raise ValueError(
            f"--drones {sizes}, --seconds {arguments.seconds}: numbers above 0 are needed"
        )
    done = itertools.count(1)
    with telling(
        "measuring", len(sizes) * (len(DYNAMICS) + len(FLOORS)) * ROUNDS, "measurements"
    ) as progress:
        results = measure(sizes, arguments.seconds, lambda: progress(next(done)))
    table = Table(
        title="drone-substeps per CPU-second, one thread, 240 Hz, all forces; below it the reset of the world"
    )
    table.add_column("dynamics", no_wrap=True)
    for size in sizes:
        table.add_column(f"N = {size}", justify="right")
    for name in dict.fromkeys(result.name for result in results):
        row = [result for result in results if result.name == name]
        table.add_row(
            name,
            *(
                f"{r.rate:.3g}" if name in FLOORS else f"{r.rate:.3g}\n{r.reset_ms:.2f} ms"
                for r in row
            ),
        )
    Console().print(table)
    print(
        "bare step: the engine's step alone; engine calls: with a wrench and a state of every drone, no arithmetic of ours"
    )
