"""Magnetometer: the Earth's magnetic field in body axes."""

import datetime
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.earth.magnetism import (
    EPOCH,
    MAX_ALTITUDE,
    MIN_ALTITUDE,
    decimal_year,
    magnetic_field,
)
from bulletuav.engine.engine import Engine
from bulletuav.errors import finite
from bulletuav.geometry.rotation import quat4, to_body
from bulletuav.registry import register
from bulletuav.sensors.base import Moment, Sensor, SensorSetup, Uncertain, vector_labels
from bulletuav.vehicle.swarm import Swarm

NOISE = 0.3
"""uT; Bosch BMM150 at 20 Hz, preset "high accuracy" (BST-BMM150-DS001)"""
HARD_IRON = 2.0
"""uT; residual offset of a BMM150 after calibration (BST-BMM150-DS001)"""
MICROTESLA = 1e6
"""Microteslas per tesla"""
MAX_FIELD = 200.0
"""Bound of an observed field, uT; the Earth's field is up to 67, the rest is a margin for hard
iron"""
LATITUDE, LONGITUDE, ALTITUDE = 47.397742, 8.545594, 488.0
"""Default origin of PX4 simulations, in Zurich: degrees, and m above the ellipsoid"""


@kernel
def _measure(
    quaternion: np.ndarray,
    field: np.ndarray,
    error: np.ndarray,
    mask: np.ndarray,
    reading: np.ndarray,
) -> None:
    """Rotate the field (3,) to body axes and add errors (W, N, 3), for the drones in `mask`."""
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if mask[w, i]:
                felt = to_body(quat4(quaternion, w, i), (field[0], field[1], field[2]))
                for k in range(3):
                    reading[w, i, k] = felt[k] + error[w, i, k]


@register("sensor")
class Magnetometer(Sensor):
    """Magnetic field of the Earth in body axes (forward, left, up), uT.

    The field is that of IGRF-14 at the world's origin. It is computed once per environment, in a
    millisecond, and is the same in all worlds: within 10 km it changes by less than 0.1 uT. A uT is
    1e-6 T, the unit of ROS, and 0.01 gauss, the unit of PX4. `bulletuav.earth.flu_to_frd` converts
    to the axes of autopilots. `Imperfect(Magnetometer(), rate=20)` has the sample rate of a BMM150.

    Hard iron adds a constant error in body axes, drawn for each episode. Soft iron and motor
    currents are not modelled.

    Attributes:
        noise: (W, N) standard deviation of the white noise on each axis, uT.
        hard_iron: (W, N) standard deviation of the constant error on each axis, uT.
    """

    name = "magnetometer"
    numbers = vector_labels("magnetic field", "uT", [-MAX_FIELD] * 3, [MAX_FIELD] * 3)
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 1000.0, usual=NOISE),
        "hard_iron": Uncertain(0.0, 1000.0, usual=HARD_IRON),
    }

    noise: np.ndarray
    hard_iron: np.ndarray

    def __init__(
        self,
        latitude: float = LATITUDE,
        longitude: float = LONGITUDE,
        altitude: float = ALTITUDE,
        date: float | datetime.date = EPOCH,
    ) -> None:
        """Set the location and date.

        Args:
            latitude: Geodetic latitude of the world's origin, from -90 to 90 deg.
            longitude: Longitude of the origin, from -180 to 180 deg.
            altitude: Altitude of the origin above the WGS-84 ellipsoid, from -10 to 1000 km, in m.
            date: Decimal year from 2025.0 to 2030.0, or a date in this range.

        Raises:
            ValueError: If a number is not finite or out of bounds.
        """
        self._place = (
            finite("latitude", latitude, -90.0, 90.0),
            finite("longitude", longitude, -180.0, 180.0),
            finite("altitude", altitude, MIN_ALTITUDE, MAX_ALTITUDE),
        )
        self._year = decimal_year(date)

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Compute the field, and allocate readings and constant errors."""
        super().attach(setup, engine)
        self._field = MICROTESLA * magnetic_field(*self._place, self._year)
        self._iron, self._reading = np.zeros((2, *setup.shape, 3))

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Draw the hard-iron errors of a world, if enabled."""
        scale = self.hard_iron[world]
        self._iron[world] = 0.0
        if scale.any():
            self._iron[world] = scale[:, None] * rng.standard_normal((len(scale), 3))

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure the field for the drones in the mask; other readings do not change.

        Each world draws from its own generator if its noise is above 0.
        """
        mask = moment.mask
        uncertain = np.any(self.noise > 0, axis=1)
        normal, _ = moment._replace(mask=mask & uncertain[:, None]).draw(3)
        error = self._iron + self.noise[..., None] * normal
        _measure(moment.after.quaternion, self._field, error, mask, self._reading)
        return {"magnetometer": self._reading.copy()}
