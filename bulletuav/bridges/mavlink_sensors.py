"""Inertial, magnetic and air-data values of a vehicle, in the units of HIL_SENSOR and HIGHRES_IMU.

Source: https://mavlink.io/en/messages/common.html.
"""

import functools

import numpy as np

from bulletuav.earth import flu_to_frd, geopotential_height, magnetic_field, pressure, temperature
from bulletuav.geometry.rotation import to_body
from bulletuav.vehicle.airframe import STANDARD_GRAVITY

GAUSS, KELVIN = 1e-4, 273.15
"""Teslas per gauss; 0 degrees Celsius in kelvins"""


def measure(
    quaternion: np.ndarray,
    rates: np.ndarray,
    acceleration: np.ndarray,
    field: np.ndarray,
    height: np.ndarray,
) -> np.ndarray:
    """Return the values of the ideal sensors of N vehicles, in the order of HIGHRES_IMU's fields.

    Args:
        quaternion: (N, 4) attitudes, body (FLU) to world (ENU).
        rates: (N, 3) angular rates in body axes, rad/s.
        acceleration: (N, 3) accelerations in world axes, m/s^2.
        field: (3,) magnetic field in world axes, gauss.
        height: (N,) altitudes, m.

    Returns:
        (N, 13) specific force (m/s^2), rates (rad/s) and magnetic field (gauss) in forward, right,
        down; absolute and differential pressure (hPa), pressure altitude (m), temperature (deg C).
    """
    # An accelerometer measures specific force: at rest, gravity upwards
    force = acceleration + np.array((0.0, 0.0, STANDARD_GRAVITY))
    in_body = [
        (*to_body(attitude, one), *to_body(attitude, field))
        for attitude, one in zip(quaternion, force, strict=True)
    ]
    force, magnetic = np.split(np.array(in_body), 2, axis=1)
    values = np.zeros((len(quaternion), 13))
    values[:, :9] = np.hstack([flu_to_frd(force), flu_to_frd(rates), flu_to_frd(magnetic)])
    values[:, 9] = pressure(height) / 100
    values[:, 11] = geopotential_height(height)
    values[:, 12] = temperature(height) - KELVIN
    return values


@functools.cache
def compute_field(home: tuple[float, ...]) -> np.ndarray:
    """Return the magnetic field (3,) at a home (latitude and longitude in deg, altitude in m).

    The field is in world axes (ENU), in gauss.
    """
    latitude, longitude, altitude = home
    return magnetic_field(latitude, longitude, altitude) / GAUSS
