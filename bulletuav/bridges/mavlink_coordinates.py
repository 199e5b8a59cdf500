"""Places of a MAVLink vehicle: on the Earth, north-east-down of its start, and here."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.mavlink_protocol import RefusedError
from bulletuav.earth import Origin

MAX_DISTANCE = 1e5
"""How far from the origin places may be, m"""
GLOBAL_FRAMES, RELATIVE_FRAMES = (0, 5), (3, 6)
"""MAVLink's frames of latitude and longitude: altitudes above the ellipsoid, or above home"""


class Site(NamedTuple):
    """Where a vehicle's coordinates begin.

    Attributes:
        origin: Place on the Earth of the airspace's origin.
        start: (3,) where the vehicle starts, m: the origin of north, east, down.
        home: Latitude and longitude, deg, and altitude, m, of the start.
    """

    origin: Origin
    start: tuple[float, ...]
    home: tuple[float, ...]

    @classmethod
    def from_start(cls, origin: Origin, start: np.ndarray) -> "Site":
        """Make the site of a vehicle that starts somewhere, (3,) m."""
        return cls(origin, tuple(start.tolist()), tuple(origin.to_geodetic(start).tolist()))

    @property
    def altitude(self) -> float:
        """Altitude of the start, m."""
        return self.home[2]

    def to_ned(self, position: list[float]) -> tuple[float, float, float]:
        """Tell north, east, down of the start, m."""
        x, y, z = (value - start for value, start in zip(position, self.start, strict=True))
        return y, x, -z

    def from_ned(self, north: float, east: float, down: float) -> tuple[float, float, float]:
        """Tell the place at north, east, down of the start, m.

        Raises:
            RefusedError: A number is not finite, or too large.
        """
        x, y, z = self.start
        return _check_distance((x + east, y + north, z - down))

    def from_global(
        self, frame: int, latitude: float, longitude: float, altitude: float
    ) -> tuple[float, float, float]:
        """Tell the place at a latitude and a longitude, deg, and an altitude, m.

        Args:
            frame: MAVLink's frame: altitudes are above the ellipsoid or above home.
            latitude: deg.
            longitude: deg.
            altitude: m.

        Raises:
            RefusedError: The frame is none of these, or the place cannot be.
        """
        if frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
            raise RefusedError(f"frame {frame}: 0, 3, 5 or 6 is needed")
        height = altitude + (self.altitude if frame in RELATIVE_FRAMES else 0.0)
        try:
            x, y, z = self.origin.to_local((latitude, longitude, height)).tolist()
        except ValueError:
            raise RefusedError("latitude, longitude, altitude: no place") from None
        return _check_distance((x, y, z))


def _check_distance(position: tuple[float, float, float]) -> tuple[float, float, float]:
    """Check that a place is near enough to fly to."""
    if not all(math.isfinite(value) and abs(value) <= MAX_DISTANCE for value in position):
        raise RefusedError(f"a place is more than {MAX_DISTANCE:g} m away")
    return position
