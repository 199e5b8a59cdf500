"""Tables and picture of the leaderboard, from the rows that are there."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from leaderboard_rows import Row, read_told

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.metrics import Estimate
from bulletuav.analysis.seals import parse_call
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.files import replace_file
from bulletuav.report.charts import COLOURS
from bulletuav.report.figures import blank_figure, save_figure
from bulletuav.tasks import find_task

SHOWN = (
    "success",
    "conflict",
    "collision",
    "extra_path",
    "extra_time",
    "jerk",
    "energy",
)
"""Metrics beside safe success and score"""
READS = ("nothing", "what drones observe", "the true state")
"""What policies read, from little to much"""
COLUMNS = 3
"""Columns of the picture"""


class Entry(NamedTuple):
    """A policy in a task, over all of its seeds that are there.

    Attributes:
        policy: Its name.
        reads: What it reads, one of `READS`.
        told: What its rows tell.
        success: Safe success, over seeds; that of the first team in games between teams.
        score: What counts between policies of equal success, over seeds.
    """

    policy: str
    reads: str
    told: list[dict[str, Any]]
    success: Estimate
    score: Estimate

    @property
    def is_learned(self) -> bool:
        """Whether it was trained."""
        return self.told[0]["seed"] is not None

    def mean(self, metric: str) -> float:
        """Average a metric over the seeds; NaN where it has none."""
        means = [one["estimates"].get(metric, {}).get("mean") for one in self.told]
        return math.nan if None in means else float(np.mean(means))

    def seconds(self, kind: str) -> float:
        """Average the time of a row, s."""
        return float(np.mean([sum(one[kind].values()) for one in self.told]))


def over_seeds(told: Sequence[Mapping[str, Any]], metric: str) -> Estimate:
    """Estimate a metric over seeds, by Student's t.

    A single seed has the interval of its episodes, which tells nothing of other seeds.
    """
    from scipy import stats

    if len(told) == 1:
        return Estimate(**told[0]["estimates"][metric])
    means = [one["estimates"][metric]["mean"] for one in told]
    mean, error = float(np.mean(means)), float(stats.sem(means))
    half = float(stats.t.ppf(0.975, len(means) - 1)) * error
    return Estimate(mean, mean - half, mean + half, sum(one["episodes"] for one in told))


def read_entries(
    rows: Sequence[Row], scores: Mapping[str, str], out: Path
) -> dict[str, list[Entry]]:
    """Read all rows that are there: entries of each task, best first.

    Policies are ranked by safe success in whole per cent, and by their scores where it is equal.
    """
    found: dict[str, dict[str, list[dict[str, Any]]]] = {task: {} for task in scores}
    for row in rows:
        told = read_told(out, row)
        # Rows that were flown before a metric existed count as missing
        if told is not None and success_metric(scores[row.task]) in told["estimates"]:
            found[row.task].setdefault(row.policy, []).append(told)
    entries = {}
    for task, policies in found.items():
        ones = [
            Entry(
                policy,
                _reads(told[0]),
                told,
                over_seeds(told, success_metric(scores[task])),
                over_seeds(told, scores[task]),
            )
            for policy, told in policies.items()
        ]
        entries[task] = sorted(ones, key=lambda one: (-round(one.success.mean, 2), -one.score.mean))
    return entries


def success_metric(score: str) -> str:
    """Return the metric of safe success that belongs to a score."""
    return "team_0_success" if score == "team_0_return" else "safe_success"


def _reads(told: Mapping[str, Any]) -> str:
    """Say what a policy reads."""
    if told["reads_swarm"]:
        return READS[2]
    return READS[0] if told["policy"] == "random" else READS[1]


def rival(entries: Sequence[Entry]) -> Entry | None:
    """Find the best baseline that reads no more than what is learned does."""
    fair = [one for one in entries if not one.is_learned and one.reads != READS[2]]
    return fair[0] if fair else None


def verdict(learned: Entry, other: Entry) -> str:
    """Compare safe success by its intervals, and scores where these overlap."""
    if learned.success.low > other.success.high:
        return "beats it"
    if learned.success.high < other.success.low:
        return "misses it"
    if learned.score.low > other.score.high:
        return "beats it"
    return "misses it" if learned.score.high < other.score.low else "ties with it"


def write_tables(rows: Sequence[Row], scores: Mapping[str, str], out: Path) -> None:
    """Write leaderboard.md, leaderboard.csv and leaderboard.png.

    Args:
        rows: All rows that there are to be.
        scores: The metric that counts in each task.
        out: Folder of the leaderboard.
    """
    entries = read_entries(rows, scores, out)
    there = {
        (task, one["policy"], one["seed"])
        for task, ones in entries.items()
        for entry in ones
        for one in entry.told
    }
    lacking = [row for row in rows if (row.task, row.policy, row.seed) not in there]
    parts = [_summary(entries, scores)]
    parts += [_table(task, ones, scores[task]) for task, ones in entries.items() if ones]
    parts.append(_lacking(lacking, len(rows)))
    out.mkdir(parents=True, exist_ok=True)
    replace_file(out / "leaderboard.md", "\n".join(parts))
    replace_file(out / "leaderboard.csv", _csv(entries))
    plot(entries, scores, out / "leaderboard.png")


def _cells(one: Entry) -> list[str]:
    """Write safe success and score with their intervals."""
    success, score = one.success, one.score
    return [
        f"{success.mean:.2f} [{max(success.low, 0):.2f}, {min(success.high, 1):.2f}]",
        f"{score.mean:.1f} [{score.low:.1f}, {score.high:.1f}]",
    ]


def _line(cells: Sequence[str]) -> str:
    """Write a line of a table."""
    return f"| {' | '.join(cells)} |"


def _head(cells: Sequence[str]) -> list[str]:
    """Write the head of a table."""
    return [_line(cells), "|---" * len(cells) + "|"]


def _summary(entries: Mapping[str, Sequence[Entry]], scores: Mapping[str, str]) -> str:
    """Write the table of all tasks: the best that is learned beside its rival."""
    lines = ["# Leaderboard", ""]
    shown = ("safe success", "score")
    lines += _head(("task", "best learned", *shown, "best that reads no more", *shown, "learned"))
    for task, ones in entries.items():
        best = next((one for one in ones if one.is_learned), None)
        other = rival(ones)
        link = f"[{task}](#{task})" if ones else task
        cells = [link, *(2 * ["not flown yet", "", ""])]
        if best:
            seeds = f"{len(best.told)} seed" + "s" * (len(best.told) > 1)
            cells[1:4] = [f"`{best.policy}`, {seeds}", *_cells(best)]
        if other:
            cells[4:7] = [f"`{other.policy}`", *_cells(other)]
        lines.append(_line([*cells, verdict(best, other) if best and other else ""]))
    return "\n".join(lines) + "\n"


def _conditions(about: Mapping[str, Any]) -> str:
    """Write the task, difficulty, dynamics, episodes and seeds of the evaluation of a row."""
    call = parse_call(about["call"], trust=False)
    options = resolve_options(find_task(call["task"]), call["options"]).options
    conditions = Conditions(
        task=call["task"],
        difficulty=options.difficulty,
        dynamics=options.dynamics_name,
        episodes=about["episodes"],
        seed=call["seed"],
    )
    return str(conditions)


def _table(task: str, entries: Sequence[Entry], score: str) -> str:
    """Write the table of a task."""
    shown = [name for name in SHOWN if any(not math.isnan(one.mean(name)) for one in entries)]
    heads = ["policy", "reads", "seeds", "safe success", score.replace("_", " ")]
    heads += [name.replace("_", " ") for name in shown]
    conditions = dict.fromkeys(_conditions(told) for one in entries for told in one.told)
    lines = [f"## {task}", "", f"Each policy: {'; '.join(conditions)}.", ""]
    lines += _head([*heads, "decisions", "CPU s", "wall s"])
    for one in entries:
        seeds = ", ".join(str(told["seed"]) for told in one.told) if one.is_learned else "-"
        found = [one.mean(name) for name in shown]
        cells = [f"`{one.policy}`", one.reads, seeds, *_cells(one)]
        cells += ["-" if math.isnan(mean) else f"{mean:.2f}" for mean in found]
        steps = f"{one.told[0]['settings']['steps']:,.0f}" if one.is_learned else "-"
        times = [f"{one.seconds(kind):.0f}" for kind in ("cpu_seconds", "wall_seconds")]
        lines.append(_line([*cells, steps, *times]))
    return "\n".join(lines) + "\n"


def _lacking(rows: Sequence[Row], count: int) -> str:
    """List the rows that are missing."""
    lines = ["## Completeness", "", f"{count - len(rows)} of {count} rows are there."]
    by_policy: dict[str, list[str]] = {}
    for row in rows:
        seed = "" if row.seed is None else f", seed {row.seed}"
        by_policy.setdefault(f"`{row.policy}`{seed}", []).append(row.task)
    lines += [f"- {what}: {', '.join(tasks)}" for what, tasks in by_policy.items()]
    return "\n".join(lines[:3] + [""] * bool(rows) + lines[3:]) + "\n"


def _csv(entries: Mapping[str, Sequence[Entry]]) -> str:
    """Write a line for each row and metric."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    times = [(kind, part) for kind in ("cpu", "wall") for part in ("training", "evaluation")]
    heads = ["task", "policy", "seed", "reads", "decisions", "hash"]
    heads += [f"{kind}_{part}_s" for kind, part in times]
    writer.writerow([*heads, "metric", *Estimate._fields])
    for task, ones in entries.items():
        for entry in ones:
            for told in entry.told:
                start = [task, entry.policy, told["seed"], entry.reads]
                start += [told["settings"].get("steps"), told["hash"]]
                start += [told[f"{kind}_seconds"][part] for kind, part in times]
                for metric, found in told["estimates"].items():
                    writer.writerow([*start, metric, *found.values()])
    return text.getvalue()


def plot(entries: Mapping[str, Sequence[Entry]], scores: Mapping[str, str], path: Path) -> None:
    """Draw scores with their intervals, a panel for each task.

    Flight at random is so far from all others that they could not be told apart beside it.
    """
    drawn = {
        task: [one for one in ones if one.policy != "random"] for task, ones in entries.items()
    }
    there = {task: ones for task, ones in drawn.items() if ones}
    lines = max(1, -(-len(there) // COLUMNS))
    figure = blank_figure(4.2 * COLUMNS, 2.1 * lines)
    panels = np.ravel(figure.subplots(lines, COLUMNS, squeeze=False))
    for axes in panels[len(there) :]:
        axes.set_visible(False)
    for axes, (task, ones) in zip(panels, there.items(), strict=False):
        for place, one in enumerate(reversed(ones)):
            colour = COLOURS[0] if one.is_learned else COLOURS[1 + (one.reads == READS[2])]
            axes.plot([one.score.low, one.score.high], [place, place], color=colour, lw=2)
            axes.plot(one.score.mean, place, "o", color=colour)
        axes.set_yticks(range(len(ones)), [one.policy for one in reversed(ones)])
        axes.set_title(f"{task}, {scores[task].replace('_', ' ')}", fontsize=10)
        axes.margins(0.08, 0.15)
    marks = [
        figure.axes[0].plot([], [], "o-", color=COLOURS[k], label=label)[0]
        for k, label in enumerate(("learned", "reads no more", "reads the true state"))
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=3, frameon=False)
    save_figure(figure, path)
