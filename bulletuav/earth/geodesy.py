"""Coordinates on the WGS-84 ellipsoid.

Three kinds of coordinates are converted into each other, exactly, without a flat-Earth
approximation:

- geodetic: latitude and longitude in degrees, altitude above the ellipsoid in metres;
- ECEF: metres from the Earth's centre (x through latitude 0 and longitude 0, z through the pole);
- local: metres east, north and up (ENU) of an origin, as positions of drones are.

Altitudes are not heights above mean sea level: the geoid is up to 107 m away from the ellipsoid.

References:
    NGA.STND.0036, Department of Defense World Geodetic System 1984 (2014).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.compiled.functions import atan2, cos, hypot, sin
from bulletuav.earth.arrays import check_values, check_vectors
from bulletuav.errors import finite

SEMI_MAJOR_AXIS = 6378137.0
"""Equatorial radius, m."""
FLATTENING = 1.0 / 298.257223563
"""Relative difference of the equatorial and the polar radius."""
SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
"""Polar radius, m."""
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
"""Squared first eccentricity."""
MIN_RADIUS = 6.0e6
"""Minimum distance from the Earth's centre for a conversion, m; local positions are below it."""
NUM_ITERATIONS = 2
"""Iterations of Bowring's formula: a third one changes no digit, even at 40,000 km."""


def geodetic_to_ecef(geodetic: ArrayLike) -> np.ndarray:
    """Convert geodetic coordinates to ECEF.

    Args:
        geodetic: (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.
            Longitudes may exceed 180 degrees.

    Returns:
        (..., 3) position, m.

    Raises:
        ValueError: If the last axis is not of length 3, a number is not finite, or a latitude
            exceeds 90 degrees.
    """
    latitude, longitude, altitude = _split_geodetic(geodetic)
    sine = sin(latitude)
    # Radius of curvature in the prime vertical
    normal = SEMI_MAJOR_AXIS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    from_axis = (normal + altitude) * cos(latitude)
    return np.stack(
        [
            from_axis * cos(longitude),
            from_axis * sin(longitude),
            (normal * (1.0 - ECCENTRICITY_SQUARED) + altitude) * sine,
        ],
        axis=-1,
    )


def ecef_to_geodetic(position: ArrayLike) -> np.ndarray:
    """Convert ECEF to geodetic coordinates.

    Args:
        position: (..., 3) metres.

    Returns:
        (..., 3) latitude, deg, longitude from -180 to 180 deg, 0 at the poles, and altitude above
        the ellipsoid, m.

    Raises:
        ValueError: If the last axis is not of length 3, a number is not finite, or a position lies
            deep inside the Earth, as local ones do.

    References:
        B. R. Bowring, Transformation from spatial to geographical coordinates (Survey Review 23,
        1976), for latitudes; The accuracy of geodetic latitude and height equations (Survey Review
        28, 1985), for altitudes, also at the poles.
    """
    array = check_vectors("position", position, "x, y, z")
    radius = np.linalg.norm(array, axis=-1)
    if (radius < MIN_RADIUS).any():
        raise ValueError(
            f"position is {radius.min():.10g} m from the Earth's centre: ECEF coordinates of at "
            f"least {MIN_RADIUS:g} m are needed; local ones are converted by an Origin"
        )
    x, y, z = np.moveaxis(array, -1, 0)
    from_axis = hypot(x, y)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    # The first guess of the parametric latitude is exact on the ellipsoid.
    reduced = atan2(z, (1.0 - FLATTENING) * from_axis)
    latitude = reduced
    for _ in range(NUM_ITERATIONS):
        latitude = atan2(
            z + second * SEMI_MINOR_AXIS * sin(reduced) ** 3,
            from_axis - ECCENTRICITY_SQUARED * SEMI_MAJOR_AXIS * cos(reduced) ** 3,
        )
        reduced = atan2((1.0 - FLATTENING) * sin(latitude), cos(latitude))
    sine = sin(latitude)
    ellipsoid = SEMI_MAJOR_AXIS * np.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    altitude = from_axis * cos(latitude) + z * sine - ellipsoid
    return np.stack([np.degrees(latitude), np.degrees(atan2(y, x)), altitude], axis=-1)


@dataclass(frozen=True)
class Origin:
    """Position on the Earth at which a world's local coordinates are (0, 0, 0).

    Local axes point east, north and up at the origin. They do not follow the Earth's curvature: at
    a distance of 1 km the ground is 8 cm lower.

    Attributes:
        latitude: From -90 to 90 deg, positive to the north.
        longitude: From -180 to 180 deg, positive to the east.
        altitude: Height above the ellipsoid, m.
    """

    latitude: float
    longitude: float
    altitude: float

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: If a number is not finite or out of bounds.
        """
        object.__setattr__(self, "latitude", finite("latitude", self.latitude, -90.0, 90.0))
        object.__setattr__(self, "longitude", finite("longitude", self.longitude, -180.0, 180.0))
        object.__setattr__(self, "altitude", finite("altitude", self.altitude))

    def to_geodetic(self, position: ArrayLike) -> np.ndarray:
        """Convert local positions to geodetic coordinates.

        Args:
            position: (..., 3) metres east, north and up of the origin.

        Returns:
            (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.

        Raises:
            ValueError: If the last axis is not of length 3, or a number is not finite.
        """
        local = check_vectors("position", position, "east, north, up")
        return ecef_to_geodetic(self._ecef() + local @ self._axes())

    def to_local(self, geodetic: ArrayLike) -> np.ndarray:
        """Convert geodetic coordinates to local positions.

        Args:
            geodetic: (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.

        Returns:
            (..., 3) metres east, north and up of the origin.

        Raises:
            ValueError: If the last axis is not of length 3, a number is not finite, or a latitude
                exceeds 90 degrees.
        """
        local: np.ndarray = (geodetic_to_ecef(geodetic) - self._ecef()) @ self._axes().T
        return local

    def _ecef(self) -> np.ndarray:
        """Return the origin in ECEF, (3,) m."""
        return geodetic_to_ecef((self.latitude, self.longitude, self.altitude))

    def _axes(self) -> np.ndarray:
        """Return the axes east, north and up as rows (3, 3) in ECEF."""
        latitude, longitude = np.radians((self.latitude, self.longitude))
        sine, cosine = sin(latitude), cos(latitude)
        east = (-sin(longitude), cos(longitude), 0.0)
        north = (-sine * cos(longitude), -sine * sin(longitude), cosine)
        up = (cosine * cos(longitude), cosine * sin(longitude), sine)
        return np.array((east, north, up))


def degree_lengths(latitude: float) -> tuple[float, float]:
    """Return the lengths of a degree of longitude and of latitude on the ellipsoid.

    Args:
        latitude: Latitude, deg.

    Returns:
        Length of a degree of longitude (to the east) and of latitude (to the north), m, from the
        radii of curvature in the prime vertical, N, and in the meridian, M.

    Raises:
        ValueError: If the latitude is out of bounds.
    """
    phi = math.radians(finite("latitude", latitude, -90, 90))
    flat = 1.0 - ECCENTRICITY_SQUARED * float(sin(phi)) ** 2
    prime_vertical = SEMI_MAJOR_AXIS / math.sqrt(flat)
    meridian = prime_vertical * (1.0 - ECCENTRICITY_SQUARED) / flat
    return math.radians(prime_vertical * float(cos(phi))), math.radians(meridian)


def _split_geodetic(geodetic: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Check geodetic coordinates (..., 3); return latitude, rad, longitude, rad, altitude, m."""
    array = check_vectors("geodetic", geodetic, "latitude, longitude, altitude")
    latitude = check_values("latitude", array[..., 0], "degrees", -90.0, 90.0)
    return np.radians(latitude), np.radians(array[..., 1]), array[..., 2]
