"""Animation of a recorded episode, seen from above and, if heights matter, from the south."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from PIL import Image

from bulletuav.analysis.recording import Recording
from bulletuav.errors import printable_text
from bulletuav.files import whole_file
from bulletuav.report.figures import (
    ABOVE,
    BARS,
    MAX_NUMBERED_DRONES,
    SEEN,
    SOUTH,
    UNSEEN,
    bar_lines,
    blank_figure,
    draw_buildings,
    draw_skyline,
    drone_colours,
    has_depth,
)
from bulletuav.report.video import FPS, save_video

MAX_FRAMES = 150
"""Maximum number of frames; longer episodes skip rows"""
TRAIL_DECISIONS = 30
"""Length of a trail, decisions"""
FINISHED_OPACITY = 0.25
"""Opacity of drones that have finished"""


class Animation:
    """Animation of an episode from above, and also from the south if heights matter.

    Drones are numbered discs of a visible size with trails, goals are crosses, and targets are
    dots. Circles show d_safe.

    Attributes:
        figure: The figure in which all frames are drawn.
    """

    def __init__(self, recording: Recording, d_safe: float, drone_size: float, title: str) -> None:
        """Draw the static parts of the scene.

        Args:
            recording: The episode.
            d_safe: Separation below which there is a conflict, m.
            drone_size: True diameter of a drone, m, which the caption states next to the drawn
                diameter.
            title: Title of the frames.
        """
        self._recording = recording
        self._title = printable_text(title)
        self._d_safe = d_safe
        # The last row is always shown, even if rows are skipped.
        self._frames = list(range(0, len(recording.time), -(-len(recording.time) // MAX_FRAMES)))
        if self._frames[-1] != len(recording.time) - 1:
            self._frames.append(len(recording.time) - 1)
        drones = recording.position.shape[1]
        self._colours = drone_colours(drones)
        # Drones that are small compared with the airspace are enlarged.
        span, middle = self._extent(drone_size)
        drawn = max(drone_size, 0.018 * span)
        reach = 0.56 * span + d_safe / 2
        heights = recording.position[..., 2]
        deep = has_depth(recording)
        # The view from the south is as wide as that from above, and as high as the flight and the
        # city.
        top = max(float(heights.max()), float(recording.building[:, 1, 2].max(initial=0)))
        tall = 1.1 * top + d_safe / 2 if deep else 0.0
        side = 6.0 * min(0.4, max(0.15, tall / (2 * reach)))
        self.figure = blank_figure(7, 7.4 + (0.5 + side) * deep)
        places = self.figure.subplots(
            1 + deep, 1, squeeze=False, sharex=True, height_ratios=[6.0, side][: 1 + deep]
        )[:, 0]
        self._axes = places[0]
        self._frame_axes(middle, reach)
        self._axes.set(ylabel="y north (m)")
        draw_buildings(self._axes, recording)
        if deep:
            places[1].set(ylim=(0, tall), ylabel="z up (m)")
            draw_skyline(places[1], recording)
        places[-1].set(xlabel=self._caption(drawn, drone_size))
        for axes in places:
            axes.grid(alpha=0.3)
        # Artists that change between frames, in drawing order.
        self._text = self._axes.set_title(" ")
        shown = (drawn, d_safe)
        self._views = [
            _View(axes, recording, along, *shown)
            for axes, along in zip(places, (ABOVE, SOUTH), strict=False)
        ]
        self._moving: list[Artist] = [self._text]
        for view in self._views:
            self._moving += view.artists
        # Animated artists are not part of a draw of the whole figure.
        for artist in self._moving:
            artist.set_animated(True)
        # The static background is drawn once, and each frame starts from a copy.
        canvas = self._canvas()
        canvas.draw()
        self._empty = canvas.copy_from_bbox(self.figure.bbox)

    def _canvas(self) -> FigureCanvasAgg:
        """Return the canvas of the figure."""
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        return canvas

    def _extent(self, drone_size: float) -> tuple[float, np.ndarray]:
        """Return the side of the square that contains all positions, m, and its centre."""
        recording = self._recording
        parts = (
            recording.position,
            recording.goal,
            recording.target,
            recording.obstacle,
            recording.building,
        )
        points = np.concatenate([part.reshape(-1, 3) for part in parts])[:, :2]
        low = points.min(axis=0)
        high = points.max(axis=0)
        return float(max(*(high - low), 4 * drone_size)), (low + high) / 2

    def _frame_axes(self, middle: np.ndarray, reach: float) -> None:
        """Set the limits of the axes to `reach` m on each side of the centre."""
        sides = np.array([-reach, reach])
        self._axes.set(xlim=middle[0] + sides, ylim=middle[1] + sides, aspect="equal")

    def _caption(self, drawn: float, drone_size: float) -> str:
        """Return the legend of the symbols."""
        recording = self._recording
        goals = "Crosses: goals. " if recording.goal.shape[1] else ""
        targets = (
            "Dots: targets (green: in sight, red: out of sight). "
            if recording.target.shape[1]
            else ""
        )
        return (
            f"x east (m)\n\nDiscs: drones, drawn with a diameter of {drawn:.2g} m "
            f"(true: {drone_size:.2g} m); transparent: finished.\n"
            f"{goals}{targets}Grey: obstacles and buildings (darker: higher).\n"
            f"Circles: diameter d_safe = {self._d_safe:g} m; red: conflict."
        )

    def draw(self, row: int) -> np.ndarray:
        """Draw one row of the recording.

        Args:
            row: Index of the row, 0 at the start.

        Returns:
            The frame, (height, width, 3) uint8.
        """
        for view in self._views:
            view.place(row, self._colours)
        self._text.set_text(f"{self._title}   t = {self._recording.time[row]:.1f} s")
        canvas = self._canvas()
        canvas.restore_region(self._empty)
        for artist in self._moving:
            assert artist.axes is not None
            artist.axes.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def save(self, path: Path, progress: Callable[[], None] = lambda: None) -> None:
        """Write the animation to a file.

        Args:
            path: A .gif, or a .mp4, which needs the extra `video`.
            progress: Callback after every frame.

        Raises:
            ImportError: If the extra is missing; the message names it.
            OSError: If the file cannot be written.
        """

        def pictures() -> Iterator[np.ndarray]:
            for row in self._frames:
                yield self.draw(row)
                progress()

        with whole_file(path) as part:
            if path.suffix == ".mp4":
                save_video(part, pictures())
                return
            # Fewer colours make smaller files; the octree quantizer is the fastest.
            octree = Image.Quantize.FASTOCTREE
            first, *others = (Image.fromarray(one).quantize(128, octree) for one in pictures())
            first.save(
                part,
                save_all=True,
                append_images=others,
                duration=1000 // FPS,
                loop=0,
            )

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._frames)


class _View:
    """Artists of one view of the episode, from above or from the south.

    Attributes:
        artists: The artists in drawing order.
    """

    def __init__(
        self, axes: Axes, recording: Recording, along: tuple[int, int], drawn: float, d_safe: float
    ) -> None:
        self._axes, self._recording, self._along, self._d_safe = axes, recording, along, d_safe
        drones = recording.position.shape[1]
        # Bars are drawn as lines, other obstacles as discs.
        sizes = np.where(recording.obstacle_axis.any(axis=1), 0.0, 2 * recording.obstacle_radius)
        self._bodies = self._circles(sizes, facecolors="0.8", edgecolors="0.5")
        self._bars = LineCollection([], colors=BARS, linewidths=2)
        self._goals = axes.scatter([], [], marker="x", s=60, linewidths=1.6)
        self._targets = axes.scatter([], [], marker=".", s=16)
        self._trails = LineCollection([], linewidths=1.2)
        for lines in (self._bars, self._trails):
            axes.add_collection(lines)
        self._rings = self._circles(np.full(drones, d_safe), facecolors="none", linewidths=1.2)
        self._discs = self._circles(np.full(drones, drawn), linewidths=0.5)
        numbers = range(drones if drones <= MAX_NUMBERED_DRONES else 0)
        self._numbers = [
            axes.text(0, 0, f"  {drone}", fontsize=8, va="bottom") for drone in numbers
        ]
        self.artists: list[Artist] = [self._bodies, self._bars, self._targets, self._goals]
        self.artists += [self._trails, self._rings, self._discs, *self._numbers]

    def _circles(self, diameter: np.ndarray, **style: Any) -> EllipseCollection:
        """Add circles of the given diameters, m, without positions."""
        circles = EllipseCollection(
            diameter,
            diameter,
            np.zeros(len(diameter)),
            units="x",
            offsets=np.zeros((len(diameter), 2)),
            transOffset=self._axes.transData,
            **style,
        )
        self._axes.add_collection(circles)
        return circles

    def place(self, row: int, colours: np.ndarray) -> None:
        """Move all artists to a row of the states; drones have `colours` (N, 4)."""
        recording, along = self._recording, self._along
        position = recording.position[row][:, along]
        alive = recording.alive[row]
        faces = colours.copy()
        # Drones that have finished are transparent and have no circle.
        faces[~alive, 3] = FINISHED_OPACITY
        edges = np.where(alive[:, None], (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, FINISHED_OPACITY))
        # Row k of separations belongs to the decision that ends at row k + 1 of the states.
        near = recording.separation[max(0, row - 1)] < self._d_safe
        rings = np.where(near[:, None], (0.86, 0.08, 0.24, 1.0), (0.5, 0.5, 0.5, 1.0))
        rings[~alive, 3] = 0
        # Artists are reused
        self._discs.set(offsets=position, facecolors=faces, edgecolors=edges)
        self._rings.set(offsets=position, edgecolors=rings)
        trail = recording.position[max(0, row - TRAIL_DECISIONS) : row + 1][..., along]
        self._trails.set(segments=list(trail.swapaxes(0, 1)), color=faces)
        for text, place in zip(self._numbers, position, strict=False):
            text.set_position(place)
        self._bodies.set(offsets=recording.obstacle[row][:, along])
        self._bars.set(segments=bar_lines(recording, row, along))
        # Targets and goals exist in some tasks only
        if recording.target.shape[1]:
            colour = np.where(recording.seen[row], SEEN, UNSEEN)
            self._targets.set(offsets=recording.target[row][:, along], color=colour.tolist())
        if recording.goal.shape[1]:
            self._goals.set(offsets=recording.goal[row][:, along], color=colours)
