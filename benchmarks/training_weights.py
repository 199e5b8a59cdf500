"""Train tasks with their weights for training, and print how far success rises.

    python benchmarks/training_weights.py pursuit formation --seeds 0 1 2
    python benchmarks/training_weights.py hover --difficulty easy --steps 4e5 --out out/hover

Trains as `bulletuav train TASK`, for at most a million decisions. The table compares the policy
before and after training with `stay`, by the benchmark and in its default dynamics: the smallest
and the largest value of all seeds. Needs the extra `sb3`. A repeated call continues, and trains
no finished run again; the time is that of the call.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bulletuav.analysis.evaluation import evaluate
from bulletuav.tasks import list_tasks
from bulletuav.training.schedules import default_run
from bulletuav.training.store import EVALUATION_SEED
from bulletuav.training.trainer import train

COLUMNS = (
    "task",
    "difficulty",
    "decisions",
    "safe, stay",
    "safe, untrained",
    "safe, trained",
    "success, trained",
    "conflicts",
    "CPU-s",
)


def measure(task: str, given: argparse.Namespace) -> str:
    """Train a task with all seeds, and return its row of the table."""
    base = default_run(task)
    options = dict(base.options)
    if given.difficulty is not None:
        options["difficulty"] = given.difficulty
    steps = min(base.steps, int(given.steps))
    changes = {"options": options, "steps": steps, "evaluations": 1, "episodes": given.episodes}
    base = replace(base, **changes)
    before, after, seconds = [], [], []
    for seed in given.seeds:
        started = time.process_time()
        rows = train(replace(base, seed=seed), given.out / f"{task}-{seed}")
        seconds.append(time.process_time() - started)
        before.append(rows[0])
        after.append(rows[-1])
    evaluated = {name: one for name, one in options.items() if name == "difficulty"}
    stay = evaluate(task, "stay", given.episodes, EVALUATION_SEED, **evaluated).estimates()
    cells = (
        f"`{task}`",
        options.get("difficulty", "default"),
        f"{steps / 1e6:g} million",
        f"{stay['safe_success'].mean:.2f}",
        span([row["safe_success"] for row in before]),
        span([row["safe_success"] for row in after]),
        span([row["drone_success"] for row in after]),
        span([row["conflicts"] for row in after], 1),
        span(seconds, 0),
    )
    return f"| {' | '.join(cells)} |"


def span(values: Sequence[float], digits: int = 2) -> str:
    """Format the smallest and the largest value."""
    low, high = (f"{one:.{digits}f}" for one in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def main() -> None:
    """Train the tasks and print the table, row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tasks", nargs="+", choices=list_tasks(), metavar="TASK")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--steps", type=float, default=1e6, help="maximum decisions of a run")
    parser.add_argument("--difficulty", help="by default that of the task")
    parser.add_argument("--episodes", type=int, default=20, help="of each evaluation")
    parser.add_argument("--out", type=Path, default=Path("out/training_weights"))
    given = parser.parse_args()
    sys.stdout.write(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n")
    for task in given.tasks:
        sys.stdout.write(f"{measure(task, given)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
