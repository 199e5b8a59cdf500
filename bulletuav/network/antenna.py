"""Antenna elements of 3GPP TR 38.901, with gains in dBi.

Angles are in degrees: the zenith angle from the z axis, in [0, 180], and the azimuth from x towards
y, in [-180, 180]. An antenna radiates most along the x axis of its local frame, at zenith 90 and
azimuth 0. At the ends of the local z axis the azimuth has no meaning, but the pattern depends on
it: there, and nowhere else, the gain jumps.

All functions take numbers, or arrays that broadcast; kernels call them too.
"""

import math

from bulletuav.compiled.functions import acos, atan2, cos, hypot, sin
from bulletuav.compiled.kernel import elementwise, func

PEAK = 8.0
"""Greatest gain of the element, dBi (TR 38.901, table 7.3-1)"""
BEAMWIDTH = 65.0
"""Angle between the directions of half the power, degrees"""
MAX_ATTENUATION = 30.0
"""Most that any direction is below the peak, dB"""
INDOOR_PEAK = 5.0
"""Greatest gain of the indoor element, dBi (Report ITU-R M.2412)"""
INDOOR_BEAMWIDTH = 90.0
"""Angle between the directions of half the power of the indoor element, degrees"""
INDOOR_MAX_ATTENUATION = 25.0
"""Most that any direction of the indoor element is below its peak, dB"""


@func
def _attenuation(
    elevation: float, azimuth: float, beamwidth: float, max_attenuation: float
) -> float:
    """Return how far below its peak an element radiates (dB), by the angles off its x axis."""
    vertical = min(12.0 * (elevation / beamwidth) ** 2, max_attenuation)
    horizontal = min(12.0 * (azimuth / beamwidth) ** 2, max_attenuation)
    return min(vertical + horizontal, max_attenuation)


@elementwise
def element_gain(zenith: float, azimuth: float, peak: float) -> float:
    """Return the gain of the element towards a direction, dBi (TR 38.901, table 7.3-1).

    Args:
        zenith: Zenith angle in the antenna's local frame, degrees.
        azimuth: Azimuth in the antenna's local frame, degrees.
        peak: Greatest gain, dBi; `PEAK` in the standard.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, BEAMWIDTH, MAX_ATTENUATION)


@elementwise
def indoor_gain(zenith: float, azimuth: float, peak: float) -> float:
    """Return the gain of the wider element for indoor stations and handsets, dBi.

    Source: Report ITU-R M.2412, indoor hotspots.

    Args:
        zenith: Zenith angle in the antenna's local frame, degrees.
        azimuth: Azimuth in the antenna's local frame, degrees.
        peak: Greatest gain, dBi; `INDOOR_PEAK` in the report.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, INDOOR_BEAMWIDTH, INDOOR_MAX_ATTENUATION)


@elementwise
def local_zenith(zenith: float, azimuth: float, bearing: float, downtilt: float) -> float:
    """Return the zenith angle of a direction in an antenna's local frame, degrees.

    TR 38.901, eq. 7.1-7, with slant 0.

    Args:
        zenith: Zenith angle in the global frame, degrees.
        azimuth: Azimuth in the global frame, degrees.
        bearing: Azimuth that the antenna is turned to, degrees.
        downtilt: Angle that the antenna is tilted down by, degrees.
    """
    theta = math.radians(zenith)
    phi = math.radians(azimuth - bearing)
    beta = math.radians(downtilt)
    # Cosine of the angle to the local z axis
    cosine = cos(beta) * cos(theta) + sin(beta) * cos(phi) * sin(theta)
    # Rounding can lead beyond 1
    return math.degrees(acos(min(max(cosine, -1.0), 1.0)))


@elementwise
def local_azimuth(zenith: float, azimuth: float, bearing: float, downtilt: float) -> float:
    """Return the azimuth of a direction in an antenna's local frame, degrees.

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
    """Return the gain of a drone's antenna that looks straight down, dBi.

    The antenna has bearing 0 and downtilt 90. The gain is that of `element_gain` at `local_zenith`
    and `local_azimuth`, without their loss of digits near the vertical.

    Args:
        x: Component ahead of the vector to the other end, in the drone's body frame.
        y: Component to the left.
        z: Component up. The vector may have any length; none at all counts as straight below.
        peak: Greatest gain, dBi; `PEAK` in the standard.
    """
    # The antenna's local x axis is -z of the body, and its local z axis is x of the body
    elevation = math.degrees(atan2(x, hypot(y, z)))
    # 0.0 - z, since -z would be -0.0 where y and z are 0, which is behind the antenna
    azimuth = math.degrees(atan2(y, 0.0 - z))
    return peak - _attenuation(elevation, azimuth, BEAMWIDTH, MAX_ATTENUATION)
