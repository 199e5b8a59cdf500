"""Pictures of real flights beside what laws predict."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from bulletuav.report.charts import COLOURS
from bulletuav.report.figures import blank_figure, save_figure
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from flight_data import arpl, model, nanobench, predictors

Bins = Sequence[Mapping[str, float]]
HOVER = 33.0
"""Thrust of the drones whose wake was measured, grams"""
DROPS = (0.2, 0.35, 0.45, 0.65)
"""Drops of which a profile is drawn, m"""


def positions(path: Path, cut: nanobench.Windows, told: tuple[np.ndarray, np.ndarray]) -> None:
    """Draw changes of velocity within windows: predicted over measured, and how errors spread."""
    figure = blank_figure(11, 4)
    axes = figure.subplots(1, 3)
    start, end = cut.velocity[:, 0], cut.velocity[:, -1]
    for axis, part, label in ((axes[0], slice(0, 2), "horizontal"), (axes[1], 2, "vertical")):
        _against(axis, (end - start)[:, part].ravel(), (told[1] - start)[:, part].ravel())
        axis.set(title=f"{label} change of velocity in 0.5 s, m/s", xlabel="flown")
    axes[0].set_ylabel("predicted")
    still, _ = nanobench.constant_velocity(cut)
    for index, (name, position) in enumerate((("constant velocity", still), ("now", told[0]))):
        apart = np.sort(np.linalg.norm((position - cut.position[:, -1])[:, :2], axis=1))
        share = np.linspace(0.0, 1.0, len(apart))
        axes[2].plot(apart, share, color=COLOURS[1 - index], label=name)
    axes[2].set(title="horizontal error after 0.5 s, m", xlim=(0, 0.3), ylabel="share of windows")
    axes[2].legend()
    save_figure(figure, path)


def rates(path: Path, cut: arpl.Windows, told: np.ndarray) -> None:
    """Draw changes of body rates within windows: predicted over measured."""
    figure = blank_figure(11, 4)
    for axis, index, label in zip(
        figure.subplots(1, 3), range(3), ("roll", "pitch", "yaw"), strict=True
    ):
        _against(axis, (cut.end - cut.start)[:, index], (told - cut.start)[:, index])
        axis.set(title=f"change of the {label} rate in 0.5 s, rad/s", xlabel="flown")
        axis.set_ylabel("predicted")
    save_figure(figure, path)


def drag_moment(path: Path, measured: Mapping[str, Bins]) -> None:
    """Draw the moment against the velocity of a drone: law, and measured bins."""
    figure = blank_figure(6.5, 4.5)
    axes = figure.subplots()
    now = predictors.NOW
    slope = 1e3 * now.drag_height * now.rotor_drag[0] * now.hover_speed()
    axes.plot([-1.4, 1.4], [-1.4 * slope, 1.4 * slope], color=COLOURS[0], label="now")
    axes.axhline(0.0, color=COLOURS[1], ls="--", label="before")
    for half, marker in (("fit", "o"), ("kept", "D")):
        place = [row["velocity"] for row in measured[half]]
        moment = [row["moment"] for row in measured[half]]
        axes.scatter(
            place, moment, marker=marker, color=COLOURS[2], label=f"flown, {half}", zorder=3
        )
    axes.set(xlabel="velocity along a body axis, m/s", ylabel="moment against it, mN m")
    axes.legend()
    save_figure(figure, path)


def _against(axes: Axes, measured: np.ndarray, told: np.ndarray) -> None:
    """Scatter predictions over measurements, with the line on which both agree."""
    edge = 1.05 * float(np.abs(measured).max())
    axes.plot([-edge, edge], [-edge, edge], color="0.6", lw=1)
    axes.scatter(measured, told, s=6, color=COLOURS[0], alpha=0.5, linewidths=0)
    axes.set(xlim=(-edge, edge), ylim=(-edge, edge))
    axes.set_aspect("equal")


def wake(path: Path, bins: Bins) -> None:
    """Draw push and moment on the lower drone: laws, and measured bins around them."""
    figure = blank_figure(11, 6.5)
    grid = figure.subplots(2, len(DROPS) - 1, sharex=True, sharey="row")
    distance = np.linspace(0.0, 0.25, 200)
    for column, (low, high) in enumerate(pairwise(DROPS)):
        its = [row for row in bins if low <= row["drop"] < high]
        drop = np.full(200, np.mean([row["drop"] for row in its]))
        push = model.wake_force(distance, drop, np.full(200, HOVER))
        moment = STANDARD_GRAVITY * model.wake_moment(distance, drop, np.full(200, HOVER))
        before = predictors.downwash_before(distance, drop) / STANDARD_GRAVITY * 1e3
        for axes, name, law in (
            (grid[0][column], "push", push),
            (grid[1][column], "moment", moment),
        ):
            size = [4.0 + 0.06 * row["count"] for row in its]
            place, value = [row["distance"] for row in its], [row[name] for row in its]
            axes.axhline(0.0, color="0.8", lw=0.8)
            axes.plot(distance, law, color=COLOURS[0], label="now")
            axes.scatter(place, value, s=size, color=COLOURS[2], alpha=0.7, label="flown, bins")
        grid[0][column].plot(distance, before, color=COLOURS[1], ls="--", label="before")
        grid[0][column].set(title=f"{low:g} to {high:g} m below", ylim=(-1.5, 16))
        grid[1][column].set_xlabel("horizontal distance, m")
    grid[0][0].set_ylabel("push, g")
    grid[1][0].set_ylabel("moment towards the upper drone, mN m")
    grid[0][-1].legend()
    save_figure(figure, path)


def ground_effect(path: Path, measured: Mapping[str, Bins]) -> None:
    """Draw by how much thrust grows near the ground: laws, and measured bins."""
    figure = blank_figure(6.5, 4.5)
    axes = figure.subplots()
    height = np.linspace(0.015, 0.2, 300)
    before = predictors.ground_effect_of_gain(height, 11.37)
    classic = predictors.ground_effect_of_gain(height, 1.0)
    axes.plot(height, 100 * model.ground_effect(height), color=COLOURS[0], label="now")
    axes.plot(height, 100 * before, color=COLOURS[1], ls="--", label="before")
    axes.plot(height, 100 * classic, color="0.5", ls=":", label="Cheeseman and Bennett")
    for half, marker in (("fit", "o"), ("kept", "D")):
        place = [row["height"] for row in measured[half]]
        share = [100 * row["share"] for row in measured[half]]
        axes.scatter(
            place, share, marker=marker, color=COLOURS[2], label=f"flown, {half}", zorder=3
        )
    axes.set(xlabel="height of the centre of mass, m", ylabel="growth of thrust, %")
    axes.legend()
    save_figure(figure, path)
