"""Airspeed sensor: differential pressure of a pitot tube along the body's x axis."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.airframe import DENSITY

NOISE = 1.0
"""Pa; that of PX4's simulation in Gazebo (plugin gazebo_airspeed_plugin, 0.01 hPa)"""
MAX_BIAS = 100.0
"""Maximum constant error, Pa; the total error band of an MS4525DO of 1 psi is 69 Pa"""
MAX_PRESSURE = 6895.0
"""Measurement range, Pa: the 1 psi of an MS4525DO, 106 m/s"""
MAX_AIRSPEED = 106.1
"""Airspeed at the maximum pressure, m/s"""


@register("sensor")
class Airspeed(Sensor):
    """Differential pressure of a pitot tube, and the indicated airspeed.

    The pressure is density / 2 V^2, with the velocity V through the air along the body's x axis and
    the density of the standard atmosphere at sea level, as in all forces of the air. It is 0 for
    air from behind. A constant bias and white noise are added, so a standing aircraft indicates
    some airspeed, and a fast one a more precise one. The air is that of the wind with its gusts and
    thermals, at the position of the drone.

    The reading "differential_pressure" is the pressure, Pa, and "airspeed" the airspeed that it
    indicates, m/s, as in the fields diff_pressure and airspeed of MAVLink's HIL_SENSOR (in hPa) and
    VFR_HUD.

    Attributes:
        noise: (W, N) standard deviation of the white noise, Pa.
        bias: (W, N) constant error, Pa.
    """

    name = "airspeed"
    gives = ("differential_pressure", "airspeed")
    needs_wind = True
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 1000.0, usual=NOISE),
        "bias": Uncertain(-MAX_BIAS, MAX_BIAS),
    }

    noise: np.ndarray
    bias: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return the labels and bounds of pressure and airspeed."""
        return {
            "differential_pressure": (
                Label("differential pressure", "Pa", -MAX_PRESSURE, MAX_PRESSURE),
            ),
            "airspeed": (Label("airspeed", "m/s", 0.0, MAX_AIRSPEED),),
        }

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate the readings."""
        super().attach(setup, engine)
        self._pressure, self._airspeed = np.zeros((2, *setup.shape))

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure pressure and airspeed of the drones in the mask; other readings do not change.

        Each world draws from its own generator if its noise is above 0.
        """
        mask, uncertain = moment.mask, np.any(self.noise > 0, axis=1)
        normal, _ = moment._replace(mask=mask & uncertain[:, None]).draw()
        ahead = rotate_vectors(moment.after.quaternion, np.array((1.0, 0.0, 0.0)))
        air = moment.after.velocity
        if moment.wind is not None:
            air = air - moment.wind
        speed = np.maximum((ahead * air).sum(axis=-1), 0.0)
        error = self.bias + self.noise * normal[..., 0]
        pressure = (0.5 * DENSITY * speed * speed + error)[mask]
        self._pressure[mask] = np.clip(pressure, -MAX_PRESSURE, MAX_PRESSURE)
        self._airspeed[mask] = np.sqrt(np.maximum(self._pressure[mask], 0.0) * (2.0 / DENSITY))
        return {
            "differential_pressure": self._pressure.copy(),
            "airspeed": self._airspeed.copy(),
        }
