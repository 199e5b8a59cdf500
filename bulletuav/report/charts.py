"""Pictures of evaluations."""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from bulletuav.analysis.evaluation import Evaluation
from bulletuav.analysis.metrics import Estimate
from bulletuav.report.pictures import blank_figure, save_figure
from bulletuav.training.campaign import Learned
from bulletuav.training.store import Row

COLOURS = (
    "#4477aa",
    "#ee6677",
    "#228833",
    "#ccbb44",
    "#66ccee",
    "#aa3377",
    "#bbbbbb",
)  # P. Tol's bright scheme
RATES = ("success", "drone_success", "conflict", "collision")
COMPARED = ("success", "conflict", "collision", "served", "completed")
NOTHING = Estimate(np.nan, np.nan, np.nan, 0)
BINS = 40


def plot_evaluation(result: Evaluation, path: Path) -> None:
    """Rates with their intervals, and how separations, durations and efficiencies spread over episodes, as a PNG file."""
    figure = blank_figure(11, 7)
    rates, apart, time, way = np.ravel(figure.subplots(2, 2))
    about, estimates = result.about, result.estimates()
    _bars(rates, RATES, [[estimates[metric] for metric in RATES]], [""])
    rates.set(title="share, with 95 % interval", ylim=(0, 1.05))
    d_safe = about["options"]["d_safe"]
    for axes, metric, label in (
        (apart, "min_separation", "least separation of an episode, m"),
        (time, "length", "duration of an episode, s"),
        (way, "path_efficiency", "path efficiency of the drones that succeeded"),
    ):
        values = np.array([row[metric] for row in result.rows])
        values = values[np.isfinite(values)]
        if len(values):
            spread = max(
                np.ptp(values), 0.05 * np.abs(values).max(), 0.01
            )  # rounding alone is no spread
            axes.hist(
                values,
                bins=BINS,
                range=(values.min() - spread / 20, values.min() + 1.05 * spread),
                color=COLOURS[0],
            )
        else:
            axes.text(0.5, 0.5, "no episode has it", ha="center", transform=axes.transAxes)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel=label, ylabel="episodes")
    apart.axvline(d_safe, color="crimson", ls="--", label=f"d_safe {d_safe:g} m")
    apart.legend()
    options = about["options"]
    figure.suptitle(
        f"{about['task']} {options['difficulty']}: policy {about['policy']}, {options['num_drones']} drones, "
        f"{options['dynamics']}, {len(result.rows)} episodes"
    )
    save_figure(figure, path)


def plot_leaderboard(results: Sequence[Evaluation], path: Path) -> None:
    """Rates and shares of all policies in each task, difficulty and dynamics, as a PNG file."""
    cases = list(dict.fromkeys(_case(result) for result in results))
    policies = list(dict.fromkeys(result.about["policy"] for result in results))
    found = {(_case(result), result.about["policy"]): result.estimates() for result in results}
    metrics = [
        metric
        for metric in COMPARED
        if any(result.estimates()[metric].episodes for result in results)
    ]
    width = 2.5 + 1.1 * len(cases)
    figure = blank_figure(width, 2.7 * len(metrics))
    for axes, metric in zip(figure.subplots(len(metrics), 1, sharex=True), metrics, strict=True):
        rows = [
            [found.get((case, policy), {}).get(metric, NOTHING) for case in cases]
            for policy in policies
        ]
        _bars(axes, cases, rows, policies)
        axes.set(ylabel=metric, ylim=(0, 1.05))
    figure.axes[0].legend(
        loc="lower left", ncols=min(len(policies), int(width / 1.5)), bbox_to_anchor=(0, 1)
    )
    save_figure(figure, path)


def plot_curves(runs: Sequence[Learned], path: Path) -> None:
    """What evaluations on the way found in each task over the steps: seeds, their mean and their range, as a PNG file."""
    tasks = list(dict.fromkeys(config.task for config, _ in runs))
    figure = blank_figure(11, 1 + 2.6 * len(tasks))
    for row, task in zip(figure.subplots(len(tasks), 3, squeeze=False), tasks, strict=True):
        curves = {config.seed: rows for config, rows in runs if config.task == task}
        service = not any(np.isnan(rows[-1]["completed"]) for rows in curves.values())
        for axes, metric in zip(
            row, ("return", "completed" if service else "success", "conflict"), strict=True
        ):
            _curves(axes, curves, metric)
            axes.set(
                xlabel="steps", ylabel=metric, ylim=None if metric == "return" else (-0.05, 1.05)
            )
        row[0].set_title(task, loc="left")
        row[0].legend()
    save_figure(figure, path)


def _curves(axes: Axes, curves: Mapping[int, list[Row]], metric: str) -> None:
    lines = []
    for (seed, rows), colour in zip(curves.items(), itertools.cycle(COLOURS), strict=False):
        steps = [row["steps"] for row in rows]
        lines.append(np.array([row[metric] for row in rows]))
        axes.plot(steps, lines[-1], color=colour, lw=0.8, label=f"seed {seed}")
    if len(lines) > 1 and len({len(line) for line in lines}) == 1:
        axes.fill_between(
            steps, np.min(lines, axis=0), np.max(lines, axis=0), color="0.85", label="range"
        )
        axes.plot(steps, np.mean(lines, axis=0), color="black", lw=2, label="mean")


def _case(result: Evaluation) -> str:
    options = result.about["options"]
    return f"{result.about['task']}\n{options['difficulty']}\n{options['num_drones']} drones\n{options['dynamics']}"


def _bars(
    axes: Axes, names: Sequence[str], rows: Sequence[Sequence[Estimate]], labels: Sequence[str]
) -> None:
    """Groups of bars with intervals: a row of estimates for each label, a group for each name."""
    width = 0.8 / len(rows)
    for k, (row, label) in enumerate(zip(rows, labels, strict=True)):
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
