"""Pictures of a recorded episode: tracks from above with altitudes, and an animation."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle

from bulletuav.analysis.recording import Recording
from bulletuav.report.animation import Animation
from bulletuav.report.figures import (
    SEEN,
    UNSEEN,
    blank_figure,
    draw_buildings,
    drone_colours,
    save_figure,
)

__all__ = ["Animation", "blank_figure", "plot_tracks", "save_figure"]

MOST_NUMBERS = 24
"""Drones are numbered up to this many"""


def plot_tracks(recording: Recording, d_safe: float, title: str, path: Path) -> None:
    """Plot tracks from above, and altitudes and separations over time, as a PNG file.

    Starts are numbered; goals are crosses. Where there are targets they are drawn instead of goals,
    as they are at the end. Small black crosses show where shapes touched, red rings where a
    conflict began. A single drone's distance to its goal stands in for separations.

    Args:
        recording: The episode.
        d_safe: Separation below which there is a conflict, m.
        title: Title of the picture.
        path: The file.
    """
    figure = blank_figure(12, 6.5)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1])
    above = figure.add_subplot(grid[:, 0])
    altitude = figure.add_subplot(grid[0, 1])
    apart = figure.add_subplot(grid[1, 1])
    drones = recording.position.shape[1]
    # Drones first: each has its colour in all three parts.
    for drone, colour in enumerate(drone_colours(drones)):
        _draw_track(above, recording, drone, colour)
        _draw_history(altitude, apart, recording, drone, colour)
    _draw_obstacles(above, recording)
    draw_buildings(above, recording)
    _draw_targets(above, recording)
    _mark_conflicts(above, recording)
    _mark_contacts(above, recording)
    # Without marks there is nothing to explain.
    if above.get_legend_handles_labels()[0]:
        above.legend(loc="upper right")
    above.set(title=title, xlabel="x east (m)", ylabel="y north (m)", aspect="equal")
    altitude.set(xlabel="time (s)", ylabel="altitude (m)")
    altitude.ticklabel_format(useOffset=False)
    apart.set(xlabel="time (s)", ylabel="distance to goal (m)")
    if drones > 1:
        _label_separations(apart, recording, d_safe)
    for axes in (above, altitude, apart):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def _draw_track(axes: Axes, recording: Recording, drone: int, colour: np.ndarray) -> None:
    """Draw the track of a drone from above, with its start and, where it counts, its goal."""
    end = int(recording.alive[:-1, drone].sum()) + 1
    track = recording.position[:end, drone]
    goal = recording.goal[:end, drone]
    axes.plot(track[:, 0], track[:, 1], color=colour, lw=1.2)
    axes.plot(*track[0, :2], "o", color=colour, ms=5)
    if not recording.target.shape[1]:
        axes.plot(*goal[-1, :2], "x", color=colour, ms=8, mew=2)
    if recording.position.shape[1] <= MOST_NUMBERS:
        axes.annotate(
            str(drone),
            (track[0, 0], track[0, 1]),
            textcoords="offset points",
            xytext=(5, -11),
            fontsize=8,
        )


def _draw_history(
    altitude: Axes,
    apart: Axes,
    recording: Recording,
    drone: int,
    colour: np.ndarray,
) -> None:
    """Draw a drone's altitude and separation over time; the distance to its goal when alone."""
    end = int(recording.alive[:-1, drone].sum()) + 1
    track = recording.position[:end, drone]
    time = recording.time[:end]
    altitude.plot(time, track[:, 2], color=colour, lw=1.2)
    if recording.position.shape[1] > 1:
        gaps = recording.separation[: end - 1, drone]
        apart.plot(
            time[1:],
            np.where(np.isfinite(gaps), gaps, np.nan),
            color=colour,
            lw=1.2,
        )
    else:
        distance = np.linalg.norm(recording.goal[:end, drone] - track, axis=1)
        apart.plot(time, distance, color=colour, lw=1.2)


def _label_separations(axes: Axes, recording: Recording, d_safe: float) -> None:
    """Mark d_safe among separations, and leave out those that are far above it."""
    axes.axhline(d_safe, color="crimson", ls="--", lw=1, label=f"d_safe {d_safe:g} m")
    is_known = np.isfinite(recording.separation)
    nearest = float(np.min(recording.separation, where=is_known, initial=np.inf))
    top = max(5 * d_safe, 2 * nearest if np.isfinite(nearest) else 0.0)
    axes.set(ylabel="nearest drone (m)", ylim=(0, top))
    axes.legend(loc="upper right")


def _draw_obstacles(axes: Axes, recording: Recording) -> None:
    """Draw the ways of obstacles, where they were at first (dotted) and where they came to."""
    tracks = recording.obstacle.swapaxes(0, 1)
    for track, radius in zip(tracks, recording.obstacle_radius, strict=True):
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
    """Draw targets, by whether they are seen, and the ways of those that move."""
    way = recording.target[..., :2]
    seen = recording.seen[-1]
    lines = list(way.swapaxes(0, 1))
    axes.add_collection(LineCollection(lines, colors="0.7", linewidths=0.6, zorder=1))
    for some, colour, label in (
        (seen, SEEN, "in sight"),
        (~seen, UNSEEN, "out of sight"),
    ):
        if some.any():
            axes.plot(*way[-1, some].T, ".", color=colour, ms=4, label=label, zorder=1)


def _mark_conflicts(axes: Axes, recording: Recording) -> None:
    """Mark where drones were when a conflict of theirs began, if any."""
    began = np.argwhere(recording.conflicts > 0)
    if len(began):
        place = recording.position[began[:, 0] + 1, began[:, 1]]
        x, y, _ = place.T
        axes.plot(x, y, "o", color="crimson", mfc="none", ms=11, label="conflict begins")


def _mark_contacts(axes: Axes, recording: Recording) -> None:
    """Mark the points where shapes touched, if any."""
    x, y, _ = recording.contact_point.T
    if len(x):
        axes.plot(x, y, "+", color="black", ms=7, mew=1.2, label="contact", zorder=3)
