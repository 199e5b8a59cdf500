"""The International Standard Atmosphere, from 5 km below sea level to 20 km above.

The temperature decreases by 6.5 K per kilometre up to 11 km, and is constant above. The air is dry.

Heights are geometric, m above mean sea level. Heights above the ellipsoid differ by up to 107 m,
see `geodesy`. Formulas and tables of standards use geopotential heights, which assume the same
gravity at all heights. `geopotential_height` and `geometric_height` convert between them.

Another temperature at sea level shifts the temperatures of all heights by the same amount.

References:
    ISO 2533:1975; U.S. Standard Atmosphere 1976, which is the same below 32 km.
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
"""Decrease of the temperature of the troposphere with geopotential height, K/m."""
TROPOPAUSE = 11000.0
"""Geopotential height of the top of the troposphere, m."""
EARTH_RADIUS = 6356766.0
"""Radius of the Earth in the standards' law of gravity, m."""
EXPONENT = GRAVITY / (GAS_CONSTANT * LAPSE_RATE)
"""Exponent of the temperature in the pressure law of the troposphere."""

LAYER_END = 20000.0
"""Geopotential height up to which the temperature is constant, m."""
MIN_HEIGHT = -5000.0
"""Minimum height, m."""
MAX_HEIGHT = EARTH_RADIUS * LAYER_END / (EARTH_RADIUS - LAYER_END)
"""Maximum height, m: 20063."""
ROUNDING_TOLERANCE = 1e-12
"""Relative tolerance of the bounds, for values that were computed from the bounds."""
PRESSURE_BOUNDS = (80000.0, 120000.0)
"""Minimum and maximum pressure at sea level, Pa; recorded weather ranges from 87000 to 108500."""
TEMPERATURE_BOUNDS = (180.0, 340.0)
"""Minimum and maximum temperature at sea level, K."""


def geopotential_height(height: ArrayLike) -> np.ndarray:
    """Convert geometric heights to geopotential heights.

    Args:
        height: Geometric height above sea level, m, of any shape.

    Returns:
        Geopotential height, m.

    Raises:
        ValueError: If a height is not finite, or not from `MIN_HEIGHT` to `MAX_HEIGHT`.
    """
    array = check_values("height", height, "m", MIN_HEIGHT, MAX_HEIGHT)
    return np.asarray(EARTH_RADIUS * array / (EARTH_RADIUS + array))


def geometric_height(geopotential: ArrayLike) -> np.ndarray:
    """Convert geopotential heights to geometric heights.

    Args:
        geopotential: Geopotential height above sea level, m, of any shape.

    Returns:
        Geometric height, m.

    Raises:
        ValueError: If a height is not finite, or not within `MIN_HEIGHT` and `MAX_HEIGHT`.
    """
    low, high = geopotential_height((MIN_HEIGHT, MAX_HEIGHT)) * (1.0 + ROUNDING_TOLERANCE)
    array = check_values("geopotential", geopotential, "m", low, high)
    return _geometric(array)


def temperature(
    height: ArrayLike, sea_level_temperature: float = SEA_LEVEL_TEMPERATURE
) -> np.ndarray:
    """Return the temperature of the air.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Temperature, K.

    Raises:
        ValueError: If a height or the temperature is out of bounds.
    """
    base = finite("sea_level_temperature", sea_level_temperature, *TEMPERATURE_BOUNDS)
    return np.asarray(base - LAPSE_RATE * np.minimum(geopotential_height(height), TROPOPAUSE))


def pressure(
    height: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Return the static pressure of the air.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Pressure, Pa.

    Raises:
        ValueError: If a height, the pressure or the temperature is out of bounds.
    """
    base = finite("sea_level_pressure", sea_level_pressure, *PRESSURE_BOUNDS)
    kelvin = temperature(height, sea_level_temperature)
    troposphere = base * power(kelvin / sea_level_temperature, EXPONENT)
    # Above the tropopause the temperature is constant.
    above = np.maximum(geopotential_height(height) - TROPOPAUSE, 0.0)
    return np.asarray(troposphere * exp(-GRAVITY * above / (GAS_CONSTANT * kelvin)))


def density(
    height: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Return the density of the air, by the ideal gas law.

    Args:
        height: Geometric height above sea level, m, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Density, kg/m^3.

    Raises:
        ValueError: If a height, the pressure or the temperature is out of bounds.
    """
    kelvin = temperature(height, sea_level_temperature)
    pascal = pressure(height, sea_level_pressure, sea_level_temperature)
    return np.asarray(pascal / (GAS_CONSTANT * kelvin))


def pressure_altitude(
    static_pressure: ArrayLike,
    sea_level_pressure: float = SEA_LEVEL_PRESSURE,
    sea_level_temperature: float = SEA_LEVEL_TEMPERATURE,
) -> np.ndarray:
    """Return the height at which the air has a pressure: the inverse of `pressure`.

    Altimeters show geopotential heights, which are 0.16 m less at 1 km and 16 m less at 10 km.

    Args:
        static_pressure: Pressure, Pa, of any shape.
        sea_level_pressure: Pressure at height 0, Pa.
        sea_level_temperature: Temperature at height 0, K.

    Returns:
        Geometric height above sea level, m.

    Raises:
        ValueError: If a pressure does not belong to a height from `MIN_HEIGHT` to `MAX_HEIGHT`, or
            a value at sea level is out of bounds.
    """
    low, high = pressure((MAX_HEIGHT, MIN_HEIGHT), sea_level_pressure, sea_level_temperature)
    pascal = check_values(
        "static_pressure",
        static_pressure,
        "Pa",
        low * (1.0 - ROUNDING_TOLERANCE),
        high * (1.0 + ROUNDING_TOLERANCE),
    )
    top = sea_level_temperature - LAPSE_RATE * TROPOPAUSE
    tropopause = sea_level_pressure * power(top / sea_level_temperature, EXPONENT)
    # Height within the troposphere, and height above the tropopause.
    ratio = np.maximum(pascal, tropopause) / sea_level_pressure
    below = sea_level_temperature / LAPSE_RATE * (1.0 - power(ratio, 1.0 / EXPONENT))
    above = GAS_CONSTANT * top / GRAVITY * log(tropopause / np.minimum(pascal, tropopause))
    return _geometric(below + above)


def _geometric(geopotential: np.ndarray) -> np.ndarray:
    """Convert geopotential heights to geometric heights, m, without checks."""
    return np.asarray(EARTH_RADIUS * geopotential / (EARTH_RADIUS - geopotential))
