"""Table and picture of a study."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from bulletuav.policies.space import Range
from bulletuav.report.charts import COLOURS
from bulletuav.report.figures import blank_figure, save_figure
from bulletuav.training.study import Study, Trial, best_trials, trial_conditions

COLUMNS = 4
"""Panels of the picture beside each other"""


def study_table(study: Study, trials: Sequence[Trial]) -> str:
    """Write a table of a study: its trials, best first, and those that failed.

    Args:
        study: The study.
        trials: Its trials.

    Returns:
        The table in markdown.
    """
    headings = ["trial", study.metric, *study.space]
    caption = f"{study.metric} of each trial's last evaluation: {_conditions(study, trials)}\n"
    lines = [caption, _line(headings), "|---" * len(headings) + "|"]
    best = best_trials(study, trials)
    for trial in [*best, *(one for one in trials if one.error)]:
        result = f"failed: {trial.error}" if trial.error else f"{trial.result:.4g}"
        values = [_shown(trial.values[name]) for name in study.space]
        lines.append(_line([str(trial.number), result, *values]))
    return "\n".join(lines) + "\n"


def _conditions(study: Study, trials: Sequence[Trial]) -> str:
    """Write the conditions of all results, of which there are several where these vary."""
    found = (trial_conditions(study, trial) for trial in trials if not trial.error)
    return "; ".join(dict.fromkeys(map(str, found)))


def _line(cells: Sequence[str]) -> str:
    """Write a row of a table; a bar in a cell would end it."""
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"


def _shown(value: Any) -> str:
    """Write a value with few digits."""
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


def plot_study(study: Study, trials: Sequence[Trial], path: Path) -> None:
    """Plot a study as a PNG file: its metric over the trials, and over each setting that varies.

    Args:
        study: The study.
        trials: Its trials, of which one at least did not fail.
        path: The file.
    """
    # Failed trials have no result
    done = [trial for trial in trials if not trial.error]
    results = np.array([trial.result for trial in done])
    numbers = [trial.number for trial in done]
    # One plot of the progress and one for each setting
    columns = min(COLUMNS, 1 + len(study.space))
    rows = -(-(1 + len(study.space)) // columns)
    figure = blank_figure(3.2 * columns, 2.8 * rows)
    first, *others = np.ravel(figure.subplots(rows, columns, squeeze=False))
    # How much the search still gains
    best = (np.maximum if study.maximise else np.minimum).accumulate(results)
    first.scatter(numbers, results, color=COLOURS[0], s=16, label="trial")
    first.step(numbers, best, color="black", where="post", label="best so far")
    first.set(xlabel="trial", ylabel=study.metric)
    first.legend()
    for axes, name in zip(others, study.space, strict=False):
        _scatter(axes, study, name, done)
    # Places of the grid that are left over
    for axes in others[len(study.space) :]:
        axes.set_axis_off()
    figure.suptitle(
        f"{study.run.algo}, trained with seed {study.run.seed}\n{_conditions(study, trials)}"
    )
    save_figure(figure, path)


def _scatter(axes: Axes, study: Study, name: str, done: Sequence[Trial]) -> None:
    """Draw the metric over one setting; later trials are darker, the best one is ringed."""
    searched = study.space[name]
    values = [trial.values[name] for trial in done]
    # Ranges are axes; choices are ticks, by their order
    if isinstance(searched, Range):
        places = values
        if searched.log:
            axes.set(xscale="log", xlim=(searched.low / 1.2, searched.high * 1.2))
            axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        places = [searched.values.index(value) for value in values]
        axes.set_xticks(range(len(searched.values)), [_shown(one) for one in searched.values])
    results = [trial.result for trial in done]
    numbers = [trial.number for trial in done]
    axes.scatter(places, results, c=numbers, cmap="Blues", vmin=-len(done), s=16)
    # The best one is ringed
    k = done.index(best_trials(study, done)[0])
    axes.scatter(places[k], results[k], s=90, facecolor="none", edgecolor=COLOURS[1])
    axes.set(xlabel=name)
