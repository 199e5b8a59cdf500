"""Coordinates, axes, atmosphere and magnetic field of the Earth, for clients, bridges and sensors.

Flights depend on this package if drones observe a barometer or a magnetometer.
"""

from bulletuav.earth.atmosphere import (
    density,
    geometric_height,
    geopotential_height,
    pressure,
    pressure_altitude,
    temperature,
)
from bulletuav.earth.axes import (
    attitude_to_enu,
    attitude_to_ned,
    enu_to_ned,
    flu_to_frd,
    frd_to_flu,
    ned_to_enu,
)
from bulletuav.earth.geodesy import (
    Origin,
    degree_lengths,
    ecef_to_geodetic,
    geodetic_to_ecef,
)
from bulletuav.earth.magnetism import magnetic_field

__all__ = [
    "Origin",
    "attitude_to_enu",
    "attitude_to_ned",
    "degree_lengths",
    "density",
    "ecef_to_geodetic",
    "enu_to_ned",
    "flu_to_frd",
    "frd_to_flu",
    "geodetic_to_ecef",
    "geometric_height",
    "geopotential_height",
    "magnetic_field",
    "ned_to_enu",
    "pressure",
    "pressure_altitude",
    "temperature",
]
