"""Measure how long it takes to save worlds, to put them back, and to hash them.

    python benchmarks/snapshots.py
    python benchmarks/snapshots.py --task navigation --drones 4

Figures are medians of rounds, in microseconds of CPU time for each world, beside a decision.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import bulletuav

WORLDS = (1, 8, 64, 256)
ROUNDS = 21


def spent(call: Callable[[], Any], worlds: int, times: int) -> float:
    """Measure the CPU time of a call, us for each world."""
    call()
    figures = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        for _ in range(times):
            call()
        figures.append((time.process_time() - begin) / times / worlds)
    return 1e6 * statistics.median(figures)


def row(task: str, drones: int, dynamics: str, worlds: int) -> list[float]:
    """Measure one size: saving, loading, hashing, a decision."""
    aviary = bulletuav.Aviary(task, worlds, dynamics=dynamics, num_drones=drones)
    aviary.reset(seeds=0)
    actions = np.zeros((worlds, *aviary.action.low.shape))
    aviary.step(actions)
    snapshot, times = aviary.save_state(), max(1, 100 // worlds)
    calls = (
        aviary.save_state,
        lambda: aviary.load_state(snapshot),
        aviary.state_hash,
        lambda: aviary.step(actions),
    )
    figures = [spent(call, worlds, times) for call in calls]
    aviary.close()
    return figures


def main() -> None:
    """Measure all sizes, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="crossing")
    parser.add_argument("--drones", type=int, default=4)
    arguments = parser.parse_args()
    table = Table(title=f"{arguments.task}, {arguments.drones} drones, us a world")
    for heading in ("dynamics", "worlds", "save", "load", "hash", "decision"):
        table.add_column(heading, justify="right")
    for dynamics in ("point_mass", "rigid_body", "bullet"):
        for worlds in WORLDS:
            figures = row(arguments.task, arguments.drones, dynamics, worlds)
            table.add_row(dynamics, str(worlds), *(f"{one:.1f}" for one in figures))
    Console().print(table)


if __name__ == "__main__":
    main()
