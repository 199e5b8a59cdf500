"""Basic path loss models between two antennas, in dB.

Frequencies are in GHz and lengths in m. Distances below 1 m count as 1 m, so that all losses are
finite. The functions accept numbers or arrays that broadcast, and can be called from kernels.
"""

import math

from bulletuav.compiled.functions import hypot, log10
from bulletuav.compiled.kernel import elementwise, func

SPEED_OF_LIGHT = 299792458.0
"""Speed of light in vacuum, m/s"""
NLOS_EXPONENT = 3.19
"""Path loss exponent without line of sight of the close-in model `tr38901.umi_close_in_nlos`"""
EXPONENTS = {"urbanmarl": 3.5, "umi_ci": NLOS_EXPONENT}
"""Exponents of `log_distance` without line of sight: UrbanMARL 0.3.1 and TR 38.901"""
EXCESS = {
    "suburban": (0.1, 21.0),
    "urban": (1.0, 20.0),
    "dense": (1.6, 23.0),
    "high_rise": (2.3, 34.0),
}
"""Mean excess loss (dB) with and without line of sight, for `mean_path_loss`.

Common values for 2 GHz: I. Bor-Yaliniz, A. El-Keyi, H. Yanikomeroglu, IEEE ICC 2016.
"""


@func
def antenna_distance(ground_distance: float, height: float, other_height: float) -> float:
    """Return the distance between two antennas, m, at least 1 m.

    Args:
        ground_distance: Horizontal distance, m.
        height: Height of one antenna, m.
        other_height: Height of the other antenna, m.
    """
    return max(hypot(ground_distance, height - other_height), 1.0)


@elementwise
def free_space(distance: float, frequency: float) -> float:
    """Return the free-space path loss, dB: 20 log10(4 pi d f / c) (H. T. Friis, 1946).

    Args:
        distance: Distance d between the antennas, m; values below 1 m count as 1 m.
        frequency: Carrier frequency f, GHz.
    """
    return 20.0 * log10(4e9 * math.pi * max(distance, 1.0) * frequency / SPEED_OF_LIGHT)


@elementwise
def log_distance(distance: float, frequency: float, exponent: float) -> float:
    """Return the path loss of the log-distance model, dB.

    It is the free-space loss at 1 m, plus 10 n log10(d).

    Args:
        distance: Distance d between the antennas, m; values below 1 m count as 1 m.
        frequency: Carrier frequency, GHz.
        exponent: Path loss exponent n; 2 is free space. See `EXPONENTS`.
    """
    reference = free_space(1.0, frequency)
    return reference + 10.0 * exponent * log10(max(distance, 1.0))


@elementwise
def mean_path_loss(
    distance: float, frequency: float, los_probability: float, excess_los: float, excess_nlos: float
) -> float:
    """Return the mean path loss over line-of-sight conditions, dB.

    It is the free-space loss plus the mean excess loss.

    Args:
        distance: Distance between the antennas, m.
        frequency: Carrier frequency, GHz.
        los_probability: Probability of line of sight, see `bulletuav.city.sight_probability`.
        excess_los: Excess loss with line of sight, dB, see `EXCESS`.
        excess_nlos: Excess loss without line of sight, dB, see `EXCESS`.

    References:
        A. Al-Hourani, S. Kandeepan, S. Lardner, IEEE Wireless Communications Letters 3 (2014).
    """
    excess_in_sight = los_probability * excess_los
    excess_out_of_sight = (1.0 - los_probability) * excess_nlos
    return free_space(distance, frequency) + excess_in_sight + excess_out_of_sight
