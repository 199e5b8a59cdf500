"""Tables of several evaluations side by side."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from bulletuav.analysis.evaluation import Evaluation
from bulletuav.analysis.metrics import Estimate, mean_estimate
from bulletuav.analysis.seals import add_seal
from bulletuav.files import replace_file, whole_file

LEADERBOARD = "leaderboard.json"
"""File from which a leaderboard can be flown again"""
DIGITS = 8
"""Of hashes in tables"""
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
    "in_place": "in place",
    "formation_error": "off places m",
    "shape_error": "off shape m",
    "time_to_form": "to form s",
    "gates": "gates",
    "missed": "missed",
    "overtakes": "overtakes",
    "lap_time": "lap s",
    "race_time": "race s",
}
"""Metrics of the table, with their headings; those that no episode of a table has are left out"""
FOOTNOTE = (
    "\\* reads the true state instead of observations. In brackets: 95 % confidence intervals.\n"
)
CASE = ("task", "difficulty", "drones", "dynamics", "policy", "reads_swarm", "hash")
"""Columns of the csv file that tell one evaluation from others"""


def format_leaderboard(results: Sequence[Evaluation], against: str | None = None) -> str:
    """Write a table for each task, difficulty and size of the swarm.

    Cells are means with 95 % intervals, and the first digits of the hash of all episodes; * marks
    policies that read the true state.

    Args:
        results: The evaluations.
        against: A policy. Each table is followed by one of how much more the others have than it,
            episode by episode.

    Returns:
        The tables in markdown.
    """
    groups: dict[tuple[str, str, int], list[Evaluation]] = {}
    for result in results:
        options = result.about["options"]
        case = (
            result.about["task"],
            options["difficulty"],
            options["num_drones"],
        )
        groups.setdefault(case, []).append(result)
    parts = [_format_group(*case, group, against) for case, group in groups.items()]
    return "\n".join(parts) + "\n" + FOOTNOTE


def _format_group(
    task: str, difficulty: str, drones: int, results: Sequence[Evaluation], against: str | None
) -> str:
    """Write the table of one case, and that of the differences."""
    dynamics = ", ".join(dict.fromkeys(map(_dynamics, results)))
    flown = "; ".join(dict.fromkeys(result.conditions.flown for result in results))
    title = f"### {task}, {difficulty}: {drones} drones, {dynamics}, {flown}\n"
    text = _table(title, results, [result.estimates() for result in results])
    # Policies are compared in the same dynamics.
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
        text += "\n" + _table(
            f"More than `{against}` in the same episodes:\n",
            others,
            differences,
        )
    return text


def _table(
    title: str, results: Sequence[Evaluation], estimates: Sequence[Mapping[str, Estimate]]
) -> str:
    """Write a table, a row for each result; dynamics have a column where there are several."""
    shown = [
        metric
        for metric in SHOWN
        if any(metric in found and found[metric].episodes for found in estimates)
    ]
    # A column that says the same in every row is left out.
    has_dynamics = len(set(map(_dynamics, results))) > 1
    headings = ["policy"]
    if has_dynamics:
        headings.append("dynamics")
    headings += [SHOWN[metric] for metric in shown] + ["hash"]
    lines = [title, _line(headings), "|---" * len(headings) + "|"]
    for result, found in zip(results, estimates, strict=True):
        cells = [result.about["policy"] + (" \\*" if result.about["reads_swarm"] else "")]
        if has_dynamics:
            cells.append(_dynamics(result))
        cells += [_cell(found[metric]) for metric in shown] + [result.hash[:DIGITS]]
        lines.append(_line(cells))
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    """Write a row of a table."""
    return "| " + " | ".join(cells) + " |"


def _differences(result: Evaluation, reference: Evaluation) -> dict[str, Estimate]:
    """Estimate how much more a result has than the reference, episode by episode.

    Rates have intervals of the bootstrap here, too. Episodes in which one has none do not count.
    """
    pairs = list(zip(result.rows, reference.rows, strict=True))
    return {
        metric: mean_estimate([one[metric] - other[metric] for one, other in pairs])
        for metric in SHOWN
        if metric in result.rows[0]
    }


def _dynamics(result: Evaluation) -> str:
    """Name the dynamics of a result."""
    options = result.about["options"]
    return f"{options['dynamics']} at {options['physics_hz']} Hz"


def _cell(one: Estimate) -> str:
    """Write a mean with its interval, a dash where no episode has the metric."""
    return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]" if one.episodes else "-"


def write_csv(results: Sequence[Evaluation], path: Path) -> None:
    """Write all metrics of all evaluations as a csv file, a row for each.

    The columns are the case, the metric, its mean, the interval, the episodes that have it, and the
    seed of the first episode.

    Args:
        results: The evaluations.
        path: The file.

    Raises:
        OSError: It cannot be written.
    """
    with whole_file(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*CASE, "metric", *Estimate._fields, "seed"])
        for result in results:
            about = result.about
            options = about["options"]
            case = [
                about["task"],
                options["difficulty"],
                options["num_drones"],
                options["dynamics"],
                about["policy"],
                about["reads_swarm"],
                result.hash,
            ]
            writer.writerows(
                [*case, metric, *one, about["seed"]] for metric, one in result.estimates().items()
            )


def write_json(results: Sequence[Evaluation], against: str | None, path: Path) -> None:
    """Write what is needed to fly a leaderboard again, sealed.

    Args:
        results: The evaluations.
        against: As of `format_leaderboard`.
        path: The file.

    Raises:
        OSError: It cannot be written.
    """
    cases = [{**result.about, "hash": result.hash} for result in results]
    told = add_seal({"against": against, "cases": cases})
    replace_file(path, json.dumps(told, indent=2) + "\n")
