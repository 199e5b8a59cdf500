"""Antenna elements of 3GPP TR 38.901, gains in dBi.

Angles in degrees: zenith from the z axis, in [0, 180]; azimuth from x towards y, in [-180, 180]. An antenna radiates most
along the x axis of its local frame (zenith 90, azimuth 0). At the ends of the local z axis the azimuth has no meaning, but
the pattern depends on it: there, and nowhere else, the gain jumps.
"""

import math

from bulletuav.kernel import elementwise, func

PEAK = 8.0  # dBi
BEAMWIDTH = 65.0  # degrees, between the directions of half the power
DEPTH = 30.0  # dB, the most that any direction is below the peak
INDOOR_PEAK = 5.0
INDOOR_BEAMWIDTH = 90.0
INDOOR_DEPTH = 25.0


@func
def _attenuation(above, aside, beamwidth, depth):
    """How much less than at its peak an element radiates (dB) at these degrees from its horizontal and vertical plane."""
    vertical = min(12.0 * (above / beamwidth) ** 2, depth)
    horizontal = min(12.0 * (aside / beamwidth) ** 2, depth)
    return min(vertical + horizontal, depth)


@elementwise
def element_gain(zenith, azimuth, peak):
    """Gain (dBi) towards a direction in the antenna's local frame, `peak` (PEAK in the standard) at the most.

    TR 38.901, table 7.3-1.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, BEAMWIDTH, DEPTH)


@elementwise
def indoor_gain(zenith, azimuth, peak):
    """As `element_gain`, of the wider element for indoor stations and handsets, INDOOR_PEAK in the standard.

    Report ITU-R M.2412, indoor hotspots.
    """
    return peak - _attenuation(zenith - 90.0, azimuth, INDOOR_BEAMWIDTH, INDOOR_DEPTH)


@elementwise
def local_zenith(zenith, azimuth, bearing, downtilt):
    """Zenith in the local frame of an antenna turned to `bearing` and tilted down, slant 0 (TR 38.901, eq. 7.1-7)."""
    theta, phi, beta = math.radians(zenith), math.radians(azimuth - bearing), math.radians(downtilt)
    cosine = math.cos(beta) * math.cos(theta) + math.sin(beta) * math.cos(phi) * math.sin(theta)
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))  # rounding goes beyond 1


@elementwise
def local_azimuth(zenith, azimuth, bearing, downtilt):
    """Azimuth in the local frame of an antenna turned to `bearing` and tilted down, slant 0 (TR 38.901, eq. 7.1-8)."""
    theta, phi, beta = math.radians(zenith), math.radians(azimuth - bearing), math.radians(downtilt)
    ahead = math.cos(beta) * math.sin(theta) * math.cos(phi) - math.sin(beta) * math.cos(theta)
    return math.degrees(math.atan2(math.sin(theta) * math.sin(phi), ahead))


@elementwise
def gain_towards(x, y, z, peak):
    """Gain (dBi) of an antenna that looks straight down (bearing 0, downtilt 90) towards a vector in the drone's body frame.

    The body's x axis points ahead, y left, z up; any length does, and none at all counts as straight below. The same as
    `element_gain` at `local_zenith` and `local_azimuth`, without their loss of digits near the vertical.
    """
    above = math.degrees(math.atan2(x, math.hypot(y, z)))
    aside = math.degrees(math.atan2(y, 0.0 - z))  # -z would be -0, behind, where y and z are 0
    return peak - _attenuation(above, aside, BEAMWIDTH, DEPTH)
