"""Coordinate frames of a MAVLink vehicle: geodetic, local NED, and the airspace's ENU."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_protocol import RefusedError
from bulletuav.earth import Origin

MAX_DISTANCE = 1e5
"""Maximum distance of a position from the origin along each axis, m"""
GLOBAL_FRAMES, RELATIVE_FRAMES = (0, 5), (3, 6)
"""MAVLink frames of latitude and longitude, with the altitude above the ellipsoid or above home"""


class Site(NamedTuple):
    """Start position of a vehicle, which is its home and the origin of its local NED frame.

    Attributes:
        origin: Geodetic position of the airspace's origin.
        start: (3,) start position in the airspace, m.
        home: Latitude and longitude (deg) and altitude (m) of the start position.
    """

    origin: Origin
    start: tuple[float, ...]
    home: tuple[float, ...]

    @classmethod
    def from_start(cls, origin: Origin, start: np.ndarray) -> "Site":
        """Return the site of a vehicle that starts at a position (3,), m."""
        return cls(origin, tuple(start.tolist()), tuple(origin.to_geodetic(start).tolist()))

    @property
    def altitude(self) -> float:
        """Altitude of home, m."""
        return self.home[2]

    def to_ned(self, position: list[float]) -> tuple[float, float, float]:
        """Convert a position in the airspace into local NED, m."""
        x, y, z = (value - start for value, start in zip(position, self.start, strict=True))
        return y, x, -z

    def from_ned(self, north: float, east: float, down: float) -> tuple[float, float, float]:
        """Convert local NED into a position in the airspace, m.

        Raises:
            RefusedError: If a coordinate is not finite, or farther away than `MAX_DISTANCE`.
        """
        x, y, z = self.start
        return _check_distance((x + east, y + north, z - down))

    def from_global(
        self, frame: int, latitude: float, longitude: float, altitude: float
    ) -> tuple[float, float, float]:
        """Convert a geodetic position into a position in the airspace, m.

        Args:
            frame: MAVLink frame, which defines whether the altitude is above the ellipsoid or home.
            latitude: Latitude, deg.
            longitude: Longitude, deg.
            altitude: Altitude, m.

        Raises:
            RefusedError: If the frame is not supported, or if the position is invalid.
        """
        check_global_frame(frame)
        height = altitude + (self.altitude if frame in RELATIVE_FRAMES else 0.0)
        try:
            x, y, z = self.origin.to_local((latitude, longitude, height)).tolist()
        except ValueError:
            raise RefusedError("invalid latitude, longitude or altitude") from None
        return _check_distance((x, y, z))


def check_global_frame(frame: int) -> None:
    """Raise RefusedError for a frame that is not one of latitude and longitude."""
    if frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
        raise RefusedError(f"frame {frame}: 0, 3, 5 or 6 is needed")


def _check_distance(position: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a position if it is near enough to fly to; raise RefusedError otherwise."""
    if not all(math.isfinite(value) and abs(value) <= MAX_DISTANCE for value in position):
        raise RefusedError(f"position is more than {MAX_DISTANCE:g} m away")
    return position
