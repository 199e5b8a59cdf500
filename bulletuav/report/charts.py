"""Figures of evaluations and learning curves."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from bulletuav.analysis.evaluation import Evaluation
from bulletuav.analysis.metrics import Estimate
from bulletuav.report.figures import blank_figure, save_figure
from bulletuav.training.campaign import TrainedRun
from bulletuav.training.store import Row, evaluation_conditions

COLOURS = (
    "#4477aa",
    "#ee6677",
    "#228833",
    "#ccbb44",
    "#66ccee",
    "#aa3377",
    "#bbbbbb",
)
"""P. Tol's bright colour scheme"""
RATES = ("success", "drone_success", "conflict", "collision")
"""Rates and fractions in the figure of one evaluation"""
COMPARED = ("success", "conflict", "collision", "served", "completed")
"""Metrics in the figure of several evaluations"""
NO_ESTIMATE = Estimate(np.nan, np.nan, np.nan, 0)
BINS = 40
"""Number of histogram bins"""


def plot_evaluation(result: Evaluation, path: Path) -> None:
    """Plot one evaluation as a PNG file.

    The figure shows rates with their intervals, and histograms of separations, durations and path
    efficiencies over the episodes.

    Args:
        result: The evaluation.
        path: The file.
    """
    figure = blank_figure(11, 7)
    rates, separation, duration, efficiency = np.ravel(figure.subplots(2, 2))
    # Rates with their intervals
    estimates = result.estimates()
    _draw_bars(
        rates,
        names=RATES,
        rows=[[estimates[metric] for metric in RATES]],
        labels=[""],
    )
    rates.set(title="fraction, with 95 % confidence interval", ylim=(0, 1.05))
    # Distributions over the episodes
    for axes, metric, label in (
        (separation, "min_separation", "minimum separation of an episode, m"),
        (duration, "length", "duration of an episode, s"),
        (
            efficiency,
            "path_efficiency",
            "path efficiency of the drones that succeeded",
        ),
    ):
        _draw_histogram(axes, np.array([row[metric] for row in result.rows]))
        axes.set(xlabel=label, ylabel="episodes")
    # Episodes below this line had a conflict
    about = result.about
    d_safe = about["options"]["d_safe"]
    separation.axvline(d_safe, color="crimson", ls="--", label=f"d_safe {d_safe:g} m")
    separation.legend()
    figure.suptitle(
        f"policy {about['policy']}, {about['options']['num_drones']} drones\n{result.conditions}"
    )
    save_figure(figure, path)


def _draw_histogram(axes: Axes, values: np.ndarray) -> None:
    """Draw a histogram of the finite values."""
    values = values[np.isfinite(values)]
    if len(values):
        # Values that differ by rounding only fall into one bin.
        spread = max(np.ptp(values), 0.05 * np.abs(values).max(), 0.01)
        low = values.min()
        bounds = (low - spread / 20, low + 1.05 * spread)
        axes.hist(values, bins=BINS, range=bounds, color=COLOURS[0])
    else:
        axes.text(0.5, 0.5, "no episode has this metric", ha="center", transform=axes.transAxes)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def plot_leaderboard(results: Sequence[Evaluation], path: Path) -> None:
    """Plot metrics of all policies in each task, difficulty and dynamics as a PNG file.

    Args:
        results: The evaluations.
        path: The file.
    """
    # Cases and policies in order of first appearance.
    cases = list(dict.fromkeys(_case_label(result) for result in results))
    policies = list(dict.fromkeys(result.about["policy"] for result in results))
    found = {
        (_case_label(result), result.about["policy"]): result.estimates() for result in results
    }
    metrics = [
        metric
        for metric in COMPARED
        if any(result.estimates()[metric].episodes for result in results)
    ]
    width = 2.5 + 1.1 * len(cases)
    figure = blank_figure(width, 2.7 * len(metrics))
    for axes, metric in zip(figure.subplots(len(metrics), 1, sharex=True), metrics, strict=True):
        rows = [
            [found.get((case, policy), {}).get(metric, NO_ESTIMATE) for case in cases]
            for policy in policies
        ]
        _draw_bars(axes, names=cases, rows=rows, labels=policies)
        axes.set(ylabel=metric, ylim=(0, 1.05))
    columns = min(len(policies), int(width / 1.5))
    figure.axes[0].legend(loc="lower left", ncols=columns, bbox_to_anchor=(0, 1))
    save_figure(figure, path)


def plot_curves(runs: Sequence[TrainedRun], path: Path) -> None:
    """Plot learning curves of runs as a PNG file, with a row for each task.

    The curves show the intermediate evaluations over the training steps: each seed, and the mean
    and range over seeds.

    Args:
        runs: The runs with their learning curves.
        path: The file.
    """
    tasks = list(dict.fromkeys(config.task for config, _ in runs))
    figure = blank_figure(11, 1 + 2.6 * len(tasks))
    for row, task in zip(figure.subplots(len(tasks), 3, squeeze=False), tasks, strict=True):
        curves = {config.seed: rows for config, rows in runs if config.task == task}
        conditions = [evaluation_conditions(config) for config, _ in runs if config.task == task]
        serves = not any(np.isnan(rows[-1]["completed"]) for rows in curves.values())
        metrics = ("return", "completed" if serves else "success", "conflict")
        for axes, metric in zip(row, metrics, strict=True):
            _draw_curves(axes, curves, metric)
            bounds = None if metric == "return" else (-0.05, 1.05)
            axes.set(xlabel="steps", ylabel=metric, ylim=bounds)
        row[0].set_title("; ".join(map(str, dict.fromkeys(conditions))), loc="left", fontsize=9)
        row[0].legend()
    save_figure(figure, path)


def _draw_curves(axes: Axes, curves: Mapping[int, list[Row]], metric: str) -> None:
    """Plot a metric over the steps for each seed, with mean and range if the steps agree."""
    lines = []
    for (seed, rows), colour in zip(curves.items(), itertools.cycle(COLOURS), strict=False):
        steps = [row["steps"] for row in rows]
        lines.append(np.array([row[metric] for row in rows]))
        axes.plot(steps, lines[-1], color=colour, lw=0.8, label=f"seed {seed}")
    # Runs with different evaluation steps have no common mean.
    if len(lines) > 1 and len({len(line) for line in lines}) == 1:
        low = np.min(lines, axis=0)
        high = np.max(lines, axis=0)
        axes.fill_between(steps, low, high, color="0.85", label="range")
        axes.plot(steps, np.mean(lines, axis=0), color="black", lw=2, label="mean")


def _case_label(result: Evaluation) -> str:
    """Format task, difficulty, number of drones, dynamics and episodes as lines."""
    options = result.about["options"]
    return "\n".join(
        (
            result.about["task"],
            str(options["difficulty"]),
            f"{options['num_drones']} drones",
            str(options["dynamics"]),
            *result.conditions.flown.split(", "),
        )
    )


def _draw_bars(
    axes: Axes, names: Sequence[str], rows: Sequence[Sequence[Estimate]], labels: Sequence[str]
) -> None:
    """Draw grouped bars with intervals: a group for each name, a bar for each label."""
    width = 0.8 / len(rows)
    for k, (row, label) in enumerate(zip(rows, labels, strict=True)):
        # The bars of a group are centred on its tick.
        place = np.arange(len(row)) + (k - (len(rows) - 1) / 2) * width
        mean, low, high, _ = np.array(row).T
        errors = np.maximum([mean - low, high - mean], 0)
        axes.bar(
            place,
            mean,
            width,
            color=COLOURS[k % len(COLOURS)],
            label=label,
            yerr=errors,
            ecolor="0.3",
            capsize=2,
        )
    axes.set_xticks(np.arange(len(names)), names)
    axes.grid(axis="y", alpha=0.3)
