"""Places on the ellipsoid of WGS-84.

Three kinds of coordinates are converted into each other, exactly and not on a flat Earth:

- geodetic: latitude and longitude in degrees, altitude above the ellipsoid in metres;
- ECEF: metres from the Earth's centre (x through latitude 0 and longitude 0, z through the pole);
- local: metres east, north and up (ENU) of an origin, as positions of drones are.

Altitudes are not those above mean sea level: the geoid lies up to 107 m away from the ellipsoid.

Source: NGA.STND.0036, Department of Defense World Geodetic System 1984 (2014).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.compiled.functions import atan2, cos, hypot, sin
from bulletuav.earth.arrays import check_values, check_vectors
from bulletuav.errors import finite

SEMI_MAJOR_AXIS = 6378137.0
"""Radius of the equator, m."""
FLATTENING = 1.0 / 298.257223563
"""Share by which the poles are nearer to the centre than the equator."""
SEMI_MINOR_AXIS = SEMI_MAJOR_AXIS * (1.0 - FLATTENING)
"""Distance of the poles from the centre, m."""
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
"""First eccentricity, squared."""
MIN_RADIUS = 6.0e6
"""Least distance from the centre at which a latitude is told, m; local positions lie below it."""
NUM_ITERATIONS = 2
"""Rounds of Bowring's formula: a third one changes no digit, even at 40,000 km."""


def geodetic_to_ecef(geodetic: ArrayLike) -> np.ndarray:
    """Convert geodetic coordinates into ECEF.

    Args:
        geodetic: (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.
            Longitudes may go beyond 180 degrees.

    Returns:
        (..., 3) position, m.

    Raises:
        ValueError: The last axis is no triple, a number is not finite, or a latitude is beyond
            90 degrees.
    """
    latitude, longitude, altitude = _split_geodetic(geodetic)
    sine = sin(latitude)
    # From the place along the vertical down to the Earth's axis.
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
    """Convert ECEF into geodetic coordinates.

    Latitudes follow B. R. Bowring, Transformation from spatial to geographical coordinates
    (Survey Review 23, 1976), and altitudes his The accuracy of geodetic latitude and height
    equations (Survey Review 28, 1985), which holds at the poles, too.

    Args:
        position: (..., 3) metres.

    Returns:
        (..., 3) latitude, deg, longitude from -180 to 180 deg, 0 at the poles, and altitude above
        the ellipsoid, m.

    Raises:
        ValueError: The last axis is no triple, a number is not finite, or a position lies deep
            inside of the Earth, as local ones do.
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
    """Place on the Earth where a world's local coordinates are (0, 0, 0).

    Local axes point east, north and up at the origin. They do not follow the Earth's curvature:
    1 km away the ground lies 8 cm lower.

    Attributes:
        latitude: From -90 to 90 deg, north is positive.
        longitude: From -180 to 180 deg, east is positive.
        altitude: Height above the ellipsoid, m.
    """

    latitude: float
    longitude: float
    altitude: float

    def __post_init__(self) -> None:
        """Check the place.

        Raises:
            ValueError: A number is not finite or out of bounds.
        """
        object.__setattr__(self, "latitude", finite("latitude", self.latitude, -90.0, 90.0))
        object.__setattr__(self, "longitude", finite("longitude", self.longitude, -180.0, 180.0))
        object.__setattr__(self, "altitude", finite("altitude", self.altitude))

    def to_geodetic(self, position: ArrayLike) -> np.ndarray:
        """Convert local positions into geodetic coordinates.

        Args:
            position: (..., 3) metres east, north and up of the origin.

        Returns:
            (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.

        Raises:
            ValueError: The last axis is no triple, or a number is not finite.
        """
        local = check_vectors("position", position, "east, north, up")
        return ecef_to_geodetic(self._ecef() + local @ self._axes())

    def to_local(self, geodetic: ArrayLike) -> np.ndarray:
        """Convert geodetic coordinates into local positions.

        Args:
            geodetic: (..., 3) latitude, deg, longitude, deg, and altitude above the ellipsoid, m.

        Returns:
            (..., 3) metres east, north and up of the origin.

        Raises:
            ValueError: The last axis is no triple, a number is not finite, or a latitude is beyond
                90 degrees.
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
    """Measure a degree of longitude and one of latitude, on the ellipsoid.

    Args:
        latitude: Where, degrees north.

    Returns:
        Metres to the east of a degree of longitude, and to the north of a degree of latitude. They
        follow from the radii of curvature in the prime vertical, N, and in the meridian, M.

    Raises:
        ValueError: There is no such latitude.
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
