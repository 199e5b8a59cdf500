"""Measure how much memory environments take at their peak: each in a process of its own.

    python benchmarks/memory.py [--out out/memory.md]

A case is made, reset, and flown for some decisions at random. Told is the largest resident size of
the process, less that of one which has only imported bulletuav.
"""

import argparse
import multiprocessing
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

DECISIONS = 20
UNIT = 1024 if sys.platform == "linux" else 1
"""Bytes in which the system counts resident memory"""
CASES: dict[str, tuple[str, int, dict[str, Any]]] = {
    "crossing, 64 worlds of 8 drones, bullet": ("crossing", 64, {"num_drones": 8}),
    "crossing, 64 worlds of 8 drones, rigid_body": (
        "crossing",
        64,
        {"num_drones": 8, "dynamics": "rigid_body"},
    ),
    "free_flight, 1,000 drones, bullet": (
        "free_flight",
        1,
        {"num_drones": 1000, "area": 1500.0, "observation": ("velocity", "goal", "neighbours")},
    ),
    "navigation, 5,000 buildings, bullet": (
        "navigation",
        1,
        {"city": "urban", "area": 3200.0, "num_layouts": 1},
    ),
    "mec, 256 users, 8 worlds": ("mec", 8, {"num_users": 256}),
}
"""Task, worlds and options by name"""


def peak() -> float:
    """Return the largest resident size of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * UNIT / 1e6


def fly(case: str | None, answers: Any) -> None:
    """Fly a case, None for nothing but the import, and answer with the peak and what there is."""
    import bulletuav

    if case is None:
        answers.put((peak(), ""))
        return
    task, worlds, options = CASES[case]
    aviary = bulletuav.Aviary(task, worlds, **options)
    aviary.reset(seeds=0)
    rng = np.random.default_rng(0)
    low, high = aviary.action.low, aviary.action.high
    for _ in range(DECISIONS):
        aviary.step(rng.uniform(low, high, (*aviary.alive.shape, low.shape[-1])))
    buildings = len(aviary.task.layouts()[0].bounds) if aviary.task.layouts() else 0
    answers.put((peak(), f"{buildings:,} pieces of buildings" if buildings else ""))
    aviary.close()


def measure(case: str | None) -> tuple[float, str]:
    """Fly a case in a process of its own."""
    context = multiprocessing.get_context("spawn")
    answers = context.Queue()
    process = context.Process(target=fly, args=(case, answers))
    process.start()
    told: tuple[float, str] = answers.get(timeout=1200)
    process.join()
    return told


def main() -> None:
    """Measure all, and print a table."""
    parser = argparse.ArgumentParser(description="Measure memory at its peak.")
    parser.add_argument("--out", type=Path, help="file for the table")
    arguments = parser.parse_args()
    # Compiling takes memory of its own, which a second run does not need.
    for case in track([*CASES], description="compiling"):
        measure(case)
    nothing, _ = measure(None)
    lines = ["| what is flown | peak, MB | beside the import, MB |", "|---|---|---|"]
    lines.append(f"| nothing: `import bulletuav` | {nothing:.0f} | |")
    for case in track([*CASES], description="measuring"):
        size, told = measure(case)
        name = f"{case} ({told})" if told else case
        lines.append(f"| {name} | {size:.0f} | {size - nothing:.0f} |")
    table = "\n".join(lines) + "\n"
    print(table, end="")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(table)


if __name__ == "__main__":
    main()
