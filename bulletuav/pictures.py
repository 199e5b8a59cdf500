"""Pictures of a recorded episode: tracks from above with altitudes, and an animation."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from bulletuav.record import Recording

MOST_FRAMES = 150
TRAIL = 30  # decisions
FPS = 20


def _figure(width: float, height: float) -> Figure:
    """A figure without any window system."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _colours(count: int) -> np.ndarray:
    return matplotlib.colormaps["turbo"](np.linspace(0.05, 0.95, count))


def _flown(recording: Recording, drone: int) -> np.ndarray:
    """(P, 3) the drone's positions until it left."""
    return recording.position[: int(recording.alive[:-1, drone].sum()) + 1, drone]


def plot_tracks(recording: Recording, d_safe: float, title: str, path: Path) -> None:
    """Tracks from above (starts as dots, goals as crosses), altitudes and separations over time, as a PNG file."""
    figure = _figure(12, 6.5)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.15, 1])
    above, altitude, separation = (figure.add_subplot(cell) for cell in (grid[:, 0], grid[0, 1], grid[1, 1]))
    for drone, colour in enumerate(_colours(recording.position.shape[1])):
        track = _flown(recording, drone)
        above.plot(track[:, 0], track[:, 1], color=colour, lw=1.2)
        above.plot(*track[0, :2], "o", color=colour, ms=5)
        above.plot(*recording.goal[drone, :2], "x", color=colour, ms=8, mew=2)
        altitude.plot(recording.time[: len(track)], track[:, 2], color=colour, lw=1.2)
        gaps = recording.separation[: len(track) - 1, drone]
        separation.plot(recording.time[1 : len(track)], np.where(np.isfinite(gaps), gaps, np.nan), color=colour, lw=1.2)
    hit = np.argwhere(recording.collision)
    if len(hit):
        place = recording.position[hit[:, 0] + 1, hit[:, 1]]
        above.plot(place[:, 0], place[:, 1], "*", color="crimson", ms=13, mec="black", label="collision")
        above.legend(loc="upper right")
    above.set(title=title, xlabel="x east (m)", ylabel="y north (m)", aspect="equal")
    altitude.set(xlabel="time (s)", ylabel="altitude (m)")
    separation.axhline(d_safe, color="crimson", ls="--", lw=1, label=f"d_safe {d_safe:g} m")
    separation.set(xlabel="time (s)", ylabel="nearest drone (m)", ylim=(0, None))
    separation.legend(loc="upper right")
    for axes in (above, altitude, separation):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


class Animation:
    """The episode from above: drones as discs of a visible size, trails, goals, and rings of d_safe."""

    def __init__(self, recording: Recording, d_safe: float, drone_size: float, title: str):
        """`drone_size` is the real diameter, m, which the caption tells beside the drawn one."""
        self._recording, self._title = recording, title
        self._frames = list(range(0, len(recording.time), -(-len(recording.time) // MOST_FRAMES)))
        if self._frames[-1] != len(recording.time) - 1:
            self._frames.append(len(recording.time) - 1)
        points = np.concatenate([recording.position.reshape(-1, 3), recording.goal])[:, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        span = float(max(*(high - low), 4 * drone_size))
        drawn = max(drone_size, 0.018 * span)
        self.figure = _figure(7.4, 7)
        self._axes = self.figure.add_subplot()
        middle = (low + high) / 2
        reach = 0.56 * span + d_safe / 2
        self._axes.set(
            xlim=middle[0] + np.array([-reach, reach]), ylim=middle[1] + np.array([-reach, reach]), aspect="equal"
        )
        self._axes.set(
            xlabel=(
                "x east (m)\n"
                f"discs: drones, drawn {drawn:.2g} m across (real {drone_size:.2g} m), colour: altitude; crosses: goals\n"
                f"rings: {d_safe:g} m across, so drones at the same altitude are in conflict where rings overlap"
            ),
            ylabel="y north (m)",
        )
        self._axes.grid(alpha=0.3)
        self._axes.plot(*recording.goal[:, :2].T, "x", color="0.35", ms=8, mew=1.5)
        sizes = np.ones(recording.position.shape[1])
        self._trails = LineCollection([], linewidths=1.2)
        self._axes.add_collection(self._trails)
        self._rings = self._circles(d_safe * sizes, facecolors="none", edgecolors="0.5")
        self._discs = self._circles(drawn * sizes, edgecolors="black", linewidths=0.5, cmap="viridis")
        heights = recording.position[..., 2]
        self._discs.set_clim(heights.min() - 0.5, heights.max() + 0.5)
        self.figure.colorbar(self._discs, ax=self._axes, label="altitude (m)", shrink=0.8)
        self.draw(0)
        self.figure.canvas.draw()
        self.figure.set_layout_engine("none")  # laid out once; doing so for every frame takes most of the time

    def _circles(self, diameter: np.ndarray, **style: Any) -> EllipseCollection:
        angles = np.zeros(len(diameter))
        circles = EllipseCollection(
            diameter,
            diameter,
            angles,
            units="x",
            offsets=np.zeros((len(diameter), 2)),
            transOffset=self._axes.transData,
            **style,
        )
        self._axes.add_collection(circles)
        return circles

    def draw(self, row: int) -> list:
        """Show the state of one row of the recording."""
        recording = self._recording
        position = np.where(recording.alive[row][:, None], recording.position[row], np.nan)
        self._discs.set_offsets(position[:, :2])
        self._discs.set_array(recording.position[row, :, 2])
        self._rings.set_offsets(position[:, :2])
        trail = recording.position[max(0, row - TRAIL) : row + 1, recording.alive[row], :2]
        self._trails.set_segments(list(trail.swapaxes(0, 1)))
        self._trails.set_color(_colours(recording.position.shape[1])[recording.alive[row]])
        self._axes.set_title(f"{self._title}   t = {recording.time[row]:.1f} s")
        return []

    def save(self, path: Path, progress: Callable[[], None] = lambda: None) -> None:
        """Write a .gif, or a .mp4 with the extra `video` (ImportError that names it when it is missing)."""
        if path.suffix == ".mp4":
            self._save_video(path, progress)
            return
        animation = FuncAnimation(self.figure, self.draw, frames=self._frames, blit=False)
        animation.save(path, writer=PillowWriter(fps=FPS), dpi=80, progress_callback=lambda *_: progress())

    def _save_video(self, path: Path, progress: Callable[[], None]) -> None:
        try:
            import imageio_ffmpeg
        except ImportError:
            raise ImportError("mp4 needs the extra 'video': pip install 'bulletuav[video]', or write a .gif") from None
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        canvas.draw()
        width, height = canvas.get_width_height()
        writer = imageio_ffmpeg.write_frames(str(path), (width, height), fps=FPS, macro_block_size=2)
        writer.send(None)
        for row in self._frames:
            self.draw(row)
            canvas.draw()
            writer.send(np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3]))
            progress()
        writer.close()

    def __len__(self) -> int:
        return len(self._frames)
