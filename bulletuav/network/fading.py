"""Small-scale fading of a radio link due to multipath propagation.

Gains are independent in each coherence time.
"""

import numpy as np

from bulletuav.errors import numbers_of


def rician_gain(
    k: float | np.ndarray, rng: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Draw power gains |h|^2 of Rician fading, with mean 1.

    The channel is h = sqrt(K / (K + 1)) + CN(0, 1 / (K + 1)) (S. O. Rice, 1944).

    Args:
        k: Rician factor K, the ratio of direct to scattered power, linear. K = 0 is Rayleigh
            fading, with exponentially distributed gains. Any shape that broadcasts to `shape`.
        rng: Random generator.
        shape: Shape of the gains.

    Returns:
        Independent gains of that shape.

    Raises:
        ValueError: If K is not finite, is negative, or does not broadcast to `shape`.
    """
    factor = numbers_of("the Rician K is", k)
    if not (np.isfinite(factor) & (factor >= 0)).all():
        raise ValueError(f"the Rician K is {k!r}: finite numbers, at least 0 (not dB), are needed")
    try:
        factor = np.broadcast_to(factor, shape)
    except ValueError:
        raise ValueError(
            f"the Rician K has shape {factor.shape}: one that broadcasts to {shape} is needed"
        ) from None
    # The direct path adds to the in-phase component
    in_phase, quadrature = rng.standard_normal((2, *shape))
    direct = np.sqrt(2 * factor)
    gain: np.ndarray = ((direct + in_phase) ** 2 + quadrature**2) / (2 * (factor + 1))
    return gain
