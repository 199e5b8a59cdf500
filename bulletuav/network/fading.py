"""Small-scale fading: what reflections near the ends make of the power of a link, drawn anew for each coherence time."""

import numpy as np

from bulletuav.errors import numbers_of


def rician_gain(
    k: float | np.ndarray, rng: np.random.Generator, shape: tuple[int, ...]
) -> np.ndarray:
    """Power gains |h|^2 of the given shape, with mean 1: h = sqrt(K / (K + 1)) + CN(0, 1 / (K + 1)) (S. O. Rice, 1944).

    K, not in dB, is the power of the direct path over that of all others; 0 is Rayleigh fading, gains that are Exp(1). Any
    shape that broadcasts to `shape` does. Raises ValueError unless K is finite, at least 0, and of such a shape.
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
    in_phase, quadrature = rng.standard_normal((2, *shape))
    return ((np.sqrt(2 * factor) + in_phase) ** 2 + quadrature**2) / (2 * (factor + 1))
