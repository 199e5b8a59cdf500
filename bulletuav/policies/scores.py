"""Measured scores of the policies in the package, and a warning where a policy is of no use."""

import warnings
from collections.abc import Mapping
from typing import Any

from bulletuav.parsing import read_yaml
from bulletuav.policies.run import CONFIG, SHIPPED, RunConfig

SCORES = "scores.yaml"
"""File name of the measured safe success of a policy in the package, written by benchmarks/ship.py

Each difficulty has the number of episodes, and the mean with the low and high end of its interval
for the policy "trained", for "stay" and for the task's baseline.
"""


def read_scores(task: str) -> Mapping[str, Any]:
    """Read the scores of the policy in the package for a task.

    Args:
        task: Name of a task with a policy in the package.

    Returns:
        Contents of `SCORES` by difficulty, easiest first; empty if the policy was never measured.
    """
    path = SHIPPED / task / SCORES
    scores: Mapping[str, Any] = read_yaml(path) if path.is_file() else {}
    return scores


def warn_of_difficulty(task: str, difficulty: str) -> None:
    """Warn if the policy in the package is not better than `stay` at a difficulty.

    It is better if the low end of the interval of its safe success is above the high end of that of
    `stay`. A difficulty without scores causes no warning.

    Args:
        task: Name of a task with a policy in the package.
        difficulty: The difficulty to fly.
    """
    score = read_scores(task).get(difficulty)
    if score is None or is_better(score):
        return
    config = RunConfig.read(SHIPPED / task / CONFIG)
    remedy = f"train one by bulletuav train {task} --algo {config.algo} --difficulty {difficulty}"
    if config.options.get("difficulty") == difficulty:
        remedy = "it was trained there, and another one needs other settings"
    warnings.warn(
        f"the package's policy for {task} was not measurably better than 'stay' at difficulty "
        f"{difficulty!r}: safe success {show(score['trained'])} and {show(score['stay'])}; "
        f"{remedy}",
        stacklevel=4,
    )


def is_better(score: Mapping[str, Any]) -> bool:
    """Return True if the whole interval of `trained` is above that of `stay`."""
    _, low, _ = score["trained"]
    _, _, high = score["stay"]
    return bool(low > high)


def show(score: tuple[float, float, float]) -> str:
    """Format a mean with the low and high end of its interval."""
    mean, low, high = score
    return f"{mean:.2f} [{low:.2f}, {high:.2f}]"
