"""Measures of conflict between two drones, from their offset and relative velocity; all pairs of a swarm in one call.

Arrays end in 3 and broadcast: for all pairs of positions (..., N, 3) use `offsets`. SI units.
"""

import cmath
import math

import numpy as np
from scipy.special import exprel, ndtr

from bulletuav.kernel import func, kernel

_TILT = 0.5  # rad, of the contour's arms: converges below pi / 4, fastest about here
_STRETCH = 1.5  # of the contour, in widths of the saddle
_STEP = 0.16  # the first, good for about 1e-8
_HALVINGS = 4


def offsets(position: np.ndarray) -> np.ndarray:
    """(..., N, N, 3) from drone i to drone j of (..., N, 3)."""
    return position[..., None, :, :] - position[..., :, None, :]


def in_cylinder(offset: np.ndarray, horizontal: float, vertical: float) -> np.ndarray:
    """Whether both the horizontal and the vertical separation are below their limits (m), as air traffic counts it."""
    return (np.hypot(offset[..., 0], offset[..., 1]) < horizontal) & (
        np.abs(offset[..., 2]) < vertical
    )


def closest_point_of_approach(
    offset: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Time (s, 0 when they part already) and distance (m) of the closest approach, both flying straight on.

    offset, velocity (..., 3): of the other relative to the one, m, m/s.
    """
    square = (velocity**2).sum(axis=-1)
    along = -(offset * velocity).sum(axis=-1)
    time = np.maximum(np.divide(along, square, out=np.zeros_like(along), where=square > 0), 0.0)
    return time, np.linalg.norm(offset + velocity * time[..., None], axis=-1)


def time_to_conflict(offset: np.ndarray, velocity: np.ndarray, d_safe: float) -> np.ndarray:
    """Seconds until the distance of two that fly straight on falls below `d_safe` (m): 0 inside already, inf when never."""
    square = (velocity**2).sum(axis=-1)
    along = (offset * velocity).sum(axis=-1)
    outside = (offset**2).sum(axis=-1) - d_safe**2
    root = along**2 - square * outside
    meets = (along < 0) & (root > 0)
    # The smaller root, as outside / (-along + sqrt(root)): it does not cancel where the two pass slowly.
    time = np.divide(
        outside,
        -along + np.sqrt(np.maximum(root, 0.0)),
        out=np.full(root.shape, np.inf),
        where=meets,
    )
    return np.where(outside < 0, 0.0, time)


def conflict_probability(
    offset: np.ndarray, sigma: np.ndarray | float, d_safe: float
) -> np.ndarray:
    """Probability that two are closer than `d_safe` (m) whose offset is known with an error of `sigma` (m) on each axis.

    offset (..., 3), m; sigma^2, of shape (...) or one for all, is the sum of both variances. The noncentral chi distribution
    with 3 degrees of freedom, which has a closed form; to 1e-14, or what the rounding of the arguments to 1e-16 makes of it.
    Raises ValueError for a `sigma` or `d_safe` that is not positive and finite.
    """
    _refuse_unless_positive("sigma", sigma)
    _refuse_unless_positive("d_safe", d_safe)
    radius, distance = (
        d_safe / np.asarray(sigma, dtype=float),
        np.linalg.norm(offset, axis=-1) / sigma,
    )
    near, far = radius - distance, radius + distance
    density = np.exp(-0.5 * near**2) / math.sqrt(2 * math.pi)
    # (density(near) - density(far)) / distance without its 0 / 0
    ring = 2 * radius * density * exprel(-2 * radius * distance)
    return np.clip(ndtr(near) - ndtr(-far) - ring, 0.0, 1.0)


def conflict_probability_of(
    offset: np.ndarray, covariance: np.ndarray, d_safe: float, tolerance: float = 1e-9
) -> np.ndarray:
    """As `conflict_probability`, to within `tolerance`, for an error of any covariance (..., 3, 3), m^2: (...).

    The Laplace transform of the squared distance's distribution is inverted along a hyperbola through its saddle point (S.
    Rice 1980; J. Weideman and L. Trefethen 2007). The integrand is largest at the saddle, so nothing cancels or overflows,
    and the error of the trapezoidal sum falls exponentially with the number of terms: the step is halved until two sums
    agree to `tolerance`, when the last is far closer than that. This is an estimate of the error, not a proven bound.
    Double precision adds what the rounding of the arguments does: about 1e-15 times the ratio of the largest variance to the
    smallest, where the axes are oblique, and 1e-15 d_safe over the smallest sigma, at the edge of the ball.

    Raises ValueError for a covariance that is not finite, symmetric and positive definite, for a `d_safe` that is not
    positive and finite, and where the sums do not agree: a `tolerance` close to rounding, a sigma below 1e-8 of d_safe right
    at the edge, an offset that is not finite.
    """
    _refuse_unless_positive("d_safe", d_safe)
    offset, covariance = np.asarray(offset, dtype=float), np.asarray(covariance, dtype=float)
    finite = np.isfinite(covariance).all(axis=(-1, -2))
    if not finite.all():
        raise ValueError(f"covariance {covariance[~finite][0].tolist()} m^2 is not finite")
    variance, axes = np.linalg.eigh(covariance)
    skew = np.abs(covariance - covariance.swapaxes(-1, -2)).max(axis=(-1, -2))
    good = (variance[..., 0] > 0) & (skew <= 1e-9 * variance[..., 2])
    if not good.all():
        raise ValueError(
            f"covariance {covariance[~good][0].tolist()} m^2 is not symmetric positive definite"
        )
    mean = np.einsum("...ji,...j->...i", axes, offset, order="C") / d_safe
    variance = np.array(np.broadcast_to(variance / d_safe**2, mean.shape), order="C")
    out = np.empty(mean.shape[:-1])
    _fill_ball_probability(mean.reshape(-1, 3), variance.reshape(-1, 3), tolerance, out.reshape(-1))
    lost = np.isnan(out)
    if lost.any():
        where = np.broadcast_to(offset, mean.shape)[lost][0].tolist()
        raise ValueError(
            f"no conflict probability to within {tolerance} at offset {where} m: try a larger tolerance"
        )
    return out


def _refuse_unless_positive(name: str, value: np.ndarray | float) -> None:
    wrong = np.extract(~((np.asarray(value) > 0) & np.isfinite(value)), value)
    if wrong.size:
        raise ValueError(f"{name} is {wrong[0]} m: a positive, finite length is needed")


@kernel
def _fill_ball_probability(mean, variance, tolerance, out):
    for k in range(len(out)):
        square = (mean[k, 0] ** 2, mean[k, 1] ** 2, mean[k, 2] ** 2)
        out[k] = _ball_probability(
            square, (variance[k, 0], variance[k, 1], variance[k, 2]), tolerance
        )


@func
def _ball_probability(square, variance, tolerance):
    """That of the unit ball under the normal distribution with these squared means and variances; NaN if no sums agree."""
    saddle, width = _saddle(square, variance)
    total, last = 0.5 * abs(_term(0.0, saddle, width, square, variance)), math.nan
    for halving in range(_HALVINGS + 1):
        step = _STEP * 0.5**halving
        k = 1
        while True:
            term = _term(k * step, saddle, width, square, variance)
            total += term.real
            if not abs(term) > 1e-3 * tolerance:  # the rest falls double exponentially
                break
            k += 1 if halving == 0 else 2  # the even ones are in the total already
        if abs(step * total - last) <= tolerance:
            return min(max(step * total, 0.0), 1.0)
        last = step * total
    return math.nan


@func
def _saddle(square, variance):
    """Where on the positive axis the integrand is least, and how wide its peak is across the axis there.

    Newton's method on the slope of its logarithm: the slope is concave, so steps from below never pass the root.
    """
    z = 1.0
    for i in range(3):
        z = max(z, 0.5 * (math.sqrt(square[i]) - 1.0) / variance[i])
    while True:
        slope, curvature = 1.0 - 1.0 / z, 1.0 / z**2
        for i in range(3):
            shrink = 1.0 / (1.0 + 2.0 * z * variance[i])
            slope -= shrink * (variance[i] + square[i] * shrink)
            curvature += 2.0 * variance[i] * shrink**2 * (variance[i] + 2.0 * square[i] * shrink)
        width = 1.0 / math.sqrt(curvature)
        step = -slope / curvature
        if not step > max(
            0.01 * width, 1e-9 * z
        ):  # z so far out that rounding stops it belongs to a probability of 0
            return z, width
        z += step


@func
def _term(t, saddle, width, square, variance):
    """exp(z) E exp(-z Q) / z dz/dt / (pi i) at z(t) on the hyperbola, Q the squared distance: its real part counts."""
    stretch = _STRETCH * width
    turn = cmath.exp(complex(t, _TILT))
    z = saddle + stretch * (math.sin(_TILT) + 0.5j * (turn - 1.0 / turn))
    root = complex(math.pi * z)
    exponent = 1.0 + 0.0j
    for i in range(3):
        spread = 1.0 + 2.0 * z * variance[i]
        root *= cmath.sqrt(spread)
        exponent -= square[i] / spread
    return cmath.exp(z * exponent) / root * stretch * 0.5 * (turn + 1.0 / turn)
