"""Basic laws of path loss between two antennas, in dB.

Frequencies are in GHz and lengths in m. Antennas closer than 1 m count as 1 m apart, so that all
losses are finite. The functions take numbers, or arrays that broadcast; kernels call them too.
"""

import math

from bulletuav.compiled.functions import hypot, log10
from bulletuav.compiled.kernel import elementwise, func

SPEED_OF_LIGHT = 299792458.0
"""Speed of light in vacuum, m/s"""
NLOS_EXPONENT = 3.19
"""Path loss exponent without line of sight, of the close-in law `tr38901.umi_close_in_nlos`"""
EXPONENTS = {"urbanmarl": 3.5, "umi_ci": NLOS_EXPONENT}
"""Exponents of `log_distance` without line of sight: of UrbanMARL 0.3.1, and of TR 38.901"""
EXCESS = {
    "suburban": (0.1, 21.0),
    "urban": (1.0, 20.0),
    "dense": (1.6, 23.0),
    "high_rise": (2.3, 34.0),
}
"""Mean loss beyond free space (dB) with and without line of sight, for `mean_path_loss`.

The customary values for 2 GHz: I. Bor-Yaliniz, A. El-Keyi, H. Yanikomeroglu, IEEE ICC 2016.
"""


@func
def antenna_distance(ground_distance: float, height: float, other_height: float) -> float:
    """Return the distance between two antennas, m, at least 1 m.

    Args:
        ground_distance: Horizontal distance between them, m.
        height: Height of one antenna, m.
        other_height: Height of the other antenna, m.
    """
    return max(hypot(ground_distance, height - other_height), 1.0)


@elementwise
def free_space(distance: float, frequency: float) -> float:
    """Return the free-space path loss, dB: 20 log10(4 pi d f / c) (H. T. Friis, 1946).

    Args:
        distance: Distance d between the antennas, m; counts as 1 m where it is less.
        frequency: Carrier frequency f, GHz.
    """
    return 20.0 * log10(4e9 * math.pi * max(distance, 1.0) * frequency / SPEED_OF_LIGHT)


@elementwise
def log_distance(distance: float, frequency: float, exponent: float) -> float:
    """Return a path loss that grows with a power of the distance, dB.

    It is the free-space loss at 1 m, plus 10 n log10(d).

    Args:
        distance: Distance d between the antennas, m; counts as 1 m where it is less.
        frequency: Carrier frequency, GHz.
        exponent: Path loss exponent n; 2 gives free space. See `EXPONENTS`.
    """
    # Free space up to 1 m
    reference = free_space(1.0, frequency)
    return reference + 10.0 * exponent * log10(max(distance, 1.0))


@elementwise
def mean_path_loss(
    distance: float, frequency: float, los_probability: float, excess_los: float, excess_nlos: float
) -> float:
    """Return the path loss in the mean over places with and without line of sight, dB.

    It is the free-space loss plus the mean excess loss: A. Al-Hourani, S. Kandeepan, S. Lardner,
    IEEE Wireless Communications Letters 3 (2014).

    Args:
        distance: Distance between the antennas, m.
        frequency: Carrier frequency, GHz.
        los_probability: Probability of a line of sight, see `bulletuav.city.sight_probability`.
        excess_los: Loss beyond free space with line of sight, dB, see `EXCESS`.
        excess_nlos: Loss beyond free space without line of sight, dB, see `EXCESS`.
    """
    excess_in_sight = los_probability * excess_los
    excess_out_of_sight = (1.0 - los_probability) * excess_nlos
    return free_space(distance, frequency) + excess_in_sight + excess_out_of_sight
