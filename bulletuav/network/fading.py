"""Small-scale fading of a radio link, which reflections near its ends cause.

It is drawn anew for each coherence time.
"""

import numpy as np

from bulletuav.errors import numbers_of


def rician_gain(
    k: float | np.ndarray, rng: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Draw power gains |h|^2 of Rician fading, with mean 1.

    The channel is h = sqrt(K / (K + 1)) + CN(0, 1 / (K + 1)) (S. O. Rice, 1944).

    Args:
        k: Rician factor K: power of the direct path over that of all others, not in dB. 0 gives
            Rayleigh fading, with gains that are Exp(1). Any shape that broadcasts to `shape`.
        rng: Generator to draw from.
        shape: Shape of the gains.

    Returns:
        Independent gains of that shape.

    Raises:
        ValueError: K is not finite, below 0, or of a shape that does not broadcast.
    """
    factor = numbers_of("the Rician K is", k)
    if not (np.isfinite(factor) & (factor >= 0)).all():
        raise ValueError(f"the Rician K is {k!r}: finite numbers, at least 0 (not dB), are needed")
    # One factor for each gain
    try:
        factor = np.broadcast_to(factor, shape)
    except ValueError:
        raise ValueError(
            f"the Rician K has shape {factor.shape}: one that broadcasts to {shape} is needed"
        ) from None
    # The direct path adds to one of the two components
    in_phase, quadrature = rng.standard_normal((2, *shape))
    direct = np.sqrt(2 * factor)
    gain: np.ndarray = ((direct + in_phase) ** 2 + quadrature**2) / (2 * (factor + 1))
    return gain
