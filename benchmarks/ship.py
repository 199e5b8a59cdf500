"""Put the best run of each task into the package: `python benchmarks/ship.py docs/learning`, after `bulletuav train --all`.

Best is the seed with the largest return in the last evaluation on the way, whose episodes no table uses.
"""

import argparse
import csv
import dataclasses
import re
from pathlib import Path

from bulletuav.adapters.sb3 import algorithm
from bulletuav.policies.run import CONFIG, MODEL, SHIPPED, RunConfig, shipped_tasks


def last_return(run: Path) -> float:
    """Return in the last evaluation of a run, which is to be finished."""
    with (run / "curve.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    if int(last["steps"]) < RunConfig.read(run / CONFIG).steps:
        raise SystemExit(f"{run} is not finished: train it on first")
    return float(last["return"])


def main() -> None:
    """Ship what there is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="of `bulletuav train --all --out`")
    folder = parser.parse_args().folder
    for task in shipped_tasks():
        runs = {int(run.name): run for run in (folder / "runs" / task).glob("[0-9]*")}
        if not runs:
            raise SystemExit(f"{folder} holds no run of {task}: train all first")
        seed = max(runs, key=lambda seed: last_return(runs[seed]))
        config, place = RunConfig.read(SHIPPED / task / CONFIG), SHIPPED / task
        if RunConfig.read(runs[seed] / CONFIG).text() != dataclasses.replace(config, seed=seed).text():
            raise SystemExit(f"{runs[seed]} is of other settings than the package's: train it again")
        model = algorithm(config.algo).load(runs[seed] / MODEL, device="cpu")
        kind = type(model.policy.optimizer)
        model.policy.optimizer = kind(model.policy.parameters(), lr=1e-5)  # whose state would be two thirds of the file
        model._last_obs = model._last_episode_starts = None
        model.save(place / MODEL)
        told = (place / CONFIG).read_text()
        (place / CONFIG).write_text(re.sub(r"^seed: \d+$", f"seed: {seed}", told, flags=re.MULTILINE))
        print(f"{task}: seed {seed}, {(place / MODEL).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
