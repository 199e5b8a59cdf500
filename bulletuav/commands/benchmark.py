"""`bulletuav benchmark`: measure the speed of this machine."""

import argparse
import itertools
from collections.abc import Sequence

from rich.table import Table

from bulletuav.analysis.benchmark import (
    ENGINE_CASES,
    MEASURED,
    ROUNDS,
    SWARM_SIZES,
    BenchmarkResult,
    measure_speed,
)
from bulletuav.commands.output import print_table
from bulletuav.commands.parsers.benchmark import SECONDS
from bulletuav.commands.progress import show_progress
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.envs.aviary import Aviary

DECISIONS = 500
"""Number of decisions over which stages are measured"""


def run(arguments: argparse.Namespace) -> None:
    """Measure, and print the results."""
    if arguments.stages is not None:
        if arguments.drones is not None or arguments.seconds is not None:
            raise ValueError(
                "--stages uses the defaults of the task: leave --drones and --seconds out"
            )
        _print_stages(arguments.stages)
        return
    sizes = tuple(SWARM_SIZES if arguments.drones is None else arguments.drones)
    seconds = SECONDS if arguments.seconds is None else arguments.seconds
    if min(sizes) < 1 or not seconds > 0:
        raise ValueError(f"--drones {sizes}, --seconds {seconds}: numbers above 0 are needed")
    # Interleave repeated measurements, so that all cases meet the same disturbances
    total = len(sizes) * len(MEASURED) * ROUNDS
    done = itertools.count(1)
    with show_progress("measuring", total, "measurements") as report:
        results = measure_speed(sizes, seconds, lambda: report(next(done)))
    print_table(_table(results, sizes))
    if HAS_BULLET:
        print(
            "bare step: only the step of the physics engine\n"
            "engine calls: the step and, for each drone, applying a wrench and reading the state"
        )


def _print_stages(task: str) -> None:
    """Measure and print the duration of the stages of a decision of a task."""
    aviary = Aviary(task)
    try:
        aviary.reset(seeds=0)
        profile = aviary.profile(DECISIONS)
    finally:
        aviary.close()
    count, dynamics = aviary.num_drones, aviary.options.dynamics_name
    table = Table(
        title=f"{task}, {count} drone{'s' * (count > 1)}, {dynamics}: microseconds per decision"
    )
    table.add_column("stage", no_wrap=True)
    table.add_column("us", justify="right")
    table.add_column("description")
    for stage in aviary.simulation.stages:
        table.add_row(stage.name, f"{profile[stage.name]:.1f}", stage.summary)
    table.add_row("all", f"{sum(profile.values()):.1f}", f"mean of {DECISIONS} random decisions")
    print_table(table)


def _table(results: Sequence[BenchmarkResult], sizes: Sequence[int]) -> Table:
    """Return a table of rates: a row for each dynamics, a column for each number of drones."""
    table = Table(
        title="physics steps of drones per CPU-second, one thread, 240 Hz, all forces; "
        "below: duration of a reset of the world"
    )
    table.add_column("dynamics", no_wrap=True)
    for size in sizes:
        table.add_column(f"N = {size}", justify="right")
    for name in dict.fromkeys(result.name for result in results):
        row = [result for result in results if result.name == name]
        table.add_row(name, *map(_cell, row))
    return table


def _cell(result: BenchmarkResult) -> str:
    """Return the rate of a case and, if it has one, its reset time."""
    rate = f"{result.rate:.3g}"
    return rate if result.name in ENGINE_CASES else f"{rate}\n{result.reset_ms:.2f} ms"
