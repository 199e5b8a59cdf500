"""Pictures of a recorded episode: tracks from above with altitudes, and an animation."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

from bulletuav.analysis.recording import Recording
from bulletuav.errors import missing
from bulletuav.files import whole_file

MOST_FRAMES = 150
TRAIL = 30  # decisions
FPS = 20
MOST_NUMBERS = 24  # more drones than this are not numbered
SEEN, UNSEEN = "#228833", "#cc3311"
GONE = 0.25  # opacity of drones that have finished


def blank_figure(width: float, height: float) -> Figure:
    """A figure without any window system."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08)  # type: ignore[union-attr, call-arg]
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as a picture file, whole or not at all."""
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)


def _colours(count: int) -> np.ndarray:
    return matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, count))


def plot_tracks(recording: Recording, d_safe: float, title: str, path: Path) -> None:
    """Tracks from above (starts numbered, goals as crosses), altitudes and separations over time, as a PNG file.

    Where there are targets they are drawn instead of goals, as they are at the end. Collisions are stars, places where a
    conflict began red rings. A single drone's distance to its goal stands in for separations.
    """
    figure = blank_figure(12, 6.5)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1])
    above, altitude, apart = (
        figure.add_subplot(cell) for cell in (grid[:, 0], grid[0, 1], grid[1, 1])
    )
    drones = recording.position.shape[1]
    for drone, colour in enumerate(_colours(drones)):
        end = int(recording.alive[:-1, drone].sum()) + 1
        track, time = recording.position[:end, drone], recording.time[:end]
        goal = recording.goal[:end, drone]
        above.plot(track[:, 0], track[:, 1], color=colour, lw=1.2)
        above.plot(*track[0, :2], "o", color=colour, ms=5)
        if not recording.target.shape[1]:
            above.plot(*goal[-1, :2], "x", color=colour, ms=8, mew=2)
        if drones <= MOST_NUMBERS:
            above.annotate(
                str(drone),
                (track[0, 0], track[0, 1]),
                textcoords="offset points",
                xytext=(5, -11),
                fontsize=8,
            )
        altitude.plot(time, track[:, 2], color=colour, lw=1.2)
        if drones > 1:
            gaps = recording.separation[: end - 1, drone]
            apart.plot(time[1:], np.where(np.isfinite(gaps), gaps, np.nan), color=colour, lw=1.2)
        else:
            apart.plot(time, np.linalg.norm(goal - track, axis=1), color=colour, lw=1.2)
    for track, radius in zip(
        recording.obstacle.swapaxes(0, 1), recording.obstacle_radius, strict=True
    ):
        above.plot(track[:, 0], track[:, 1], color="0.6", lw=1)
        for row, style in ((0, ":"), (-1, "-")):  # where it was and where it came to
            above.add_patch(
                Circle(track[row, :2], radius, fc="0.85", ec="0.5", ls=style, alpha=0.6, zorder=0)
            )
    _draw_buildings(above, recording)
    _draw_targets(above, recording)
    _mark(above, recording, recording.conflicts > 0, "o", "conflict begins", mfc="none")
    _mark(above, recording, recording.collision, "*", "collision", mec="black")
    if above.get_legend_handles_labels()[0]:
        above.legend(loc="upper right")
    above.set(title=title, xlabel="x east (m)", ylabel="y north (m)", aspect="equal")
    altitude.set(xlabel="time (s)", ylabel="altitude (m)")
    altitude.ticklabel_format(useOffset=False)
    apart.set(xlabel="time (s)", ylabel="distance to goal (m)")
    if drones > 1:
        apart.axhline(d_safe, color="crimson", ls="--", lw=1, label=f"d_safe {d_safe:g} m")
        nearest = float(
            np.min(recording.separation, where=np.isfinite(recording.separation), initial=np.inf)
        )
        top = max(5 * d_safe, 2 * nearest if np.isfinite(nearest) else 0.0)
        apart.set(ylabel="nearest drone (m)", ylim=(0, top))
        apart.legend(loc="upper right")
    for axes in (above, altitude, apart):
        axes.grid(alpha=0.3)
    save_figure(figure, path)


def _draw_buildings(axes: Axes, recording: Recording) -> None:
    """The pieces' bounding boxes from above, the higher the darker."""
    low, high = recording.building[:, 0], recording.building[:, 1]
    for south_west, north_east in sorted(
        zip(low.tolist(), high.tolist(), strict=True), key=lambda piece: piece[1][2]
    ):
        width, length = north_east[0] - south_west[0], north_east[1] - south_west[1]
        shade = 0.9 - 0.5 * north_east[2] / high[:, 2].max()
        axes.add_patch(Rectangle(south_west[:2], width, length, fc=str(shade), ec="none", zorder=0))


def _draw_targets(axes: Axes, recording: Recording) -> None:
    """Targets, by whether they are seen, and the ways of those that move."""
    way, seen = recording.target[..., :2], recording.seen[-1]
    axes.add_collection(
        LineCollection(list(way.swapaxes(0, 1)), colors="0.7", linewidths=0.6, zorder=1)
    )
    for some, colour, label in ((seen, SEEN, "in sight"), (~seen, UNSEEN, "out of sight")):
        if some.any():
            axes.plot(*way[-1, some].T, ".", color=colour, ms=4, label=label, zorder=1)


def _mark(
    axes: Axes, recording: Recording, events: np.ndarray, marker: str, label: str, **style: Any
) -> None:
    """Marks where events (T, N) happened, if any."""
    hit = np.argwhere(events)
    if len(hit):
        place = recording.position[hit[:, 0] + 1, hit[:, 1]]
        style = {"mec": "crimson", **style}
        axes.plot(place[:, 0], place[:, 1], marker, color="crimson", ms=11, label=label, **style)


class Animation:
    """The episode from above: drones as discs of a visible size, trails, goals, and rings of d_safe."""

    def __init__(self, recording: Recording, d_safe: float, drone_size: float, title: str):
        """`drone_size` is the real diameter, m, which the caption tells beside the drawn one."""
        self._recording, self._title, self._d_safe = recording, title, d_safe
        self._frames = list(range(0, len(recording.time), -(-len(recording.time) // MOST_FRAMES)))
        if self._frames[-1] != len(recording.time) - 1:
            self._frames.append(len(recording.time) - 1)
        drones = recording.position.shape[1]
        self._colours = _colours(drones)
        span, middle = self._extent(drone_size)
        drawn = max(drone_size, 0.018 * span)
        self.figure = blank_figure(7, 7.4)
        self._axes = self.figure.add_subplot()
        reach = 0.56 * span + d_safe / 2
        self._axes.set(
            xlim=middle[0] + np.array([-reach, reach]),
            ylim=middle[1] + np.array([-reach, reach]),
            aspect="equal",
        )
        events = (
            "Dots: targets, green in sight." if recording.target.shape[1] else "Crosses: goals."
        )
        self._axes.set(
            xlabel=(
                f"x east (m)\n\nDiscs: drones, drawn {drawn:.2g} m across (real {drone_size:.2g} m), pale once they have "
                f"finished.\n{events} Grey: obstacles, buildings (darker: higher).\n"
                f"Rings: {d_safe:g} m across, red while another drone is "
                f"nearer."
            ),
            ylabel="y north (m)",
        )
        self._axes.grid(alpha=0.3)
        _draw_buildings(self._axes, recording)
        self._text = self._axes.set_title(" ")
        self._bodies = self._circles(
            2 * recording.obstacle_radius, facecolors="0.8", edgecolors="0.5"
        )
        self._goals = self._axes.scatter([], [], marker="x", s=60, linewidths=1.6)
        self._targets = self._axes.scatter([], [], marker=".", s=16)
        self._trails = LineCollection([], linewidths=1.2)
        self._axes.add_collection(self._trails)
        self._rings = self._circles(np.full(drones, d_safe), facecolors="none", linewidths=1.2)
        self._discs = self._circles(np.full(drones, drawn), linewidths=0.5)
        self._moving: list[Artist] = [
            self._text,
            self._bodies,
            self._targets,
            self._goals,
            self._trails,
            self._rings,
            self._discs,
        ]
        for artist in self._moving:
            artist.set_animated(True)
        self.figure.canvas.draw()
        self._empty = self.figure.canvas.copy_from_bbox(self.figure.bbox)  # type: ignore[attr-defined]

    def _extent(self, drone_size: float) -> tuple[float, np.ndarray]:
        """Side of the square that holds everything, m, and its middle."""
        recording = self._recording
        parts = (recording.position, recording.goal, recording.obstacle, recording.building)
        points = np.concatenate([part.reshape(-1, 3) for part in parts])[:, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        return float(max(*(high - low), 4 * drone_size)), (low + high) / 2

    def _circles(self, diameter: np.ndarray, **style: Any) -> EllipseCollection:
        angles, nowhere = np.zeros(len(diameter)), np.zeros((len(diameter), 2))
        circles = EllipseCollection(
            diameter,
            diameter,
            angles,
            units="x",
            offsets=nowhere,
            transOffset=self._axes.transData,
            **style,
        )
        self._axes.add_collection(circles)
        return circles

    def draw(self, row: int) -> np.ndarray:
        """(height, width, 3) uint8 picture of one row of the recording."""
        recording = self._recording
        position, goal, alive = (
            recording.position[row, :, :2],
            recording.goal[row, :, :2],
            recording.alive[row],
        )
        colours = self._colours.copy()
        colours[~alive, 3] = GONE
        edges = np.where(alive[:, None], (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, GONE))
        near = recording.separation[max(0, row - 1)] < self._d_safe
        rings = np.where(near[:, None], (0.86, 0.08, 0.24, 1.0), (0.5, 0.5, 0.5, 1.0))
        rings[~alive, 3] = 0
        self._discs.set(offsets=position, facecolors=colours, edgecolors=edges)
        self._rings.set(offsets=position, edgecolors=rings)
        self._bodies.set(offsets=recording.obstacle[row, :, :2])
        if recording.target.shape[1]:
            colour = np.where(recording.seen[row], SEEN, UNSEEN)
            self._targets.set(offsets=recording.target[row, :, :2], color=colour.tolist())
        else:
            self._goals.set(offsets=goal, color=self._colours)
        trail = recording.position[max(0, row - TRAIL) : row + 1, :, :2]
        self._trails.set(segments=list(trail.swapaxes(0, 1)), color=colours)
        self._text.set_text(f"{self._title}   t = {recording.time[row]:.1f} s")
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        canvas.restore_region(self._empty)
        for artist in self._moving:
            self._axes.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def save(self, path: Path, progress: Callable[[], None] = lambda: None) -> None:
        """Write a .gif, or a .mp4 with the extra `video` (ImportError that names it when it is missing)."""

        def pictures() -> Iterator[np.ndarray]:
            for row in self._frames:
                yield self.draw(row)
                progress()

        with whole_file(path) as part:
            if path.suffix == ".mp4":
                _save_video(part, pictures())
                return
            first, *others = (Image.fromarray(picture).quantize(128) for picture in pictures())
            first.save(part, save_all=True, append_images=others, duration=1000 // FPS, loop=0)

    def __len__(self) -> int:
        return len(self._frames)


def _save_video(path: Path, pictures: Iterator[np.ndarray]) -> None:
    try:
        import imageio_ffmpeg
    except ImportError:
        raise missing("writing a video (.mp4; a .gif needs nothing)", "video") from None
    first, count = next(pictures), 1
    writer = imageio_ffmpeg.write_frames(str(path), first.shape[1::-1], fps=FPS, macro_block_size=2)
    writer.send(None)
    writer.send(first)
    for picture in pictures:
        writer.send(picture)
        count += 1
    writer.close()
    if (
        imageio_ffmpeg.count_frames_and_secs(str(path))[0] < count
    ):  # it does not tell of a full disk
        raise OSError("fewer pictures were written than there are; is the disk full?")
