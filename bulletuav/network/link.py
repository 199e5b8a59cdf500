"""What a radio link carries: noise, decibels, capacity."""

import math

from bulletuav.kernel import elementwise

BOLTZMANN = 1.380649e-23  # J/K, exact (SI, 2019)
TEMPERATURE = 290.0  # K, the reference of noise figures (IEEE)


@elementwise
def decibel(ratio):
    """A ratio of powers in dB; -inf for 0."""
    return 10.0 * math.log10(ratio) if ratio != 0.0 else -math.inf  # log10(0) would warn


@elementwise
def ratio(decibel):
    """The ratio of powers that is so many dB; 0 for -inf."""
    return 10.0 ** (0.1 * decibel)


@elementwise
def noise_power(bandwidth, noise_figure):
    """Thermal noise of a receiver at 290 K, W: k T B F, `bandwidth` in Hz, `noise_figure` in dB (H. Nyquist, 1928)."""
    return BOLTZMANN * TEMPERATURE * bandwidth * 10.0 ** (0.1 * noise_figure)


@elementwise
def capacity(bandwidth, sinr):
    """Most that a link can carry, bit/s: B log2(1 + SINR), `bandwidth` in Hz, `sinr` not in dB (C. E. Shannon, 1948)."""
    return bandwidth * math.log1p(sinr) / math.log(2.0)
