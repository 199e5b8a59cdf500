"""Markers of client programs in a replay: points, lines and texts, each shown for a time."""

import json
import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

MAX_VERTICES = 200_000
"""Maximum number of vertices of all markers; further markers replace the oldest ones"""
OVERHEAD_VERTICES = 4
"""Number of vertices that use as much memory as the rest of a group of markers"""
TEXT_VERTEX = 8
"""Number of characters that use as much memory as a vertex"""
MAX_SIZE = 24
"""Maximum size of points and width of lines, pixels"""
LOG = logging.getLogger("bulletuav.markers")


class _Group(NamedTuple):
    """Markers that were plotted together.

    Attributes:
        kind: "point", "line" or "text".
        vertices: (M, 3) of points and texts, or (M, 2, 3) ends of lines, m.
        style: (M, 4) uint8 red, green, blue and size, pixels.
        texts: M texts; empty for other kinds.
        start: Time of the plot, s.
        end: Time at which the markers vanish, s; infinite until they are flushed.
    """

    kind: str
    vertices: np.ndarray
    style: np.ndarray
    texts: tuple[str, ...]
    start: float
    end: float

    @property
    def weight(self) -> int:
        """Memory in vertices."""
        letters = sum(map(len, self.texts))
        return OVERHEAD_VERTICES + self.vertices.size // 3 + letters // TEXT_VERTEX


class MarkerLog:
    """Log of markers, of which the oldest ones are discarded when there are too many.

    Positions are in the world frame: east, north, up, m.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """Create a log without markers.

        Args:
            clock: Function that returns the time of the replay, s.
        """
        self._clock = clock
        self._groups: deque[_Group] = deque()
        self._weight, self._has_discarded = 0, False

    def add_points(self, points: np.ndarray, colour: Any, size: float, duration: float) -> None:
        """Add points.

        Args:
            points: (M, 3) positions, m.
            colour: (3,) red, green and blue from 0 to 1, or (M, 3); values outside are clamped.
            size: Diameter, pixels; clamped to 1 to `MAX_SIZE`.
            duration: Time until the points vanish, s; `math.inf` until `flush`.
        """
        self._add("point", np.reshape(points, (-1, 3)), colour, size, duration)

    def add_lines(self, ends: np.ndarray, colour: Any, width: float, duration: float) -> None:
        """Add lines with ends (M, 2, 3), m; see `add_points`."""
        self._add("line", np.reshape(ends, (-1, 2, 3)), colour, width, duration)

    def add_texts(
        self, texts: Sequence[str], points: np.ndarray, colour: Any, size: float, duration: float
    ) -> None:
        """Add a text at each point; see `add_points`."""
        self._add("text", np.reshape(points, (-1, 3)), colour, size, duration, tuple(texts))

    def _add(
        self,
        kind: str,
        vertices: np.ndarray,
        colour: Any,
        size: float,
        duration: float,
        texts: tuple[str, ...] = (),
    ) -> None:
        style = np.empty((len(vertices), 4), dtype=np.uint8)
        style[:, :3] = np.rint(255 * np.clip(colour, 0.0, 1.0))
        style[:, 3] = round(min(max(size, 1.0), MAX_SIZE))
        start = self._clock()
        group = _Group(kind, vertices, style, texts, start, start + duration)
        self._groups.append(group)
        self._weight += group.weight
        while self._weight > MAX_VERTICES:
            self._weight -= self._groups.popleft().weight
            if not self._has_discarded:
                LOG.warning(
                    "the replay has more than %d vertices of markers: it will lack the oldest ones",
                    MAX_VERTICES,
                )
            self._has_discarded = True

    def flush(self) -> None:
        """End the markers without a duration."""
        now = self._clock()
        for k, group in enumerate(self._groups):
            if group.end == math.inf:
                self._groups[k] = group._replace(end=now)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the markers as parts of a recording's scene; empty without markers."""
        found: dict[str, np.ndarray] = {}
        if not self._groups:
            return found
        for kind, shape in (("point", (0, 3)), ("line", (0, 2, 3))):
            groups = [group for group in self._groups if group.kind == kind]
            times = [(group.start, group.end) for group in groups for _ in group.vertices]
            vertices = [group.vertices for group in groups]
            styles = [group.style for group in groups]
            found[f"marker_{kind}"] = np.concatenate([np.zeros(shape), *vertices])
            found[f"marker_{kind}_style"] = np.concatenate([np.zeros((0, 4), np.uint8), *styles])
            found[f"marker_{kind}_time"] = np.array(times, dtype=float).reshape(-1, 2)
        texts = [
            {
                "text": text,
                "position": point.tolist(),
                "colour": style[:3].tolist(),
                "size": int(style[3]),
                # JSON has no infinity
                "time": [group.start, group.end if math.isfinite(group.end) else None],
            }
            for group in self._groups
            for text, point, style in zip(group.texts, group.vertices, group.style, strict=False)
        ]
        found["marker_text"] = np.array(json.dumps(texts))
        return found
