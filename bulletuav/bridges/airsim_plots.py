"""AirSim's calls that plot points, lines, arrows, texts and axes, which replays show."""

import logging
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.bridges.airsim_values import (
    attitude_from_airsim,
    check_flag,
    check_number,
    read_pose,
    read_text_list,
    read_vector,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.sockets import LOG_NAME
from bulletuav.earth import ned_to_enu
from bulletuav.errors import as_sequence, shown
from bulletuav.geometry.quaternions import rotate_vectors

MAX_POINTS = 2000
"""Maximum number of points, texts or poses of a plot"""
DEFAULT_DURATION = 1.0
"""Duration of plots without one, s; AirSim draws them in a single frame"""
UNITS_PER_METRE = 100.0
"""Unreal units of arrow heads and axes per metre"""
MIN_HEAD = 0.1
"""Minimum length of the head of an arrow, as a fraction of its length"""
HEAD_ANGLE = math.radians(25.0)
TEXT_SIZE = 13.0
"""Size of texts of the default scale, pixels"""
DEFAULT_TEXT_SCALE = 5.0
AXES = np.eye(3) * (1.0, -1.0, -1.0)
"""Forward, right and down in the axes of a body (FLU); their colours are red, green and blue"""


class PlotCalls:
    """Calls that plot.

    Attributes:
        table: The calls by name.
    """

    def __init__(self, world: AirsimWorld) -> None:
        """Build the table of calls for a world."""
        self._world = world
        self._has_warned = False
        self.table: Mapping[str, Callable[..., Any]] = {
            "simPlotPoints": self._plot_points,
            "simPlotLineStrip": self._plot_line_strip,
            "simPlotLineList": self._plot_line_list,
            "simPlotArrows": self._plot_arrows,
            "simPlotStrings": self._plot_strings,
            "simPlotTransforms": self._plot_transforms,
            "simPlotTransformsWithNames": self._plot_named_transforms,
            "simFlushPersistentMarkers": self._flush,
            "simSetTraceLine": self._set_trace_line,
        }

    def _plot(self, method: str, *arguments: Any) -> None:
        """Call a method of the markers; without a replay, log once that plots are not shown."""
        markers = self._world.markers
        if markers is not None:
            getattr(markers, method)(*arguments)
        elif not self._has_warned:
            self._has_warned = True
            logging.getLogger(LOG_NAME).warning(
                "a client plots markers, which only a replay shows: start the server with "
                "--replay FILE"
            )

    def _plot_points(
        self, points: Any, colour: Any, size: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        style = (_read_colour(colour), check_number("size", size))
        self._plot(
            "add_points", _read_points(points), *style, _read_duration(duration, is_persistent)
        )

    def _plot_line_strip(
        self, points: Any, colour: Any, thickness: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        places = _read_points(points)
        self._plot_lines(places[:-1], places[1:], colour, thickness, duration, is_persistent)

    def _plot_line_list(
        self, points: Any, colour: Any, thickness: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        places = _read_points(points)
        if len(places) % 2:
            raise ValueError(f"points are {len(places)}: two for each line are needed")
        self._plot_lines(places[::2], places[1::2], colour, thickness, duration, is_persistent)

    def _plot_arrows(
        self, starts: Any, ends: Any, colour: Any, thickness: Any, arrow_size: Any, duration: Any,
        is_persistent: Any = False,
    ) -> None:  # fmt: skip
        start, end = _read_points(starts), _read_points(ends)
        _require_equal("points_end", end, start)
        tips, corners = _make_heads(start, end, check_number("arrow_size", arrow_size))
        start, end = np.concatenate([start, tips]), np.concatenate([end, corners])
        self._plot_lines(start, end, colour, thickness, duration, is_persistent)

    def _plot_lines(
        self, start: Any, end: Any, colour: Any, thickness: Any, duration: Any, is_persistent: Any
    ) -> None:
        """Plot lines with ends (M, 3), m."""
        style = (_read_colour(colour), check_number("thickness", thickness))
        ends = np.stack([start, end], axis=1)
        self._plot("add_lines", ends, *style, _read_duration(duration, is_persistent))

    def _plot_strings(
        self, strings: Any, positions: Any, scale: Any, colour: Any, duration: Any
    ) -> None:
        """Plot texts; without a duration until they are flushed, as no flag makes them persist."""
        texts, places = read_text_list("strings", strings, MAX_POINTS), _read_points(positions)
        _require_equal("strings", texts, places)
        size = TEXT_SIZE * check_number("scale", scale) / DEFAULT_TEXT_SCALE
        time = check_number("duration", duration)
        lasting = time if time > 0 else math.inf
        self._plot("add_texts", texts, places, _read_colour(colour), size, lasting)

    def _plot_transforms(
        self, poses: Any, scale: Any, thickness: Any, duration: Any, is_persistent: Any = False
    ) -> None:
        centres, ends = _read_transforms(poses, scale)
        colours = np.tile(np.eye(3), (len(centres), 1))
        lines = np.stack([np.repeat(centres, 3, axis=0), ends.reshape(-1, 3)], axis=1)
        width, lasting = (
            check_number("thickness", thickness),
            _read_duration(duration, is_persistent),
        )
        self._plot("add_lines", lines, colours, width, lasting)

    def _plot_named_transforms(
        self, poses: Any, names: Any, scale: Any, thickness: Any, text_scale: Any, colour: Any,
        duration: Any,
    ) -> None:  # fmt: skip
        texts = read_text_list("names", names, MAX_POINTS)
        centres, _ = _read_transforms(poses, scale)
        _require_equal("names", texts, centres)
        size = TEXT_SIZE * check_number("text_scale", text_scale) / DEFAULT_TEXT_SCALE
        hue, lasting = _read_colour(colour), _read_duration(duration, False)
        self._plot_transforms(poses, scale, thickness, duration)
        self._plot("add_texts", texts, centres, hue, size, lasting)

    def _flush(self) -> None:
        if self._world.markers is not None:
            self._world.markers.flush()

    def _set_trace_line(self, colour: Any, thickness: Any = 1.0, vehicle_name: str = "") -> None:
        """Validate the style of a trace, and drop it: replays show all traces by themselves."""
        self._world.vehicle(vehicle_name)
        _read_colour(colour)
        check_number("thickness", thickness)


def _read_points(value: Any) -> np.ndarray:
    """Convert points of a call to positions (M, 3), east, north, up of the origin, m."""
    points = as_sequence("points", value, most=MAX_POINTS)
    return ned_to_enu(np.array([read_vector("point", one) for one in points]).reshape(-1, 3))


def _read_colour(value: Any) -> np.ndarray:
    """Return red, green and blue of a colour of a call, (3,); markers are opaque."""
    parts = as_sequence("color_rgba", value, 4)
    return np.array([check_number("color_rgba", part) for part in parts][:3])


def _read_duration(duration: Any, is_persistent: Any) -> float:
    """Return the duration of markers, s."""
    seconds = check_number("duration", duration)
    if check_flag("is_persistent", is_persistent):
        return math.inf
    return seconds if seconds > 0 else DEFAULT_DURATION


def _read_transforms(poses: Any, scale: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres (M, 3) of poses and the ends (M, 3, 3) of their axes, m."""
    axes = AXES * check_number("scale", scale) / UNITS_PER_METRE
    read = [read_pose(pose) for pose in as_sequence("poses", poses, most=MAX_POINTS)]
    if not all(np.isfinite(position).all() and np.isfinite(turn).all() for position, turn in read):
        raise ValueError(f"poses are {shown(poses)}: finite numbers are needed")
    centres = ned_to_enu(np.array([position for position, _ in read]).reshape(-1, 3))
    ends = [
        centre + rotate_vectors(attitude_from_airsim(turn), axes)
        for centre, (_, turn) in zip(centres, read, strict=True)
    ]
    return centres, np.array(ends).reshape(-1, 3, 3)


def _make_heads(start: np.ndarray, end: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the two strokes of each arrow head, at the tip and behind it.

    Args:
        start: (M, 3) starts of the arrows, m.
        end: (M, 3) tips, m.
        size: Length of the heads, Unreal units.

    Returns:
        (2 M, 3) tips and (2 M, 3) other ends, m.
    """
    along = end - start
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.maximum(length, 1e-9)
    # A horizontal direction across the arrow; of vertical arrows, north
    across = np.cross(along, (0.0, 0.0, 1.0))
    width = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(width > 1e-6, across / np.maximum(width, 1e-6), (0.0, 1.0, 0.0))
    head = np.maximum(abs(size) / UNITS_PER_METRE, MIN_HEAD * length)
    back, side = math.cos(HEAD_ANGLE) * head * along, math.sin(HEAD_ANGLE) * head * across
    return np.tile(end, (2, 1)), np.concatenate([end - back - side, end - back + side])


def _require_equal(name: str, values: Any, others: Any) -> None:
    """Raise ValueError unless there are as many values as points."""
    if len(values) != len(others):
        raise ValueError(f"{name} are {len(values)}: one for each of {len(others)} is needed")
