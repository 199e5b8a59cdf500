"""Inertial, magnetic and air-data values of a vehicle, in the units of HIL_SENSOR and HIGHRES_IMU.

Source: https://mavlink.io/en/messages/common.html.
"""

import functools
from collections.abc import Sequence

import numpy as np

from bulletuav.earth import flu_to_frd, geopotential_height, magnetic_field, pressure, temperature
from bulletuav.geometry.rotation import to_body
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

GAUSS, KELVIN = 1e-4, 273.15
"""Teslas per gauss; 0 degrees Celsius in kelvins"""


def measure(
    quaternion: np.ndarray,
    rates: np.ndarray,
    acceleration: Sequence[float],
    field: np.ndarray,
    height: float,
) -> np.ndarray:
    """Return the values of ideal sensors, in the order of the fields of HIGHRES_IMU.

    Args:
        quaternion: (4,) attitude, body (FLU) to world (ENU).
        rates: (3,) angular rates in body axes, rad/s.
        acceleration: (3,) acceleration in world axes, m/s^2.
        field: (3,) magnetic field in world axes, gauss.
        height: Altitude, m.

    Returns:
        (13,) specific force (m/s^2), rates (rad/s) and magnetic field (gauss) in forward, right,
        down; absolute and differential pressure (hPa), pressure altitude (m), temperature (deg C).
    """
    x, y, z = acceleration
    # An accelerometer measures specific force: at rest, gravity upwards
    force = flu_to_frd(to_body(quaternion, (x, y, z + STANDARD_GRAVITY)))
    air = (
        float(pressure(height)) / 100,
        0.0,
        float(geopotential_height(height)),
        float(temperature(height)) - KELVIN,
    )
    return np.concatenate([force, flu_to_frd(rates), flu_to_frd(to_body(quaternion, field)), air])


@functools.cache
def compute_field(home: tuple[float, ...]) -> np.ndarray:
    """Return the magnetic field (3,) at a home (latitude and longitude in deg, altitude in m).

    The field is in world axes (ENU), in gauss.
    """
    latitude, longitude, altitude = home
    return magnetic_field(latitude, longitude, altitude) / GAUSS
