"""Animation of a recorded episode, seen from above and, if heights matter, from the south."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.transforms import IdentityTransform

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
    draw_buildings,
    draw_skyline,
    drone_colours,
    has_depth,
)
from bulletuav.report.video import save_gif, save_video

MAX_FRAMES = 150
"""Maximum number of frames; longer episodes skip rows"""
TRAIL_DECISIONS = 30
"""Length of a trail, decisions"""
FINISHED_OPACITY = 0.25
"""Opacity of drones that have finished"""
SIDE = 5.2
"""Side of the view from above, inches"""
MARGINS = (0.8, 1.14, 0.1, 0.3)
"""Space left of the views, below, right and above, inches"""
SPACE = 0.16
"""Space between the views, inches"""
CONFLICT = (0.86, 0.08, 0.24, 1.0)
"""Colour of circles of drones in conflict"""


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
        # An even number of pixels, as videos need.
        south = round(SIDE * min(0.4, max(0.15, tall / (2 * reach))) * 50) / 50 if deep else 0.0
        above = south + SPACE if deep else 0.0
        # Margins are fixed: to fit them to the labels would take as long as to draw fifty frames.
        left, bottom, right, over = MARGINS
        width, height = left + SIDE + right, bottom + above + SIDE + over
        self.figure = Figure(figsize=(width, height))
        FigureCanvasAgg(self.figure)
        places = [
            self.figure.add_axes(
                (left / width, (bottom + up) / height, SIDE / width, high / height)
            )
            for up, high in ((above, SIDE), (0.0, south))[: 1 + deep]
        ]
        self._axes = places[0]
        sides = np.array([-reach, reach])
        self._axes.set(ylabel="y north (m)", ylim=middle[1] + sides)
        self._axes.set_title(printable_text(title), fontsize=10)
        draw_buildings(self._axes, recording)
        if deep:
            self._axes.tick_params(labelbottom=False)
            places[1].set(ylim=(0, tall), ylabel="z up (m)")
            draw_skyline(places[1], recording)
        places[-1].set_xlabel(self._caption(drawn, drone_size), fontsize=8)
        for axes in places:
            axes.set_xlim(middle[0] + sides)
            axes.grid(alpha=0.3)
            axes.tick_params(labelsize=9)
            axes.yaxis.label.set_fontsize(9)
        # The static background is drawn once, and each frame starts from a copy.
        canvas = self._canvas()
        canvas.draw()
        self._empty = canvas.copy_from_bbox(self.figure.bbox)
        self._views = [
            _View(axes, recording, along, drawn, d_safe)
            for axes, along in zip(places, (ABOVE, SOUTH), strict=False)
        ]
        self._clock = _Clock(self._axes)

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

    def _caption(self, drawn: float, drone_size: float) -> str:
        """Return the legend of the symbols."""
        recording = self._recording
        goals = ["Crosses: goals."] * bool(recording.goal.shape[1])
        dots = "Dots: targets (green: in sight, red: out of sight)."
        targets = [dots] * bool(recording.target.shape[1])
        lines = (
            f"Discs: drones, drawn with a diameter of {drawn:.2g} m (true: {drone_size:.2g} m); "
            "transparent: finished.",
            " ".join(goals + targets),
            f"Circles: diameter d_safe = {self._d_safe:g} m; red: conflict. "
            "Grey: obstacles, buildings (darker: higher).",
        )
        return "x east (m)\n\n" + "\n".join(filter(None, lines))

    def draw(self, row: int) -> np.ndarray:
        """Draw one row of the recording.

        Args:
            row: Index of the row, 0 at the start.

        Returns:
            The frame, (height, width, 3) uint8.
        """
        return self._paint(row)[..., :3].copy()

    def _paint(self, row: int) -> np.ndarray:
        """Draw one row; return the pixels (height, width, 4) of the canvas, not a copy."""
        recording = self._recording
        alive = recording.alive[row]
        # Drones that have finished are transparent and have no circle.
        faces = self._colours.copy()
        faces[~alive, 3] = FINISHED_OPACITY
        # Row k of separations belongs to the decision that ends at row k + 1 of the states.
        near = recording.separation[max(0, row - 1)] < self._d_safe
        rings = np.where(near[:, None], CONFLICT, (0.5, 0.5, 0.5, 1.0))
        rings[~alive, 3] = 0
        canvas = self._canvas()
        canvas.restore_region(self._empty)
        renderer = canvas.get_renderer()
        for view in self._views:
            view.place(row, self._colours, faces, rings)
            for artist in view.artists:
                artist.draw(renderer)
        self._clock.show(float(recording.time[row]))
        self._clock.artist.draw(renderer)
        return np.asarray(canvas.buffer_rgba())

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
                yield self._paint(row)
                progress()

        with whole_file(path) as part:
            if path.suffix == ".mp4":
                save_video(part, (picture[..., :3].copy() for picture in pictures()))
            else:
                save_gif(part, pictures())

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
        self._axes, self._recording, self._along = axes, recording, along
        drones = recording.position.shape[1]
        left, right = axes.get_xlim()
        # Pixels per metre and per point
        metre, point = axes.bbox.width / (right - left), _pixels_per_point(axes)
        self.artists: list[LineCollection | PathCollection] = []
        if recording.obstacle.shape[1]:
            # Bars are drawn as lines, other obstacles as discs.
            self._is_disc = ~recording.obstacle_axis.any(axis=1)
            radii = metre * recording.obstacle_radius[self._is_disc]
            bodies = [Outline.circle(radius=radius) for radius in radii.tolist()]
            self._bodies = self._add_shapes(bodies, facecolors="0.8", edgecolors="0.5")
            self._bars = self._add_lines(colors=BARS, linewidths=2)
        if recording.target.shape[1]:
            self._targets = self._add_shapes([Outline.circle(radius=1.4 * point)], linewidths=0)
        self._trails = self._add_lines(linewidths=1.2)
        # Goals, circles of d_safe, drones and numbers share one artist, as each artist takes time.
        # Numbers are outlines: the layout of a text takes longer than all shapes together.
        arm = 4 * point
        cross = Outline(
            [(-arm, -arm), (arm, arm), (-arm, arm), (arm, -arm)],
            [Outline.MOVETO, Outline.LINETO] * 2,
        )
        numbers = range(drones if drones <= MAX_NUMBERED_DRONES else 0)
        groups: tuple[list[Outline], ...] = (
            [cross] * recording.goal.shape[1],
            [Outline.circle(radius=metre * d_safe / 2)] * drones,
            [Outline.circle(radius=metre * drawn / 2)] * drones,
            [TextPath((5 * point, 2 * point), str(drone), size=8 * point) for drone in numbers],
        )
        self._marks = self._add_shapes(
            [outline for group in groups for outline in group],
            linewidths=np.repeat((1.6, 1.2, 0.5, 0.0), [len(group) for group in groups]),
        )
        self._numbered = len(numbers)

    def _add_lines(self, **style: Any) -> LineCollection:
        """Add lines without positions."""
        lines = LineCollection([], **style)
        self._axes.add_collection(lines, autolim=False)
        self.artists.append(lines)
        return lines

    def _add_shapes(self, outlines: Sequence[Outline], **style: Any) -> PathCollection:
        """Add shapes with outlines in pixels, without positions."""
        shapes = _pixel_shapes(self._axes, outlines, offset_transform=self._axes.transData, **style)
        self.artists.append(shapes)
        return shapes

    def place(self, row: int, colours: np.ndarray, faces: np.ndarray, rings: np.ndarray) -> None:
        """Move all artists to a row of the states.

        Args:
            row: Index of the row.
            colours: Colours of the goals, (N, 4).
            faces: Colours of the drones, (N, 4).
            rings: Colours of the circles around the drones, (N, 4).
        """
        recording, along = self._recording, self._along
        position = recording.position[row][:, along]
        goal = recording.goal[row][:, along]
        numbered = self._numbered
        nothing, black = np.zeros_like(faces), np.zeros_like(faces)
        black[:, 3] = 1
        edges = black * faces[:, 3:]
        self._marks.set(
            offsets=np.concatenate([goal, position, position, position[:numbered]]),
            facecolors=np.concatenate([nothing[: len(goal)], nothing, faces, black[:numbered]]),
            edgecolors=np.concatenate([colours[: len(goal)], rings, edges, nothing[:numbered]]),
        )
        trail = recording.position[max(0, row - TRAIL_DECISIONS) : row + 1][..., along]
        self._trails.set(segments=list(trail.swapaxes(0, 1)), color=faces)
        # Obstacles and targets exist in some tasks only
        if recording.obstacle.shape[1]:
            self._bodies.set(offsets=recording.obstacle[row, self._is_disc][:, along])
            self._bars.set(segments=bar_lines(recording, row, along))
        if recording.target.shape[1]:
            colour = np.where(recording.seen[row][:, None], to_rgba(SEEN), to_rgba(UNSEEN))
            self._targets.set(offsets=recording.target[row][:, along], facecolors=colour)


class _Clock:
    """Time in the upper right corner of the axes, beyond all positions.

    Attributes:
        artist: The characters.
    """

    def __init__(self, axes: Axes) -> None:
        self._size = 10 * _pixels_per_point(axes)
        self._outlines: dict[str, Outline] = {}
        self._corner = np.array(axes.bbox.max) - self._size
        self.artist = _pixel_shapes(axes, [], facecolors="black", linewidths=0)

    def show(self, time: float) -> None:
        """Set the time, s."""
        text = f"t = {time:.1f} s"
        # Spaces have no outline.
        visible = [k for k, character in enumerate(text) if character != " "]
        for character in {text[k] for k in visible} - self._outlines.keys():
            self._outlines[character] = TextPath(
                (0, 0), character, size=self._size, prop=FontProperties(family="monospace")
            )
        self.artist.set_paths([self._outlines[text[k]] for k in visible])
        shift = 0.6 * self._size * (np.array(visible) - len(text))
        self.artist.set_offsets(self._corner + np.outer(shift, (1, 0)))


def _pixels_per_point(axes: Axes) -> float:
    return float(axes.figure.dpi) / 72


def _pixel_shapes(axes: Axes, outlines: Sequence[Outline], **style: Any) -> PathCollection:
    """Add filled outlines in pixels to axes."""
    shapes = PathCollection(outlines, **style)
    shapes.set_transform(IdentityTransform())
    axes.add_collection(shapes, autolim=False)
    return shapes
