"""Several evaluations side by side."""

import csv
from collections.abc import Sequence
from pathlib import Path

from bulletuav.evaluation import Evaluation
from bulletuav.metrics import METRICS, Estimate

SHOWN = {
    "success": "success",
    "drone_success": "drones",
    "return": "return",
    "conflict": "conflict",
    "collision": "collision",
    "min_separation": "nearest m",
    "length": "time s",
    "path_efficiency": "efficiency",
    "fairness": "fairness",
    "served": "served",
    "completed": "completed",
    "latency": "latency s",
}
"""Metrics of the table, with their headings; those that no episode of a table has are left out"""


def markdown(results: Sequence[Evaluation]) -> str:
    """A table for each task and difficulty: means with 95 % intervals; * marks policies that read the true state."""
    groups: dict[tuple[str, str, int], list[Evaluation]] = {}
    for result in results:
        options = result.about["options"]
        groups.setdefault((result.about["task"], options["difficulty"], options["num_drones"]), []).append(result)
    parts = [_group(*key, group) for key, group in groups.items()]
    return "\n".join(parts) + "\n\\* reads the true state instead of observations. In brackets: 95 % confidence intervals.\n"


def _group(task: str, difficulty: str, drones: int, results: Sequence[Evaluation]) -> str:
    shown = [metric for metric in SHOWN if any(result.estimates()[metric].episodes for result in results)]
    dynamics = list(dict.fromkeys(map(_dynamics, results)))
    headings = ["policy", *(["dynamics"] if len(dynamics) > 1 else []), *(SHOWN[metric] for metric in shown)]
    lines = [
        f"### {task}, {difficulty}: {drones} drones, {', '.join(dynamics)}, {results[0].about['episodes']} episodes\n",
        "| " + " | ".join(headings) + " |",
        "|---" * len(headings) + "|",
    ]
    for result in results:
        name = result.about["policy"] + (" \\*" if result.about["reads_swarm"] else "")
        cells = [name, *([_dynamics(result)] if len(dynamics) > 1 else [])]
        cells += [_cell(result.estimates()[metric]) for metric in shown]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _dynamics(result: Evaluation) -> str:
    options = result.about["options"]
    return f"{options['dynamics']} at {options['physics_hz']} Hz"


def _cell(one: Estimate) -> str:
    return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]" if one.episodes else "-"


def write_csv(results: Sequence[Evaluation], path: Path) -> None:
    """All metrics of all evaluations: a row for each, with mean, low, high and the episodes that have the metric."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["task", "difficulty", "drones", "dynamics", "policy", "reads_swarm", "metric", *Estimate._fields])
        for result in results:
            about, options = result.about, result.about["options"]
            case = [about["task"], options["difficulty"], options["num_drones"], options["dynamics"]]
            case += [about["policy"], about["reads_swarm"]]
            estimates = result.estimates()
            writer.writerows([*case, metric, *estimates[metric]] for metric in METRICS)
