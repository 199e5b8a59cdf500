"""Pictures of a recorded episode: tracks from above, time series, and an animation."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from bulletuav.analysis.recording import Recording
from bulletuav.parsing import parse_json
from bulletuav.report.animation import Animation
from bulletuav.report.figures import (
    BARS,
    MAX_NUMBERED_DRONES,
    NO_PADS,
    PAD_COLOUR,
    SEEN,
    UNSEEN,
    bar_lines,
    blank_figure,
    draw_buildings,
    drone_colours,
    has_depth,
    save_figure,
)
from bulletuav.report.film import Film
from bulletuav.tasks.base import DEFAULT_SHOWS

__all__ = ["Animation", "blank_figure", "plot_tracks", "save_figure"]

ALTITUDE = "altitude (m)"
MIN_VARIATION = 1e-9
"""Range up to which values count as constant"""
OVERVIEW = (840, 640)
"""Size of the 3-D picture, pixels"""
LEGEND_DISTANCE = 4.5
"""Distance of the legend from the axis, in font sizes: below tick labels and axis label"""
MAX_PANEL_ROWS = 3
"""Maximum number of panels in a column"""
SHARED_COLOUR = "0.2"
"""Colour of values that are equal for all drones"""


def plot_tracks(
    recording: Recording,
    d_safe: float,
    title: str,
    path: Path,
    shows: Mapping[str, str] = DEFAULT_SHOWS,
) -> None:
    """Plot tracks from above, and altitudes and infos over time, as a PNG file.

    Starts are numbered discs, ends are squares, goals are crosses. Targets are drawn in their final
    state. Black crosses mark contact points, red circles the starts of conflicts. If heights
    differ, or there are obstacles or buildings, a 3-D picture is next to the view from above.

    Args:
        recording: The episode.
        d_safe: Separation below which there is a conflict, m.
        title: Title of the picture.
        path: The file.
        shows: Labels of infos by name, as in `Task.shows`. Each number has a panel; flags, counts
            and constants have none.

    Raises:
        ValueError: If there is no info of a name.
    """
    # Panels of time series, in columns on the right
    heights = {ALTITUDE: recording.position[..., 2]}
    histories = heights | {name: np.asarray(recording.get_info(name)) for name in shows}
    panels = {name: values for name, values in histories.items() if _has_history(values)}
    columns = -(-len(panels) // MAX_PANEL_ROWS)
    rows = -(-len(panels) // max(1, columns))
    # The view from above, and a 3-D picture if heights matter
    views = 2 if has_depth(recording) and recording.scene else 1
    figure = blank_figure(1 + 7 * views + 4 * columns, 6.5)
    ratios = [1.7] * views + [1.0] * columns
    grid = figure.add_gridspec(max(1, rows), len(ratios), width_ratios=ratios)
    above = figure.add_subplot(grid[:, 0])
    if views > 1:
        _draw_overview(figure.add_subplot(grid[:, 1]), recording)
    cells = [grid[k % rows, views + k // rows] for k in range(len(panels))]
    places = [figure.add_subplot(cell) for cell in cells]
    # A drone has the same colour in all panels.
    colours = drone_colours(recording.position.shape[1])
    for drone, colour in enumerate(colours):
        _draw_track(above, recording, drone, colour)
    for axes, (name, values) in zip(places, panels.items(), strict=True):
        times = recording.time[-len(values) :]
        _draw_history(axes, times, values, recording.alive[:-1], colours)
        axes.set(ylabel=shows.get(name, name))
        if name != ALTITUDE:
            axes.set_ylim(bottom=0)
        if name == "separation":
            _mark_separations(axes, values, d_safe)
    _draw_obstacles(above, recording)
    draw_buildings(above, recording)
    _draw_pads(above, recording)
    _draw_targets(above, recording)
    _mark_conflicts(above, recording)
    _mark_contacts(above, recording)
    # A legend only if there are labelled marks.
    if above.get_legend_handles_labels()[0]:
        above.legend(
            loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=LEGEND_DISTANCE, ncols=4
        )
    above.set(title=title, xlabel="x east (m)", ylabel="y north (m)", aspect="equal")
    for axes in places:
        axes.set(xlabel="time (s)")
        axes.ticklabel_format(useOffset=False)
    for axes in (above, *places):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def _has_history(values: np.ndarray) -> bool:
    """Return True for numbers that vary over time; False for flags, counts and constants."""
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values[:0]
    return bool(known.size) and float(np.ptp(known)) > MIN_VARIATION


def _draw_overview(axes: Axes, recording: Recording) -> None:
    """Draw the whole flight in 3-D."""
    film = Film(recording, "", "still", size=OVERVIEW)
    axes.imshow(film.picture(float(recording.time[-1]), reach=float("inf")))
    axes.set(title="view from the south-west; thin line: occluded")
    axes.set_axis_off()
    film.close()


def _draw_track(axes: Axes, recording: Recording, drone: int, colour: np.ndarray) -> None:
    """Draw the track of a drone from above, with its start, its end and its goal, if any."""
    end = int(recording.alive[:-1, drone].sum()) + 1
    track = recording.position[:end, drone]
    axes.plot(track[:, 0], track[:, 1], color=colour, lw=1.2)
    # The legend has the marks of one drone only.
    labels = ("start", "end", "goal") if drone == 0 else (None, None, None)
    axes.plot(*track[0, :2], "o", color=colour, ms=5, label=labels[0])
    axes.plot(*track[-1, :2], "s", color=colour, ms=6, mec="black", mew=0.6, label=labels[1])
    if recording.goal.shape[1]:
        goal = recording.goal[end - 1, drone, :2]
        axes.plot(*goal, "x", color=colour, ms=8, mew=2, label=labels[2])
    if recording.position.shape[1] <= MAX_NUMBERED_DRONES:
        axes.annotate(
            str(drone),
            (track[0, 0], track[0, 1]),
            textcoords="offset points",
            xytext=(5, -11),
            fontsize=8,
        )


def _draw_history(
    axes: Axes, time: np.ndarray, values: np.ndarray, flown: np.ndarray, colours: np.ndarray
) -> None:
    """Plot a number of each drone over time, or a single line if it is equal for all drones.

    Args:
        axes: The panel.
        time: Times, (T,), s.
        values: Values, (T, N).
        flown: Mask of the drones that flew each decision, (decisions, N) bool; `values` may have an
            additional first row for the start.
        colours: Colours of the drones, (N, 4).
    """
    known = np.where(np.isfinite(values), values, np.nan)
    if len(colours) > 1 and (values == values[:, :1]).all():
        axes.plot(time, known[:, 0], color=SHARED_COLOUR, lw=1.6, label="all drones")
        axes.legend(loc="best", fontsize=8)
        return
    ends = flown.sum(axis=0) + len(values) - len(flown)
    for row, end, colour in zip(known.T, ends, colours, strict=True):
        axes.plot(time[:end], row[:end], color=colour, lw=1.2)


def _mark_separations(axes: Axes, separation: np.ndarray, d_safe: float) -> None:
    """Mark d_safe among separations (T, N), and limit the axis to the range around it."""
    axes.axhline(d_safe, color="crimson", ls="--", lw=1, label=f"d_safe {d_safe:g} m")
    axes.set(ylim=(0, max(5 * d_safe, 2 * float(separation.min()))))
    axes.legend(loc="upper right")


def _draw_obstacles(axes: Axes, recording: Recording) -> None:
    """Draw the paths of obstacles, and their initial (dotted) and final outlines."""
    # Bars are drawn as lines, other obstacles as circles
    tracks = recording.obstacle.swapaxes(0, 1)
    is_bar = recording.obstacle_axis.any(axis=1)
    for row, style in ((0, ":"), (-1, "-")):
        lines = bar_lines(recording, row)
        axes.add_collection(LineCollection(lines, colors=BARS, linewidths=2, linestyles=style))
    # A path, and a circle at each end
    for track, radius in zip(tracks[~is_bar], recording.obstacle_radius[~is_bar], strict=True):
        axes.plot(track[:, 0], track[:, 1], color="0.6", lw=1)
        for row, style in ((0, ":"), (-1, "-")):
            axes.add_patch(
                Circle(
                    track[row, :2],
                    radius,
                    fc="0.85",
                    ec="0.5",
                    ls=style,
                    alpha=0.6,
                    zorder=0,
                )
            )


def _draw_targets(axes: Axes, recording: Recording) -> None:
    """Draw targets, coloured by whether they are in sight, and the paths of moving ones."""
    track = recording.target[..., :2]
    seen = recording.seen[-1]
    lines = list(track.swapaxes(0, 1))
    axes.add_collection(LineCollection(lines, colors="0.7", linewidths=0.6, zorder=1))
    for some, colour, label in (
        (seen, SEEN, "target in sight"),
        (~seen, UNSEEN, "target out of sight"),
    ):
        if some.any():
            axes.plot(*track[-1, some].T, ".", color=colour, ms=4, label=label, zorder=1)


def _draw_pads(axes: Axes, recording: Recording) -> None:
    """Draw the zones of charging pads."""
    if not recording.scene:
        return
    about = parse_json(str(recording.scene["about"]), "its description")
    pads = about.get("pads", NO_PADS)
    for k, (east, north, _) in enumerate(pads["places"]):
        label = "charging pad" if k == 0 else None
        zone = Circle((east, north), pads["radius"], fc=PAD_COLOUR, label=label, zorder=2)
        axes.add_patch(zone)
        # Small zones are visible in large cities, too
        axes.plot(east, north, "P", color=PAD_COLOUR, ms=6, zorder=2)


def _mark_conflicts(axes: Axes, recording: Recording) -> None:
    """Mark the positions of drones at the start of their conflicts, if any."""
    began = np.argwhere(recording.conflicts > 0)
    if len(began):
        place = recording.position[began[:, 0] + 1, began[:, 1]]
        x, y, _ = place.T
        axes.plot(x, y, "o", color="crimson", mfc="none", ms=11, label="start of conflict")


def _mark_contacts(axes: Axes, recording: Recording) -> None:
    """Mark the contact points, if any."""
    x, y, _ = recording.contact_point.T
    if len(x):
        axes.plot(x, y, "+", color="black", ms=7, mew=1.2, label="contact", zorder=3)
