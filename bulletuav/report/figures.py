"""Figures without a window system, and common parts of pictures of episodes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from bulletuav.analysis.recording import Recording
from bulletuav.errors import printable_text
from bulletuav.files import whole_file

MAX_NUMBERED_DRONES = 24
"""Maximum number of drones up to which they are numbered"""
ABOVE, SOUTH = (0, 1), (0, 2)
"""Axes of the views from above and from the south"""
MIN_HEIGHT_RANGE = 0.5
"""Range of heights above which a flight is not level, m"""
SEEN = "#228833"
"""Colour of targets in sight"""
UNSEEN = "#cc3311"
"""Colour of targets out of sight"""
BARS = "#d2691e"
"""Colour of bars among the obstacles, such as those of gates"""
PAD_COLOUR = (0.1, 0.55, 0.75)
"""Colour of charging pads, red, green, blue"""
PAD_THICKNESS = 0.1
"""Thickness of charging pads in 3-D pictures, m"""
NO_PADS: Mapping[str, Any] = MappingProxyType({"places": (), "radius": 0.0})
"""Charging pads of recordings without any"""


def blank_figure(width: float, height: float) -> Figure:
    """Create a figure that needs no window system.

    Args:
        width: Width, inches.
        height: Height, inches.
    """
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08)  # type: ignore[union-attr, call-arg]
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as a picture file, atomically.

    Raises:
        OSError: If the file cannot be written.
    """
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        text.set_text(printable_text(text.get_text()))
    figure.set_dpi(110)
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    with whole_file(path) as part:
        # Figure.savefig would draw the figure twice.
        canvas.print_png(part)


def drone_colours(count: int) -> np.ndarray:
    """Return colours (count, 4) of drones, from blue to red."""
    shades = np.linspace(0.05, 0.95, count)
    return np.asarray(matplotlib.colormaps["turbo"](shades))


def bar_lines(recording: Recording, row: int, axes: Sequence[int] = ABOVE) -> list[np.ndarray]:
    """Return the bars among the obstacles as projected lines (2, 2), at a row of the states."""
    axis = recording.obstacle_axis
    is_bar = axis.any(axis=1)
    middle, half = recording.obstacle[row, is_bar][:, axes], axis[is_bar][:, axes]
    return list(np.stack([middle - half, middle + half], axis=1))


def has_depth(recording: Recording) -> bool:
    """Return True if heights differ, or there are buildings or obstacles."""
    if len(recording.building) or recording.obstacle.shape[1]:
        return True
    return float(np.ptp(recording.position[..., 2])) > MIN_HEIGHT_RANGE


def draw_skyline(axes: Axes, recording: Recording) -> None:
    """Draw the bounding boxes of the city from the south, nearer ones on top."""
    low, high = recording.building[:, 0], recording.building[:, 1]
    for k in np.argsort(-low[:, 1], kind="stable"):
        (x, _, z), (width, _, height) = low[k], high[k] - low[k]
        axes.add_patch(Rectangle((x, z), width, height, fc="0.82", ec="0.6", lw=0.4, zorder=0))


def draw_buildings(axes: Axes, recording: Recording) -> None:
    """Draw the bounding boxes of the city from above, darker for higher ones."""
    low = recording.building[:, 0]
    high = recording.building[:, 1]
    pieces = zip(low.tolist(), high.tolist(), strict=True)
    # Higher buildings are drawn later, on top of the others.
    for south_west, north_east in sorted(pieces, key=lambda piece: piece[1][2]):
        width = north_east[0] - south_west[0]
        length = north_east[1] - south_west[1]
        shade = 0.9 - 0.5 * north_east[2] / high[:, 2].max()
        axes.add_patch(
            Rectangle(
                south_west[:2],
                width,
                length,
                fc=str(shade),
                ec="none",
                zorder=0,
            )
        )
