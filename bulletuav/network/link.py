"""Basic quantities of a link budget: decibels, thermal noise and channel capacity.

All functions accept numbers or arrays that broadcast, and can be called from kernels.
"""

import math
from typing import overload

import numpy as np

from bulletuav.compiled.functions import exp, expm1, log, log1p, log10, power
from bulletuav.compiled.kernel import elementwise

BOLTZMANN = 1.380649e-23
"""Boltzmann constant, J/K, exact (SI, 2019)"""
TEMPERATURE = 290.0
"""Reference temperature of noise figures, K (IEEE)"""


@elementwise
def decibel(power_ratio: float) -> float:
    """Convert a power ratio to dB; -inf for 0."""
    # The logarithm of 0 would raise a warning
    return 10.0 * log10(power_ratio) if power_ratio != 0.0 else -math.inf


@elementwise
def ratio(level: float) -> float:
    """Convert a level in dB to a power ratio; 0 for -inf."""
    power_ratio: float = power(10.0, 0.1 * level)
    return power_ratio


@elementwise
def noise_power(bandwidth: float, noise_figure: float) -> float:
    """Return the thermal noise power k T B F of a receiver at 290 K, W (H. Nyquist, 1928).

    Args:
        bandwidth: Bandwidth B, Hz.
        noise_figure: Noise figure F of the receiver, dB.
    """
    noise_factor: float = power(10.0, 0.1 * noise_figure)
    return BOLTZMANN * TEMPERATURE * bandwidth * noise_factor


@overload
def capacity(bandwidth: float, sinr: float) -> float: ...
@overload
def capacity(bandwidth: float, sinr: np.ndarray) -> np.ndarray: ...
@elementwise
def capacity(bandwidth: float, sinr: float | np.ndarray) -> float | np.ndarray:
    """Return the Shannon capacity B log2(1 + SINR) of a link, bit/s (C. E. Shannon, 1948).

    Args:
        bandwidth: Bandwidth B, Hz.
        sinr: Signal to interference plus noise ratio, linear.
    """
    return bandwidth * log1p(sinr) / log(2.0)


@elementwise
def packet_error(snr: float, bits: float) -> float:
    """Return the probability that a packet has a bit error, with GFSK and without coding.

    The bit error rate is that of non-coherent binary FSK, exp(-SNR / 2) / 2, where the bit rate is
    the bandwidth; bit errors are independent.

    Args:
        snr: Signal to noise ratio, linear.
        bits: Size of the packet, bit.

    References:
        J. G. Proakis, M. Salehi, Digital Communications (2008), section 4.5.
    """
    bit_error = 0.5 * exp(-0.5 * snr)
    # Not -0.0
    return 0.0 - expm1(bits * log1p(-bit_error))
