"""Figures of an identification: measured flights and predictions."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes

from bulletuav.report.charts import COLOURS
from bulletuav.report.figures import blank_figure, save_figure


class CurveLike(Protocol):
    """Measured and predicted values of a quantity, see `identification.curves.Curve`."""

    @property
    def label(self) -> str:
        """Name of the quantity with its unit."""

    @property
    def time(self) -> np.ndarray:
        """Times, (L, num_states), s."""

    @property
    def measured(self) -> np.ndarray:
        """Measured values, (L, num_states)."""

    @property
    def before(self) -> np.ndarray:
        """Predictions of the initial airframe, (L, num_states)."""

    @property
    def after(self) -> np.ndarray:
        """Predictions of the fitted airframe, (L, num_states)."""


def plot_identification(curves: Sequence[CurveLike], title: str, path: Path) -> None:
    """Plot predictions against measurements of a flight as a PNG file.

    Args:
        curves: The quantities, an even number.
        title: Title of the figure.
        path: The file.
    """
    figure = blank_figure(12, 1 + 1.1 * len(curves))
    panels = figure.subplots(len(curves) // 2, 2, sharex=True)
    for axes, curve in zip(np.ravel(panels, order="F"), curves, strict=True):
        _draw(axes, curve)
    panels[0, 0].legend(loc="upper right", ncols=3, fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("time, s")
    figure.suptitle(title)
    save_figure(figure, path)


def _draw(axes: Axes, curve: CurveLike) -> None:
    """Plot one quantity; each leg's prediction starts from a measured state."""
    axes.plot(curve.time.ravel(), curve.measured.ravel(), ".", color="0.2", ms=3, label="measured")
    pairs = (("before", curve.before, COLOURS[1]), ("after", curve.after, COLOURS[0]))
    for name, values, colour in pairs:
        for k, (time, value) in enumerate(zip(curve.time, values, strict=True)):
            axes.plot(time, value, color=colour, lw=1.2, label=None if k else name)
    # The limits follow the measurements, as predictions may diverge
    span = max(float(np.ptp(curve.measured)), 1e-3)
    low, high = float(curve.measured.min()), float(curve.measured.max())
    axes.set(ylabel=curve.label, ylim=(low - 0.5 * span, high + 0.5 * span))
    axes.grid(alpha=0.3)
