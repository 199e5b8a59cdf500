"""Rows of the leaderboard: which there are to be, and what those tell that are there."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from bulletuav.report.verification import ROW

ROWS = "rows"
"""Folder of the finished rows, in that of the leaderboard"""


class Row(NamedTuple):
    """A row: a policy in a task.

    Attributes:
        task: Name of the task.
        policy: Name of an algorithm or a baseline.
        seed: Seed of the training; None for baselines.
        settings: All that decides it, made of plain values.
    """

    task: str
    policy: str
    seed: int | None
    settings: dict[str, Any]

    @property
    def name(self) -> str:
        """Its name, which is that of its folder."""
        parts = [self.task, self.policy]
        return "-".join(parts if self.seed is None else [*parts, str(self.seed)])


def list_rows(told: Mapping[str, Any]) -> list[Row]:
    """List the rows that settings decide, in the order in which they are made."""
    tasks, algorithms = told["tasks"], told["algorithms"]
    first, *seeds = told["seeds"]
    everywhere = [name for name, one in algorithms.items() if "tasks" not in one]
    rows = []
    # Task by task at first, so that tables are whole where there are any
    for task, one in tasks.items():
        flown = {name: one[name] for name in ("options", "against", "metrics") if name in one}
        flown["evaluation"] = told["evaluation"]
        rows += [Row(task, policy, None, flown) for policy in one["baselines"]]
        rows += [_learned(told, task, name, first) for name in everywhere]
    rest = [(first, name) for name in algorithms if name not in everywhere]
    rest += [(seed, name) for seed in seeds for name in algorithms]
    for seed, name in rest:
        of_all = algorithms[name].get("tasks", tasks)
        rows += [_learned(told, task, name, seed) for task in of_all]
    return rows


def _learned(told: Mapping[str, Any], task: str, name: str, seed: int) -> Row:
    """Make the row of an algorithm in a task."""
    settings = {**told["algorithms"][name], **told["tasks"][task]}
    settings |= {key: told[key] for key in ("evaluation", "points")}
    # What other policies do decides nothing here
    for key in ("tasks", "baselines", "score"):
        settings.pop(key, None)
    return Row(task, name, seed, settings)


def read_told(out: Path, row: Row) -> dict[str, Any] | None:
    """Read what a row tells; None where it is not there, or was made by other settings."""
    try:
        told: dict[str, Any] = json.loads((out / ROWS / row.name / ROW).read_text())
    except FileNotFoundError:
        return None
    return told if told["settings"] == row.settings else None
