"""Magnetic field of the Earth, by the International Geomagnetic Reference Field.

IGRF-14 from 2025.0 to 2030.0, complete: spherical harmonics of degrees 1 to 13 at 2025.0, and the
predicted change of degrees 1 to 8, which is some 0.1 % and 0.1 degrees per year. Not included are:

- magnetic rocks and currents in the air, which deflect compasses by some 0.4 degrees;
- iron nearby, which deflects them more.

References:
    IAGA, IGRF-14 (2024), doi:10.5281/zenodo.14012302, for the coefficients.
    P. Alken et al., International Geomagnetic Reference Field: the thirteenth generation (Earth,
    Planets and Space 73, 2021), doi:10.1186/s40623-020-01288-x, for the formulas.
"""

import calendar
import datetime

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.compiled.functions import atan2, cos, hypot, sin
from bulletuav.earth.arrays import check_values
from bulletuav.earth.geodesy import geodetic_to_ecef
from bulletuav.errors import finite

REFERENCE_RADIUS = 6371200.0
"""Reference radius of the coefficients, m."""
MAX_DEGREE = 13
"""Maximum degree of the coefficients."""
MIN_ALTITUDE = -10e3
"""Minimum altitude, m."""
MAX_ALTITUDE = 1000e3
"""Maximum altitude, m; currents of the magnetosphere contribute above it."""
EPOCH = 2025.0
"""Decimal year of the coefficients."""
LAST_YEAR = 2030.0
"""Decimal year up to which the change is predicted."""
TESLA = 1e-9
"""One nanotesla, the unit of the coefficients, in teslas."""

# One row per degree, from 1; orders from 0.
COSINES = (
    (-29350.0, -1410.3),
    (-2556.2, 2950.9, 1648.7),
    (1360.9, -2404.2, 1243.8, 453.4),
    (894.7, 799.6, 55.8, -281.1, 12.0),
    (-232.9, 369.0, 187.2, -138.7, -141.9, 20.9),
    (64.3, 63.8, 76.7, -115.7, -40.9, 14.9, -60.8),
    (79.6, -76.9, -8.8, 59.3, 15.8, 2.5, -11.2, 14.3),
    (23.1, 10.9, -17.5, 2.0, -21.8, 16.9, 14.9, -16.8, 1.0),
    (4.7, 8.0, 3.0, -0.2, -2.5, -13.1, 2.4, 8.6, -8.7, -12.8),
    (-1.3, -6.4, 0.2, 2.0, -1.0, -0.5, -0.9, 1.5, 0.9, -2.6, -3.9),
    (3.0, -1.4, -2.5, 2.4, -0.6, 0.0, -0.6, -0.1, 1.1, -1.0, -0.1, 2.6),
    (-2.0, -0.1, 0.4, 1.2, -1.2, 0.6, 0.5, 0.5, -0.1, -0.5, -0.2, -1.2, -0.7),
    (0.2, -0.9, 0.6, 0.7, -0.2, 0.5, 0.1, 0.7, 0.0, 0.3, 0.2, 0.4, -0.5, -0.4),
)
"""Coefficients g of cosines of the longitude, nT"""
SINES = (
    (0.0, 4545.5),
    (0.0, -3133.6, -814.2),
    (0.0, -56.9, 237.6, -549.6),
    (0.0, 278.6, -134.0, 212.0, -375.4),
    (0.0, 45.3, 220.0, -122.9, 42.9, 106.2),
    (0.0, -18.4, 16.8, 48.9, -59.8, 10.9, 72.8),
    (0.0, -48.9, -14.4, -1.0, 23.5, -7.4, -25.1, -2.2),
    (0.0, 7.2, -12.6, 11.5, -9.7, 12.7, 0.7, -5.2, 3.9),
    (0.0, -24.8, 12.1, 8.3, -3.4, -5.3, 7.2, -0.6, 0.8, 9.8),
    (0.0, 3.3, 0.1, 2.5, 5.4, -9.0, 0.4, -4.2, -3.8, 0.9, -9.0),
    (0.0, 0.0, 2.8, -0.6, 0.1, 0.5, -0.3, -1.2, -1.7, -2.9, -1.8, -2.3),
    (0.0, -1.2, 0.6, 1.0, -1.5, 0.0, 0.6, -0.2, 0.8, 0.1, -0.9, 0.1, 0.2),
    (0.0, -0.9, 0.7, 1.2, -0.3, -1.3, -0.1, 0.2, -0.2, 0.5, 0.6, -0.6, -0.3, -0.5),
)
"""Coefficients h of sines of the longitude, nT"""
COSINE_RATES = (
    (12.6, 10.0),
    (-11.2, -5.3, -8.3),
    (-1.5, -4.4, 0.4, -15.6),
    (-1.7, -2.3, -5.8, 5.4, -6.8),
    (0.6, 1.3, 0.0, 0.7, 2.3, 1.0),
    (-0.2, -0.3, 0.8, 1.2, -0.8, 0.4, 0.9),
    (-0.1, -0.1, -0.1, 0.5, -0.1, -0.8, -0.8, 0.9),
    (-0.1, 0.2, 0.0, 0.4, -0.1, 0.3, 0.1, 0.0, 0.3),
)
"""Change of the coefficients g up to degree 8, nT a year"""
SINE_RATES = (
    (0.0, -21.5),
    (0.0, -27.3, -11.1),
    (0.0, 3.8, -0.2, -3.9),
    (0.0, -1.3, 4.1, 1.6, -4.1),
    (0.0, -0.5, 2.1, 0.5, 1.7, 1.9),
    (0.0, 0.3, -1.6, -0.4, 0.8, 0.7, 0.9),
    (0.0, 0.6, 0.5, -0.7, 0.0, -0.9, 0.5, -0.3),
    (0.0, -0.3, 0.4, -0.3, 0.4, -0.5, -0.6, 0.3, 0.2),
)
"""Change of the coefficients h up to degree 8, nT a year"""


def decimal_year(date: float | datetime.date) -> float:
    """Convert a date to a decimal year: 2027.5 is in the middle of 2027.

    Args:
        date: A decimal year, or a day, of which the beginning counts.

    Returns:
        The decimal year, from `EPOCH` to `LAST_YEAR`.

    Raises:
        ValueError: If the date is invalid or out of bounds.
    """
    year: object = date
    if isinstance(date, datetime.date):
        days = 366 if calendar.isleap(date.year) else 365
        year = date.year + (date.timetuple().tm_yday - 1) / days
    return finite("date", year, EPOCH, LAST_YEAR)


def magnetic_field(
    latitude: ArrayLike,
    longitude: ArrayLike,
    altitude: ArrayLike,
    date: float | datetime.date = EPOCH,
) -> np.ndarray:
    """Return the magnetic field of the Earth.

    A compass points to magnetic north: a field of (0, north, up) has no declination. The field
    hardly changes within a kilometre, so one call at the origin is sufficient for a world.

    Args:
        latitude: Geodetic latitude, from -90 to 90 deg.
        longitude: Longitude of any range, deg.
        altitude: Altitude above the WGS-84 ellipsoid, from -10 to 1000 km, in m. The shapes of the
            three arguments are broadcast.
        date: Decimal year from 2025.0 to 2030.0, or a day within them.

    Returns:
        (..., 3) east, north and up, T. At the poles, north is the direction along the given
        meridian.

    Raises:
        ValueError: If a number is not finite or out of bounds.
    """
    degrees, meridian, height = np.broadcast_arrays(
        check_values("latitude", latitude, "degrees", -90.0, 90.0),
        check_values("longitude", longitude, "degrees"),
        check_values("altitude", altitude, "m", MIN_ALTITUDE, MAX_ALTITUDE),
    )
    years = decimal_year(date) - EPOCH
    position = geodetic_to_ecef(np.stack([degrees, meridian, height], axis=-1))
    # Harmonics use the geocentric latitude, which differs from the geodetic by up to 0.2 degrees.
    from_axis = hypot(position[..., 0], position[..., 1])
    geocentric = atan2(position[..., 2], from_axis)
    radius = hypot(from_axis, position[..., 2])
    east, north, up = _geocentric_field(geocentric, np.radians(meridian), radius, years)
    tilt = np.radians(degrees) - geocentric
    return TESLA * np.stack(
        [
            east,
            cos(tilt) * north - sin(tilt) * up,
            sin(tilt) * north + cos(tilt) * up,
        ],
        axis=-1,
    )


def _geocentric_field(
    latitude: np.ndarray, longitude: np.ndarray, radius: np.ndarray, years: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum the harmonics: minus the gradient of the potential of Alken et al., equation 1.

    Args:
        latitude: (...) geocentric latitude, rad.
        longitude: (...) rad.
        radius: (...) distance from the Earth's centre, m.
        years: Time since `EPOCH`, years.

    Returns:
        The field east, north and radially outwards, (...) nT each.
    """
    sine = sin(latitude)[..., None]  # the cosine of the colatitude
    cosine = cos(latitude)[..., None]
    ratio = REFERENCE_RADIUS / radius
    scale = ratio * ratio
    turns = np.arange(MAX_DEGREE + 1) * longitude[..., None]
    cosines, sines = cos(turns), sin(turns)
    east, north, up = np.zeros((3, *np.shape(radius)))
    # Legendre functions of one degree and the one before, for all orders (..., 14). Those of
    # orders above 0 are divided by the cosine of the latitude, so that poles need no division.
    before, legendre = np.zeros((2, *turns.shape))
    legendre[..., 0] = 1.0
    for degree in range(1, MAX_DEGREE + 1):
        before, legendre = legendre, _next_legendre(degree, sine, cosine, legendre, before)
        order = np.arange(degree + 1)
        g = _at(years, COSINES, COSINE_RATES, degree)
        h = _at(years, SINES, SINE_RATES, degree)
        cos_turn, sin_turn = cosines[..., : degree + 1], sines[..., : degree + 1]
        along = g * cos_turn + h * sin_turn
        across = order * (g * sin_turn - h * cos_turn)
        shared = legendre[..., : degree + 1]
        whole = shared * np.where(order > 0, cosine, 1.0)
        # Derivatives with respect to the colatitude.
        slope = degree * sine * shared - np.sqrt(degree**2 - order**2) * before[..., : degree + 1]
        slope[..., 0] = -np.sqrt(degree * (degree + 1) / 2) * whole[..., 1]
        scale = scale * ratio
        up += scale * (degree + 1) * (along * whole).sum(axis=-1)
        north += scale * (along * slope).sum(axis=-1)
        east += scale * (across * shared).sum(axis=-1)
    return east, north, up


def _at(
    years: float,
    values: tuple[tuple[float, ...], ...],
    rates: tuple[tuple[float, ...], ...],
    degree: int,
) -> np.ndarray:
    """Return the coefficients of a degree (degree + 1,) at a time since `EPOCH`, nT."""
    now = np.array(values[degree - 1])
    return now + years * np.array(rates[degree - 1]) if degree <= len(rates) else now


def _next_legendre(
    degree: int, sine: np.ndarray, cosine: np.ndarray, last: np.ndarray, before: np.ndarray
) -> np.ndarray:
    """Compute Schmidt's semi-normalised Legendre functions from those of the two lower degrees.

    All orders above 0 are divided by the cosine of the latitude, see `_geocentric_field`.

    Args:
        degree: The degree n, from 1.
        sine: (..., 1) sine of the latitude.
        cosine: (..., 1) cosine of the latitude.
        last: (..., 14) functions of degree n - 1; those of higher orders are 0.
        before: (..., 14) functions of degree n - 2.

    Returns:
        (..., 14) functions of degree n.
    """
    order = np.arange(degree)
    root = np.sqrt((degree - 1) ** 2 - order**2)
    legendre = np.zeros_like(last)
    legendre[..., :degree] = (
        (2 * degree - 1) * sine * last[..., :degree] - root * before[..., :degree]
    ) / np.sqrt(degree**2 - order**2)
    if degree == 1:
        legendre[..., 1] = 1.0
    else:
        # The diagonal follows from the one before it.
        factor = np.sqrt(1.0 - 0.5 / degree)
        legendre[..., degree] = factor * cosine[..., 0] * last[..., degree - 1]
    return legendre
