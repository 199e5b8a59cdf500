"""Path loss of 3GPP TR 36.777 for aerial terminals (UMi-AV and UMa-AV), in dB, and shadowing.

Losses, line-of-sight probabilities and shadowing are those of tables B-1 to B-3. In this standard
the drone is the terminal; here the ground user takes the role of the base station. Drones up to
`LOWEST_AERIAL` m use TR 38.901.

All functions accept numbers or arrays that broadcast, and can be called from kernels. Their
arguments are:

- `ground_distance`: horizontal distance between drone and base station, m;
- `drone_height`, `base_height`: heights of the antennas above ground, m;
- `frequency`: carrier frequency, GHz.
"""

import math

from bulletuav.compiled.functions import exp, log10
from bulletuav.compiled.kernel import elementwise
from bulletuav.network.propagation import antenna_distance, free_space
from bulletuav.network.tr38901 import (
    CERTAIN_LOS_DISTANCE,
    decaying_los_probability,
    uma_los,
    uma_los_probability,
    uma_nlos,
    umi_los,
    umi_los_probability,
    umi_nlos,
)

LOWEST_AERIAL = 22.5
"""Height up to which TR 36.777 refers to TR 38.901, m"""


@elementwise
def umi_av_los(
    ground_distance: float, drone_height: float, base_height: float, frequency: float
) -> float:
    """Return the path loss of UMi-AV with line of sight, dB; up to 22.5 m that of TR 38.901."""
    if drone_height <= LOWEST_AERIAL:
        return umi_los(ground_distance, base_height, drone_height, frequency)
    distance = antenna_distance(ground_distance, drone_height, base_height)
    slope = 22.25 - 0.5 * log10(drone_height)
    loss = 30.9 + slope * log10(distance) + 20.0 * log10(frequency)
    return max(free_space(distance, frequency), loss)


@elementwise
def umi_av_nlos(
    ground_distance: float, drone_height: float, base_height: float, frequency: float
) -> float:
    """Return the path loss of UMi-AV without line of sight, dB; up to 22.5 m that of TR 38.901."""
    if drone_height <= LOWEST_AERIAL:
        return umi_nlos(ground_distance, base_height, drone_height, frequency)
    distance = antenna_distance(ground_distance, drone_height, base_height)
    slope = 43.2 - 7.6 * log10(drone_height)
    loss = 32.4 + slope * log10(distance) + 20.0 * log10(frequency)
    return max(umi_av_los(ground_distance, drone_height, base_height, frequency), loss)


@elementwise
def uma_av_los(
    ground_distance: float, drone_height: float, base_height: float, frequency: float
) -> float:
    """Return the path loss of UMa-AV with line of sight, dB; up to 22.5 m that of TR 38.901."""
    if drone_height <= LOWEST_AERIAL:
        return uma_los(ground_distance, base_height, drone_height, frequency)
    distance = antenna_distance(ground_distance, drone_height, base_height)
    return 28.0 + 22.0 * log10(distance) + 20.0 * log10(frequency)


@elementwise
def uma_av_nlos(
    ground_distance: float, drone_height: float, base_height: float, frequency: float
) -> float:
    """Return the path loss of UMa-AV without line of sight, dB; up to 22.5 m that of TR 38.901.

    Above 100 m the standard has no blocked links. There the formula is evaluated at 100 m (our
    choice).
    """
    if drone_height <= LOWEST_AERIAL:
        return uma_nlos(ground_distance, base_height, drone_height, frequency)
    distance = antenna_distance(ground_distance, drone_height, base_height)
    slope = 46.0 - 7.0 * log10(min(drone_height, 100.0))
    frequency_loss = 20.0 * log10(40.0 * math.pi * frequency / 3.0)
    return -17.5 + slope * log10(distance) + frequency_loss


@elementwise
def umi_av_los_probability(ground_distance: float, drone_height: float) -> float:
    """Return the line-of-sight probability of UMi-AV; TR 38.901 up to 22.5 m."""
    if drone_height <= LOWEST_AERIAL:
        return umi_los_probability(ground_distance)
    log_height = log10(drone_height)
    certain = max(294.05 * log_height - 432.94, CERTAIN_LOS_DISTANCE)
    return decaying_los_probability(ground_distance, certain, 233.98 * log_height - 0.95)


@elementwise
def uma_av_los_probability(ground_distance: float, drone_height: float) -> float:
    """Return the line-of-sight probability of UMa-AV.

    It is 1 for drones above 100 m, and that of TR 38.901 for drones up to 22.5 m.
    """
    if drone_height <= LOWEST_AERIAL:
        return uma_los_probability(ground_distance, drone_height)
    if drone_height > 100.0:
        return 1.0
    log_height = log10(drone_height)
    certain = max(460.0 * log_height - 700.0, CERTAIN_LOS_DISTANCE)
    return decaying_los_probability(ground_distance, certain, 4300.0 * log_height - 3800.0)


@elementwise
def shadowing(drone_height: float, low: float, high: float, decay: float, minimum: float) -> float:
    """Return the standard deviation of the shadowing, dB.

    Args:
        drone_height: Height of the drone, m.
        low: Standard deviation for drones up to 22.5 m, dB; all parameters as in `Shadowing`.
        high: Standard deviation above 22.5 m before the decay, dB.
        decay: Decay rate with height, 1/m.
        minimum: Minimum standard deviation above 22.5 m, dB.

    References:
        TR 38.901, table 7.4.1-1; TR 36.777, table B-3.
    """
    if drone_height <= LOWEST_AERIAL:
        return low
    return max(high * exp(-decay * drone_height), minimum)
