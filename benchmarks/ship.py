"""Put the best run of each task into the package.

After `bulletuav train --all --out FOLDER`, and after `examples/fast_ppo.py swarm` with some seeds:

    python benchmarks/ship.py FOLDER
    python benchmarks/ship.py --swarm swarm-0 swarm-1 swarm-2

The best run is the seed with the largest return in new episodes, which neither a curve nor a table
shows. The few episodes of a curve's last point would take luck for skill. Of swarms the best is the
one that succeeds most without conflict in `CASES`; it flies the tasks of `SWARM`.
"""

import argparse
import csv
import dataclasses
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from bulletuav.analysis.evaluation import evaluate
from bulletuav.policies.run import CHECKPOINTS, CONFIG, POLICY, SHIPPED, RunConfig, shipped_tasks
from bulletuav.training.store import EVALUATION_SEED

SEED = 2 * EVALUATION_SEED
"""Seed of the first episode that decides"""
SWARM = ("crossing", "converge")
"""Tasks that the policy of a swarm flies"""
CASES = (("crossing", 32), ("converge", 16))
"""Tasks and numbers of drones that decide between swarms"""


def outcome(run: Path, episodes: int) -> float:
    """Evaluate the policy of a run with the settings of the evaluations during its training.

    Args:
        run: Folder of the run.
        episodes: How many to fly.

    Returns:
        The mean return.

    Raises:
        SystemExit: The training is not finished.
    """
    config = RunConfig.read(run / CONFIG)
    with (run / "curve.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    if int(last["steps"]) < config.steps:
        raise SystemExit(f"{run} is not finished: train it on first")
    result = evaluate(config.task, run, episodes, SEED, **config.evaluated)
    return result.estimates()["return"].mean


def swarm_outcome(run: Path, episodes: int) -> float:
    """Evaluate a policy in `CASES`: mean of success less conflict."""
    flown = [evaluate(task, run, episodes, SEED, num_drones=n).estimates() for task, n in CASES]
    return sum(found["success"].mean - found["conflict"].mean for found in flown) / len(CASES)


def find_runs(folder: Path, task: str) -> dict[int, Path]:
    """Find the runs of a task by their seeds, and check that they have the package's settings."""
    runs = {int(run.name): run for run in (folder / "runs" / task).glob("[0-9]*")}
    if not runs:
        raise SystemExit(f"{folder} holds no run of {task}: train all first")
    config = RunConfig.read(SHIPPED / task / CONFIG)
    for seed, run in runs.items():
        if RunConfig.read(run / CONFIG).text() != dataclasses.replace(config, seed=seed).text():
            raise SystemExit(f"{run} is of other settings than the package's: train it again")
    return runs


def ship(run: Path, seed: int, place: Path) -> None:
    """Copy what a run learned, and what it began with, and note its seed."""
    for name in (POLICY, f"{CHECKPOINTS}/000/{POLICY}"):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run / name, place / name)
    # Only the line of the seed changes, so that comments in the file stay.
    settings = (place / CONFIG).read_text()
    changed = re.sub(r"^seed: \d+$", f"seed: {seed}", settings, flags=re.MULTILINE)
    (place / CONFIG).write_text(changed)


def main() -> None:
    """Ship the best run of each task."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "folder", type=Path, nargs="?", help="folder of `bulletuav train --all --out`"
    )
    parser.add_argument(
        "--swarm", type=Path, nargs="+", help="folders of `examples/fast_ppo.py swarm`"
    )
    parser.add_argument(
        "--episodes", type=int, default=200, help="episodes of each run (default: 200)"
    )
    arguments = parser.parse_args()
    if arguments.swarm:
        outcomes = {run: swarm_outcome(run, arguments.episodes) for run in arguments.swarm}
        best = max(outcomes, key=outcomes.__getitem__)
        for task in SWARM:
            place_best(task, best, RunConfig.read(best / CONFIG).seed, outcomes.values())
    for task in sorted({*shipped_tasks()} - {*SWARM}) if arguments.folder else ():
        runs = find_runs(arguments.folder, task)
        returns = {seed: outcome(run, arguments.episodes) for seed, run in sorted(runs.items())}
        seed = max(returns, key=returns.__getitem__)
        place_best(task, runs[seed], seed, returns.values())


def place_best(task: str, run: Path, seed: int, outcomes: Iterable[float]) -> None:
    """Put a run into the package, and tell what decided."""
    place = SHIPPED / task
    ship(run, seed, place)
    told = ", ".join(f"{value:.2f}" for value in outcomes)
    size = (place / POLICY).stat().st_size / 1e3
    print(f"{task}: seed {seed} (outcomes {told}), {size:.0f} kB")


if __name__ == "__main__":
    main()
