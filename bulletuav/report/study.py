"""Table and figure of a hyperparameter study."""

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
"""Number of panels in a row of the figure"""


def study_table(study: Study, trials: Sequence[Trial]) -> str:
    """Format the trials of a study as a table, best first, followed by the failed ones.

    Args:
        study: The study.
        trials: Its trials.

    Returns:
        The table in Markdown.
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
    """Format the conditions of all results, which may differ between trials."""
    found = (trial_conditions(study, trial) for trial in trials if not trial.error)
    return "; ".join(dict.fromkeys(map(str, found)))


def _line(cells: Sequence[str]) -> str:
    """Format a row of a table; vertical bars in cells are replaced."""
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"


def _shown(value: Any) -> str:
    """Format a value with few digits."""
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)


def plot_study(study: Study, trials: Sequence[Trial], path: Path) -> None:
    """Plot a study as a PNG file: its metric over the trials, and over each hyperparameter.

    Args:
        study: The study.
        trials: Its trials, at least one of which succeeded.
        path: The file.
    """
    # Failed trials have no result
    done = [trial for trial in trials if not trial.error]
    results = np.array([trial.result for trial in done])
    numbers = [trial.number for trial in done]
    # A panel of the progress and one for each hyperparameter
    columns = min(COLUMNS, 1 + len(study.space))
    rows = -(-(1 + len(study.space)) // columns)
    figure = blank_figure(3.2 * columns, 2.8 * rows)
    first, *others = np.ravel(figure.subplots(rows, columns, squeeze=False))
    # Progress of the search
    best = (np.maximum if study.maximise else np.minimum).accumulate(results)
    first.scatter(numbers, results, color=COLOURS[0], s=16, label="trial")
    first.step(numbers, best, color="black", where="post", label="best so far")
    first.set(xlabel="trial", ylabel=study.metric)
    first.legend()
    for axes, name in zip(others, study.space, strict=False):
        _scatter(axes, study, name, done)
    # Unused panels of the grid
    for axes in others[len(study.space) :]:
        axes.set_axis_off()
    figure.suptitle(
        f"{study.run.algo}, trained with seed {study.run.seed}\n{_conditions(study, trials)}"
    )
    save_figure(figure, path)


def _scatter(axes: Axes, study: Study, name: str, done: Sequence[Trial]) -> None:
    """Plot the metric over one hyperparameter; darker: later trials, circle: best trial."""
    searched = study.space[name]
    values = [trial.values[name] for trial in done]
    # Ranges are numeric axes; choices are ticks in their order
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
    # Circle the best trial
    k = done.index(best_trials(study, done)[0])
    axes.scatter(places[k], results[k], s=90, facecolor="none", edgecolor=COLOURS[1])
    axes.set(xlabel=name)
