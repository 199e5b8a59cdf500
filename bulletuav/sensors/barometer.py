"""Barometer: static air pressure and barometric height."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.earth.atmosphere import MAX_HEIGHT, MIN_HEIGHT, pressure, pressure_altitude
from bulletuav.engine.engine import Engine
from bulletuav.errors import finite
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

NOISE = 1.3
"""Pa; 11 cm at 50 Hz: Bosch BMP388 in its drone configuration (BST-BMP388-DS001-07, table 10)"""
WALK = 0.3
"""Pa after one second; an assumption: 0.75 Pa/K of a BMP388 that warms up by 10 K in ten minutes"""
PRESSURES = (5475.0, 177e3)
"""Minimum and maximum pressure for which the standard atmosphere defines a height, Pa"""
PRESSURE_BOUNDS = (30e3, 125e3)
"""Bounds of an observed pressure, Pa: the measurement range of a BMP388"""
HEIGHT_BOUNDS = (-1800.0, 9200.0)
"""Bounds of an observed height above sea level, m: those of the pressure bounds, rounded
outwards"""
ALTITUDES = (-500.0, 9000.0)
"""Minimum and maximum altitude of an origin, m"""


@register("sensor")
class Barometer(Sensor):
    """Static pressure of the standard atmosphere, and the corresponding height above the origin.

    The measured pressure is the true pressure plus a constant bias, a random walk and white noise.
    The height is the altitude at which the standard atmosphere has the measured pressure. A pascal
    is 8 cm at sea level. `Imperfect(Barometer(), rate=50)` has the sample rate of a BMP388. The
    pressure changes of some pascals due to rotor wash and airspeed are not modelled.

    The reading "barometer" is the pressure, Pa, and "barometric_height" the height, m.

    Attributes:
        noise: (W, N) standard deviation of the white noise, Pa.
        walk: (W, N) standard deviation of the random walk after one second, Pa; it grows with the
            square root of time.
        bias: (W, N) constant error, Pa; up to 50 by the datasheet of a BMP388.
    """

    name = "barometer"
    gives = ("barometer", "barometric_height")
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 1000.0, usual=NOISE),
        "walk": Uncertain(0.0, 1000.0, usual=WALK),
        "bias": Uncertain(-1000.0, 1000.0),
    }

    noise: np.ndarray
    walk: np.ndarray
    bias: np.ndarray

    def __init__(self, altitude: float = 0.0) -> None:
        """Set the altitude of the origin.

        Args:
            altitude: Height of the world's origin above mean sea level, from -500 to 9000 m.

        Raises:
            ValueError: If the altitude is not finite or out of bounds.
        """
        self._altitude = finite("altitude", altitude, *ALTITUDES)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels and bounds of pressure and height."""
        low, high = (height - self._altitude for height in HEIGHT_BOUNDS)
        return {
            "barometer": (Label("pressure", "Pa", *PRESSURE_BOUNDS),),
            "barometric_height": (Label("barometric height", "m", low, high),),
        }

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings and the random walks."""
        super().attach(setup, engine)
        self._drift, self._pressure, self._height = np.zeros((3, *setup.shape))
        self._root = np.sqrt(setup.period)

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Reset the random walk of a world."""
        self._drift[world] = 0.0

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure pressure and height of the drones in the mask; other readings do not change.

        Each world draws from its own generator if its noise or walk is above 0.
        """
        mask = moment.mask
        uncertain = np.any((self.noise > 0) | (self.walk > 0), axis=1)
        normal, _ = moment._replace(mask=mask & uncertain[:, None]).draw(2)
        self._drift += moment.flying[:, None] * self._root * self.walk * normal[..., 0]
        error = self.bias + self._drift + self.noise * normal[..., 1]
        # The standard atmosphere is defined within these altitudes only.
        height = np.clip(self._altitude + moment.after.position[mask, 2], MIN_HEIGHT, MAX_HEIGHT)
        measured = np.clip(pressure(height) + error[mask], *PRESSURES)
        self._pressure[mask] = measured
        self._height[mask] = pressure_altitude(measured) - self._altitude
        return {"barometer": self._pressure.copy(), "barometric_height": self._height.copy()}
