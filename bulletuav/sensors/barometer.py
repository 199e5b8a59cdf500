"""Barometers: the pressure of the air, and the height that it tells."""

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
"""Pa; 11 cm at 50 Hz, of a Bosch BMP388 as it is set for drones (BST-BMP388-DS001-07, table 10)"""
WALK = 0.3
"""Pa after one second; a choice: a BMP388's 0.75 Pa/K while it warms by 10 K in ten minutes"""
PRESSURES = (5475.0, 177e3)
"""Least and greatest pressure that the standard atmosphere tells a height of, Pa"""
PRESSURE_BOUNDS = (30e3, 125e3)
"""Bounds of an observed pressure, Pa: what a BMP388 measures"""
HEIGHT_BOUNDS = (-1800.0, 9200.0)
"""Bounds of an observed height above sea level, m: that of these pressures, rounded outwards"""
ALTITUDES = (-500.0, 9000.0)
"""Least and greatest altitude of an origin, m"""


@register("sensor")
class Barometer(Sensor):
    """Static pressure of the standard atmosphere, and the height above the origin that it tells.

    A pressure is that of the air, a constant error, an error that walks, and white noise. The
    height is where the standard atmosphere has this pressure. A pascal is 8 cm at sea level.
    `Imperfect(Barometer(), rate=50)` measures as often as a BMP388. Left out is the wind of rotors
    and of flight, which changes the pressure around the sensor by some pascals.

    The reading "barometer" is the pressure, Pa, and "barometric_height" the height, m.

    Attributes:
        noise: (W, N) standard deviation of a pressure, Pa.
        walk: (W, N) random walk after one second, Pa; it grows with the root of time.
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
        """Set the sensor up.

        Args:
            altitude: Height of the world's origin above mean sea level, from -500 to 9000 m.

        Raises:
            ValueError: The altitude is not finite or out of bounds.
        """
        self._altitude = finite("altitude", altitude, *ALTITUDES)

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Tell the bounds of pressure and height."""
        low, high = (height - self._altitude for height in HEIGHT_BOUNDS)
        return {
            "barometer": (Label("pressure", "Pa", *PRESSURE_BOUNDS),),
            "barometric_height": (Label("barometric height", "m", low, high),),
        }

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Make arrays for readings and for errors that walk."""
        super().attach(setup, engine)
        self._drift, self._pressure, self._height = np.zeros((3, *setup.shape))
        self._root = np.sqrt(setup.period)

    def reset(
        self,
        world: int,
        swarm: Swarm,
        known: Swarm,
        rng: np.random.Generator,
    ) -> None:
        """Begin an episode of one world: nothing has walked yet."""
        self._drift[world] = 0.0

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure from the drones that measure; others keep their readings.

        Each world draws from its own generator, if its noise or walk is above 0.
        """
        mask = moment.mask
        uncertain = np.any((self.noise > 0) | (self.walk > 0), axis=1)
        normal, _ = moment._replace(mask=mask & uncertain[:, None]).draw(2)
        self._drift += moment.flying[:, None] * self._root * self.walk * normal[..., 0]
        error = self.bias + self._drift + self.noise * normal[..., 1]
        # Drones may fly to where the standard atmosphere is not told.
        height = np.clip(self._altitude + moment.after.position[mask, 2], MIN_HEIGHT, MAX_HEIGHT)
        measured = np.clip(pressure(height) + error[mask], *PRESSURES)
        self._pressure[mask] = measured
        self._height[mask] = pressure_altitude(measured) - self._altitude
        return {"barometer": self._pressure.copy(), "barometric_height": self._height.copy()}
