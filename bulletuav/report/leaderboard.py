"""Several evaluations side by side."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from bulletuav.analysis.evaluation import Evaluation
from bulletuav.analysis.metrics import METRICS, Estimate, mean_estimate
from bulletuav.files import whole_file

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


def markdown(results: Sequence[Evaluation], against: str | None = None) -> str:
    """A table for each task and difficulty: means with 95 % intervals; * marks policies that read the true state.

    With `against`, a policy, each table is followed by one of how much more the others have than it, episode by episode.
    """
    groups: dict[tuple[str, str, int], list[Evaluation]] = {}
    for result in results:
        options = result.about["options"]
        groups.setdefault(
            (result.about["task"], options["difficulty"], options["num_drones"]), []
        ).append(result)
    parts = [_group(*key, group, against) for key, group in groups.items()]
    return (
        "\n".join(parts)
        + "\n\\* reads the true state instead of observations. In brackets: 95 % confidence intervals.\n"
    )


def _group(
    task: str, difficulty: str, drones: int, results: Sequence[Evaluation], against: str | None
) -> str:
    dynamics = ", ".join(dict.fromkeys(map(_dynamics, results)))
    title = f"### {task}, {difficulty}: {drones} drones, {dynamics}, {results[0].about['episodes']} episodes\n"
    text = _table(title, results, [result.estimates() for result in results])
    references = {
        _dynamics(result): result for result in results if result.about["policy"] == against
    }
    others = [
        result
        for result in results
        if result.about["policy"] != against and _dynamics(result) in references
    ]
    if others:
        differences = [_differences(result, references[_dynamics(result)]) for result in others]
        text += "\n" + _table(f"More than `{against}` in the same episodes:\n", others, differences)
    return text


def _table(
    title: str, results: Sequence[Evaluation], estimates: Sequence[Mapping[str, Estimate]]
) -> str:
    shown = [metric for metric in SHOWN if any(found[metric].episodes for found in estimates)]
    as_sequence = len(set(map(_dynamics, results))) > 1
    headings = [
        "policy",
        *(["dynamics"] if as_sequence else []),
        *(SHOWN[metric] for metric in shown),
    ]
    lines = [title, "| " + " | ".join(headings) + " |", "|---" * len(headings) + "|"]
    for result, found in zip(results, estimates, strict=True):
        name = result.about["policy"] + (" \\*" if result.about["reads_swarm"] else "")
        cells = [
            name,
            *([_dynamics(result)] if as_sequence else []),
            *(_cell(found[metric]) for metric in shown),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _differences(result: Evaluation, reference: Evaluation) -> dict[str, Estimate]:
    """Means over the episodes in which both have a metric, those of rates too, with intervals of the bootstrap."""
    pairs = list(zip(result.rows, reference.rows, strict=True))
    return {
        metric: mean_estimate([one[metric] - other[metric] for one, other in pairs])
        for metric in SHOWN
    }


def _dynamics(result: Evaluation) -> str:
    options = result.about["options"]
    return f"{options['dynamics']} at {options['physics_hz']} Hz"


def _cell(one: Estimate) -> str:
    return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]" if one.episodes else "-"


def write_csv(results: Sequence[Evaluation], path: Path) -> None:
    """All metrics of all evaluations: a row for each, with mean, low, high and the episodes that have the metric."""
    with whole_file(path) as part, part.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            [
                "task",
                "difficulty",
                "drones",
                "dynamics",
                "policy",
                "reads_swarm",
                "metric",
                *Estimate._fields,
            ]
        )
        for result in results:
            about, options = result.about, result.about["options"]
            case = [
                about["task"],
                options["difficulty"],
                options["num_drones"],
                options["dynamics"],
            ]
            case += [about["policy"], about["reads_swarm"]]
            estimates = result.estimates()
            writer.writerows([*case, metric, *estimates[metric]] for metric in METRICS)
