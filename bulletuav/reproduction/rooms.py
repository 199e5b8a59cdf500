"""Shared parts of flights in rooms: paths, distances, and intervals of means over rooms."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.analysis.metrics.estimates import Estimate
from bulletuav.policies.planner import PathLimits, follow_paths

MIN_ROOMS = 5
"""Minimum number of rooms of a confidence interval"""


class RoomPaths(NamedTuple):
    """Paths of the N robots of W rooms.

    Attributes:
        point: (W, N, K, 3) waypoints, m.
        num_points: (W, N) number of waypoints of each robot.
        current: (W, N) index of the current waypoint of each robot.
    """

    point: np.ndarray
    num_points: np.ndarray
    current: np.ndarray

    @classmethod
    def of(cls, found: Sequence[np.ndarray], rooms: int) -> "RoomPaths":
        """Collect the paths (K, 3) of all robots, room by room, from their first waypoints on."""
        count = np.array([len(path) for path in found]).reshape(rooms, -1)
        point = np.zeros((len(found), max(2, count.max()), 3))
        for row, path in zip(point, found, strict=True):
            row[: len(path)] = path
        return cls(point.reshape(*count.shape, -1, 3), count, np.ones_like(count))

    def follow(
        self, position: np.ndarray, velocity: np.ndarray, limits: PathLimits
    ) -> tuple[np.ndarray, "RoomPaths"]:
        """Compute the velocities (W, N, 3) along the paths, m/s, and the paths ahead."""
        width = np.full(self.num_points.shape, limits.half_width)
        wanted, current = follow_paths(position, velocity, *self, width, limits)
        return wanted, self._replace(current=current)


def find_nearest_distances(place: np.ndarray) -> np.ndarray:
    """Return the distances (W, N) of robots at (W, N, D) to the nearest others of their rooms."""
    apart = np.linalg.norm(place[:, None] - place[:, :, None], axis=-1)
    robots = np.arange(place.shape[1])
    apart[:, robots, robots] = np.inf
    nearest: np.ndarray = apart.min(axis=2)
    return nearest


def room_interval(one: Estimate) -> tuple[float, float] | tuple[None, None]:
    """Return the 95 % interval of a mean over rooms, without bounds below `MIN_ROOMS` rooms.

    The bootstrap of a few rooms claims more certainty than they give.
    """
    return (None, None) if one.episodes < MIN_ROOMS else (one.low, one.high)
