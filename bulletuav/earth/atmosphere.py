"""The International Standard Atmosphere, from 5 km below the sea to 20 km above.

Air cools by 6.5 K for each kilometre up to 11 km, and keeps its temperature above. It is dry.

Heights are geometric, m above mean sea level. Those above the ellipsoid differ by up to 107 m,
see `geodesy`. Formulas and tables of standards use geopotential heights, as if gravity were the
same at all heights. `geopotential_height` and `geometric_height` convert them.

Another temperature at sea level shifts that of all heights by the same number of kelvins.

Sources: ISO 2533:1975; U.S. Standard Atmosphere 1976, which is the same below 32 km.
"""

import numpy as np
from numpy.typing import ArrayLike

from bulletuav.compiled.functions import exp, log, power
from bulletuav.earth.arrays import check_values
from bulletuav.errors import finite

SEA_LEVEL_PRESSURE = 101325.0
"""Standard pressure at sea level, Pa."""
SEA_LEVEL_TEMPERATURE = 288.15
"""Standard temperature at sea level, K."""
GRAVITY = 9.80665
"""Standard gravity, m/s^2."""
GAS_CONSTANT = 287.05287
"""Gas constant of dry air, J/(kg K)."""
LAPSE_RATE = 0.0065
"""How much the air of the troposphere cools with geopotential height, K/m."""
TROPOPAUSE = 11000.0
"""Geopotential height of the end of the troposphere, m."""
EARTH_RADIUS = 6356766.0
"""Radius of the Earth in the standards' gravity, m."""
EXPONENT = GRAVITY / (GAS_CONSTANT * LAPSE_RATE)
"""Power of the temperature that the pressure of the troposphere follows."""

LAYER_END = 20000.0
"""Geopotential height up to which the temperature stays, m."""
MIN_HEIGHT = -5000.0
"""Least height, m."""
MAX_HEIGHT = EARTH_RADIUS * LAYER_END / (EARTH_RADIUS - LAYER_END)
"""Greatest height, m: 20063."""
ROUNDING_TOLERANCE = 1e-12
"""Share by which what was computed from these may lie beyond."""
PRESSURE_BOUNDS = (80000.0, 120000.0)
"""Least and greatest pressure at sea level, Pa; weather has been within 87000 and 108500."""
TEMPERATURE_BOUNDS = (180.0, 340.0)
"""Least and greatest temperature at sea level, K."""


def geopotential_height(height: ArrayLike) -> np.ndarray:
    """Convert geometric heights into geopotential ones.

    Args:
        height: Geometric height above sea level, m, of any shape.

    Returns:
        Geopotential height, m.

    Raises:
        ValueError: A height is not finite, or not from `MIN_HEIGHT` to `MAX_HEIGHT`.
    """
    array = check_values("height", height, "m", MIN_HEIGHT, MAX_HEIGHT)
    return np.asarray(EARTH_RADIUS * array / (EARTH_RADIUS + array))


def geometric_height(geopotential: ArrayLike) -> np.ndarray:
    """Convert geopotential heights into geometric ones.

    Args:
        geopotential: Geopotential height above sea level, m, of any shape.

    Returns:
        Geometric height, m.

    Raises:
        ValueError: A height is not finite, or not of those from `MIN_HEIGHT` to `MAX_HEIGHT`.
    """
    least, most = geopotential_height((MIN_HEIGHT, MAX_HEIGHT)) * (1.0 + ROUNDING_TOLERANCE)
    array = check_values("geopotential", geopotential, "m", least, most)
    return _geometric(array)


def temperature(
    height: ArrayLike, sea_level_temperature: float = SEA_LEVEL_TEMPERATURE
) -> np.ndarray:
    """Tell the temperature of the air.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Temperature, K.

    Raises:
        ValueError: A height or the temperature is out of bounds.
    """
    base = finite("sea_level_temperature", sea_level_temperature, *TEMPERATURE_BOUNDS)
    return np.asarray(base - LAPSE_RATE * np.minimum(geopotential_height(height), TROPOPAUSE))


def pressure(
    height: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Tell the static pressure of the air.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Pressure, Pa.

    Raises:
        ValueError: A height, the pressure or the temperature is out of bounds.
    """
    base = finite("sea_level_pressure", sea_level_pressure, *PRESSURE_BOUNDS)
    kelvin = temperature(height, sea_level_temperature)
    troposphere = base * power(kelvin / sea_level_temperature, EXPONENT)
    # Above the tropopause the pressure falls from there on, at its constant temperature.
    above = np.maximum(geopotential_height(height) - TROPOPAUSE, 0.0)
    return np.asarray(troposphere * exp(-GRAVITY * above / (GAS_CONSTANT * kelvin)))


def density(
    height: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Tell the density of the air: that of an ideal gas.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Density, kg/m^3.

    Raises:
        ValueError: A height, the pressure or the temperature is out of bounds.
    """
    kelvin = temperature(height, sea_level_temperature)
    pascal = pressure(height, sea_level_pressure, sea_level_temperature)
    return np.asarray(pascal / (GAS_CONSTANT * kelvin))


def pressure_altitude(
    static_pressure: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Tell the height at which the air has a pressure: the inverse of `pressure`.

    Altimeters show geopotential heights, which are 0.16 m less at 1 km and 16 m less at 10 km.

    Args:
        static_pressure: Pressure, Pa, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Geometric height above sea level, m.

    Raises:
        ValueError: A pressure is not one of heights from `MIN_HEIGHT` to `MAX_HEIGHT`, or what is given
            for sea level is out of bounds.
    """
    least, most = pressure((MAX_HEIGHT, MIN_HEIGHT), sea_level_pressure, sea_level_temperature)
    pascal = check_values(
        "static_pressure",
        static_pressure,
        "Pa",
        least * (1.0 - ROUNDING_TOLERANCE),
        most * (1.0 + ROUNDING_TOLERANCE),
    )
    top = sea_level_temperature - LAPSE_RATE * TROPOPAUSE
    tropopause = sea_level_pressure * power(top / sea_level_temperature, EXPONENT)
    # The troposphere up to the height or to its end, and what is above.
    ratio = np.maximum(pascal, tropopause) / sea_level_pressure
    below = sea_level_temperature / LAPSE_RATE * (1.0 - power(ratio, 1.0 / EXPONENT))
    above = GAS_CONSTANT * top / GRAVITY * log(tropopause / np.minimum(pascal, tropopause))
    return _geometric(below + above)


def _geometric(geopotential: np.ndarray) -> np.ndarray:
    """Return geometric heights, m, of geopotential ones."""
    return np.asarray(EARTH_RADIUS * geopotential / (EARTH_RADIUS - geopotential))
