"""Antenna element patterns of 3GPP TR 38.901, with gains in dBi.

Angles are in degrees: the zenith angle from the z axis, in [0, 180], and the azimuth from x towards
y, in [-180, 180]. The boresight is the x axis of the local frame, at zenith 90 and azimuth 0. On
the local z axis the azimuth is undefined, but the pattern depends on it: the gain is discontinuous
there, and only there.

All functions accept numbers or arrays that broadcast, and can be called from kernels.
"""

import math

from bulletuav.compiled.functions import acos, atan2, cos, hypot, sin
from bulletuav.compiled.kernel import elementwise, func

PEAK = 8.0
"""Maximum gain of the element, dBi (TR 38.901, table 7.3-1)"""
BEAMWIDTH = 65.0
"""Half-power beamwidth, degrees"""
MAX_ATTENUATION = 30.0
"""Maximum attenuation relative to the peak, dB"""
INDOOR_PEAK = 5.0
"""Maximum gain of the indoor element, dBi (Report ITU-R M.2412)"""
INDOOR_BEAMWIDTH = 90.0
"""Half-power beamwidth of the indoor element, degrees"""
INDOOR_MAX_ATTENUATION = 25.0
"""Maximum attenuation of the indoor element, dB"""


@func
def _attenuation(
    elevation: float, azimuth: float, beamwidth: float, max_attenuation: float
) -> float:
    """Return the attenuation relative to the peak, dB, by the angles from boresight."""
    vertical = min(12.0 * (elevation / beamwidth) ** 2, max_attenuation)
    horizontal = min(12.0 * (azimuth / beamwidth) ** 2, max_attenuation)
    return min(vertical + horizontal, max_attenuation)


@elementwise
def element_gain(zenith: float, azimuth: float, peak: float) -> float:
    """Return the gain of the element in a direction, dBi (TR 38.901, table 7.3-1).

    Args:
        zenith: Zenith angle in the local frame of the antenna, degrees.
        azimuth: Azimuth in the local frame of the antenna, degrees.
        peak: Maximum gain, dBi; `PEAK` in the standard.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, BEAMWIDTH, MAX_ATTENUATION)


@elementwise
def indoor_gain(zenith: float, azimuth: float, peak: float) -> float:
    """Return the gain of the wider element for indoor stations and handsets, dBi.

    Args:
        zenith: Zenith angle in the local frame of the antenna, degrees.
        azimuth: Azimuth in the local frame of the antenna, degrees.
        peak: Maximum gain, dBi; `INDOOR_PEAK` in the report.

    References:
        Report ITU-R M.2412, indoor hotspots.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, INDOOR_BEAMWIDTH, INDOOR_MAX_ATTENUATION)


@elementwise
def local_zenith(zenith: float, azimuth: float, bearing: float, downtilt: float) -> float:
    """Return the zenith angle of a direction in the local frame of an antenna, degrees.

    TR 38.901, eq. 7.1-7, with slant 0.

    Args:
        zenith: Zenith angle in the global frame, degrees.
        azimuth: Azimuth in the global frame, degrees.
        bearing: Bearing angle of the antenna, degrees.
        downtilt: Downtilt angle of the antenna, degrees.
    """
    theta = math.radians(zenith)
    phi = math.radians(azimuth - bearing)
    beta = math.radians(downtilt)
    # Cosine of the angle to the local z axis
    cosine = cos(beta) * cos(theta) + sin(beta) * cos(phi) * sin(theta)
    # Clamp rounding errors
    return math.degrees(acos(min(max(cosine, -1.0), 1.0)))


@elementwise
def local_azimuth(zenith: float, azimuth: float, bearing: float, downtilt: float) -> float:
    """Return the azimuth of a direction in the local frame of an antenna, degrees.

    TR 38.901, eq. 7.1-8, with slant 0. The arguments are those of `local_zenith`.
    """
    theta = math.radians(zenith)
    phi = math.radians(azimuth - bearing)
    beta = math.radians(downtilt)
    # Component along the local x axis
    ahead = cos(beta) * sin(theta) * cos(phi) - sin(beta) * cos(theta)
    return math.degrees(atan2(sin(theta) * sin(phi), ahead))


@elementwise
def gain_towards(x: float, y: float, z: float, peak: float) -> float:
    """Return the gain of a downward-facing antenna of a drone, dBi.

    The antenna has bearing 0 and downtilt 90. The result is that of `element_gain` at
    `local_zenith` and `local_azimuth`, without their loss of precision near the vertical.

    Args:
        x: Forward component of the vector to the other end, in the body frame of the drone.
        y: Left component.
        z: Upward component. The vector may have any length; the zero vector counts as straight
            below.
        peak: Maximum gain, dBi; `PEAK` in the standard.
    """
    # The antenna's local x axis is -z of the body, and its local z axis is x of the body
    elevation = math.degrees(atan2(x, hypot(y, z)))
    # 0.0 - z instead of -z, which would be -0.0 for z = 0 and mean behind the antenna
    azimuth = math.degrees(atan2(y, 0.0 - z))
    return peak - _attenuation(elevation, azimuth, BEAMWIDTH, MAX_ATTENUATION)
