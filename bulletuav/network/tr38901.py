"""Path loss of 3GPP TR 38.901 (UMi street canyon and UMa), in dB, and line-of-sight probability.

Losses are those of table 7.4.1-1, probabilities those of table 7.4.2-1. The standard does not cover
drones as base stations: here the drone is the base station and the user the terminal.

All functions accept numbers or arrays that broadcast, and can be called from kernels. Their
arguments are:

- `ground_distance`: horizontal distance between base station and user, m;
- `base_height`, `user_height`: heights of the antennas above ground, m;
- `frequency`: carrier frequency, GHz.
"""

from bulletuav.compiled.functions import exp, log10
from bulletuav.compiled.kernel import elementwise, func
from bulletuav.network.propagation import antenna_distance

CERTAIN_LOS_DISTANCE = 18.0
"""Horizontal distance up to which the line-of-sight probability is 1, m (table 7.4.2-1)"""


@func
def _dual_slope(
    ground_distance: float,
    base_height: float,
    user_height: float,
    frequency: float,
    intercept: float,
    slope: float,
) -> float:
    """Return the dual-slope path loss with line of sight, dB.

    The slope is 40 dB per decade beyond the breakpoint. The effective environment height is 1 m;
    antennas below count as at that height. For UMa the standard randomises it for users above 13 m,
    which is not modelled here.
    """
    # Effective antenna heights
    base_above = max(base_height - 1.0, 0.0)
    user_above = max(user_height - 1.0, 0.0)
    # The standard uses 3e8 m/s for the speed of light
    breakpoint_distance = 4.0 * base_above * user_above * frequency * 1e9 / 3e8
    # Up to the breakpoint the loss grows by `slope` dB per decade
    reference = intercept + 20.0 * log10(frequency)
    decades = log10(antenna_distance(ground_distance, base_height, user_height))
    if ground_distance <= breakpoint_distance:
        return reference + slope * decades
    # The correction makes the loss continuous at the breakpoint
    squared = breakpoint_distance**2 + (base_height - user_height) ** 2
    correction = (20.0 - 0.5 * slope) * log10(max(squared, 1.0))
    return reference + 40.0 * decades - correction


@elementwise
def umi_los(
    ground_distance: float, base_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of UMi street canyon with line of sight, dB."""
    return _dual_slope(ground_distance, base_height, user_height, frequency, 32.4, 21.0)


@elementwise
def umi_nlos(
    ground_distance: float, base_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of UMi street canyon without line of sight, dB."""
    loss = (
        22.4
        + 35.3 * log10(antenna_distance(ground_distance, base_height, user_height))
        + 21.3 * log10(frequency)
        - 0.3 * (user_height - 1.5)
    )
    return max(umi_los(ground_distance, base_height, user_height, frequency), loss)


@elementwise
def umi_close_in_nlos(distance: float, frequency: float) -> float:
    """Return the optional close-in path loss of UMi street canyon without line of sight, dB.

    It is nearly `log_distance` with exponent 3.19, which has 32.448 in place of 32.4. The standard
    deviation of its shadowing is 8.2 dB.

    Args:
        distance: Three-dimensional distance between the antennas, m.
        frequency: Carrier frequency, GHz.
    """
    return 32.4 + 20.0 * log10(frequency) + 31.9 * log10(max(distance, 1.0))


@elementwise
def uma_los(
    ground_distance: float, base_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of UMa with line of sight, dB."""
    return _dual_slope(ground_distance, base_height, user_height, frequency, 28.0, 22.0)


@elementwise
def uma_nlos(
    ground_distance: float, base_height: float, user_height: float, frequency: float
) -> float:
    """Return the path loss of UMa without line of sight, dB."""
    loss = (
        13.54
        + 39.08 * log10(antenna_distance(ground_distance, base_height, user_height))
        + 20.0 * log10(frequency)
        - 0.6 * (user_height - 1.5)
    )
    return max(uma_los(ground_distance, base_height, user_height, frequency), loss)


@func
def decaying_los_probability(ground_distance: float, certain: float, decay: float) -> float:
    """Return a line-of-sight probability that is 1 up to a distance and then decays.

    TR 38.901 and TR 36.777 use this form: s / d + exp(-d / decay) (1 - s / d).

    Args:
        ground_distance: Horizontal distance d between the antennas, m.
        certain: Distance s up to which the probability is 1, m.
        decay: Decay length of the exponential part, m.
    """
    if ground_distance <= certain:
        return 1.0
    fraction = certain / ground_distance
    return fraction + exp(-ground_distance / decay) * (1.0 - fraction)


@elementwise
def umi_los_probability(ground_distance: float) -> float:
    """Return the line-of-sight probability of UMi street canyon."""
    return decaying_los_probability(ground_distance, CERTAIN_LOS_DISTANCE, 36.0)


@elementwise
def uma_los_probability(ground_distance: float, user_height: float) -> float:
    """Return the line-of-sight probability of UMa."""
    # Correction for users above 13 m
    height_factor: float = (max(user_height - 13.0, 0.0) / 10.0) ** 1.5
    distance_factor = (ground_distance / 100.0) ** 3
    gain = 1.25 * height_factor * distance_factor * exp(-ground_distance / 150.0)
    if ground_distance > CERTAIN_LOS_DISTANCE:
        return decaying_los_probability(ground_distance, CERTAIN_LOS_DISTANCE, 63.0) * (1.0 + gain)
    return 1.0
