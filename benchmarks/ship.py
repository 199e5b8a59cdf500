"""Put the best run of each task into the package: `python benchmarks/ship.py docs/learning`, after `bulletuav train --all`.

Best is the seed with the largest return in episodes that neither a curve nor a table shows: the few of a curve's last point
would take luck for skill.
"""

import argparse
import csv
import dataclasses
import re
import shutil
from pathlib import Path

from bulletuav.analysis.evaluation import evaluate
from bulletuav.policies.run import CHECKPOINTS, CONFIG, POLICY, SHIPPED, RunConfig, shipped_tasks
from bulletuav.training.trainer import EVALUATION_SEED

SEED = 2 * EVALUATION_SEED  # of the first episode that decides


def outcome(run: Path, episodes: int) -> float:
    """Return of a run's policy, which is to have finished its training, as it was evaluated on the way."""
    config = RunConfig.read(run / CONFIG)
    with (run / "curve.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    if int(last["steps"]) < config.steps:
        raise SystemExit(f"{run} is not finished: train it on first")
    return evaluate(config.task, run, episodes, SEED, **config.evaluated).estimates()["return"].mean


def main() -> None:
    """Ship what there is."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of `bulletuav train --all --out`")
    parser.add_argument("--episodes", type=int, default=200, help="of each run (default: 200)")
    given = parser.parse_args()
    for task in shipped_tasks():
        runs = {int(run.name): run for run in (given.folder / "runs" / task).glob("[0-9]*")}
        if not runs:
            raise SystemExit(f"{given.folder} holds no run of {task}: train all first")
        config, place = RunConfig.read(SHIPPED / task / CONFIG), SHIPPED / task
        for seed, run in runs.items():
            if RunConfig.read(run / CONFIG).text() != dataclasses.replace(config, seed=seed).text():
                raise SystemExit(f"{run} is of other settings than the package's: train it again")
        found = {seed: outcome(run, given.episodes) for seed, run in sorted(runs.items())}
        seed = max(found, key=found.__getitem__)
        for name in (
            POLICY,
            f"{CHECKPOINTS}/000/{POLICY}",
        ):  # what it learned, and what it began with
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(runs[seed] / name, place / name)
        told = (place / CONFIG).read_text()
        (place / CONFIG).write_text(
            re.sub(r"^seed: \d+$", f"seed: {seed}", told, flags=re.MULTILINE)
        )
        returns = ", ".join(f"{value:.2f}" for value in found.values())
        print(
            f"{task}: seed {seed} (return {returns}), {(place / POLICY).stat().st_size / 1e3:.0f} kB"
        )


if __name__ == "__main__":
    main()
