"""Tables of several evaluations: Markdown, CSV, and JSON for verification."""

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
"""Number of digits of hashes in tables"""
SHOWN = {
    "safe_success": "safe success",
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
"""Metrics of the table with their headings; those that no episode of a table has are omitted"""
FOOTNOTE = (
    "\\* reads the true state instead of observations. In brackets: 95 % confidence intervals.\n"
)
CASE = ("task", "difficulty", "drones", "dynamics", "policy", "reads_swarm", "hash")
"""Columns of the CSV file that identify an evaluation"""


def format_leaderboard(results: Sequence[Evaluation], against: str | None = None) -> str:
    """Format a table for each task, difficulty and number of drones.

    Cells are means with 95 % intervals, and the first digits of the hash of all episodes. An
    asterisk marks policies that read the true state.

    Args:
        results: The evaluations.
        against: A reference policy. Each table is followed by a table of the other policies'
            differences to it, paired by episode.

    Returns:
        The tables in Markdown.
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
    """Format the tables of one case."""
    dynamics = ", ".join(dict.fromkeys(map(_dynamics, results)))
    flown = "; ".join(dict.fromkeys(result.conditions.flown for result in results))
    title = f"### {task}, {difficulty}: {drones} drones, {dynamics}, {flown}\n"
    text = _table(title, results, [result.estimates() for result in results])
    # Differences are formed within the same dynamics.
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
    """Format a table with a row for each result, and a column of dynamics if they differ."""
    shown = [
        metric
        for metric in SHOWN
        if any(metric in found and found[metric].episodes for found in estimates)
    ]
    # A column of equal cells is omitted.
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
    """Format a row of a table."""
    return "| " + " | ".join(cells) + " |"


def _differences(result: Evaluation, reference: Evaluation) -> dict[str, Estimate]:
    """Estimate the differences of a result to the reference, paired by episode.

    Rates have bootstrap intervals here, too. Episodes in which either value is missing are ignored.
    """
    pairs = list(zip(result.rows, reference.rows, strict=True))
    return {
        metric: mean_estimate([one[metric] - other[metric] for one, other in pairs])
        for metric in SHOWN
        if metric in result.rows[0]
    }


def _dynamics(result: Evaluation) -> str:
    """Format the dynamics of a result."""
    options = result.about["options"]
    return f"{options['dynamics']} at {options['physics_hz']} Hz"


def _cell(one: Estimate) -> str:
    """Format a mean with its interval, or a dash if no episode has the metric."""
    return f"{one.mean:.2f} [{one.low:.2f}, {one.high:.2f}]" if one.episodes else "-"


def write_csv(results: Sequence[Evaluation], path: Path) -> None:
    """Write all metrics of all evaluations as a CSV file, a row for each metric of each evaluation.

    The columns are the case, the metric, its mean, the interval, the number of episodes that have
    the metric, and the seed of the first episode.

    Args:
        results: The evaluations.
        path: The file.

    Raises:
        OSError: If the file cannot be written.
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
    """Write the description from which a leaderboard can be flown again, with a seal.

    Args:
        results: The evaluations.
        against: Reference policy, as for `format_leaderboard`.
        path: The file.

    Raises:
        OSError: If the file cannot be written.
    """
    cases = [{**result.about, "hash": result.hash} for result in results]
    content = add_seal({"against": against, "cases": cases})
    replace_file(path, json.dumps(content, indent=2) + "\n")
