"""Measures of conflict between two drones, from their offset and relative velocity.

The last axis of vectors has length 3; all other axes are broadcast. For all pairs of a swarm with
positions (..., N, 3) use `pair_offsets`. SI units.
"""

import cmath
import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.errors import former_names
from bulletuav.geometry.rotation import Vec3, point

_TILT = 0.5
"""Tilt of the contour's arms, rad: the sum converges below pi / 4, fastest near this value."""
_STRETCH = 1.5
"""Stretch of the contour, in widths of the saddle."""
_STEP = 0.16
"""First step along the contour, with an error of about 1e-8."""
_HALVINGS = 4
"""Maximum number of times the step is halved."""


def pair_offsets(position: np.ndarray) -> np.ndarray:
    """Return the offsets of all pairs of a swarm.

    Args:
        position: (..., N, 3) positions; or velocities, for relative velocities.

    Returns:
        (..., N, N, 3), of which [..., i, j, :] is the vector from drone i to drone j.
    """
    difference: np.ndarray = position[..., None, :, :] - position[..., :, None, :]
    return difference


def in_cylinder(offset: np.ndarray, horizontal: float, vertical: float) -> np.ndarray:
    """Check whether the horizontal and vertical separations are both below their limits.

    This is the definition of a conflict in air traffic.

    Args:
        offset: (..., 3) vector between the two drones, m.
        horizontal: Limit of the horizontal separation, m.
        vertical: Limit of the vertical separation, m.

    Returns:
        (...) bool.
    """
    near_in_plan = np.hypot(offset[..., 0], offset[..., 1]) < horizontal
    near_in_height = np.abs(offset[..., 2]) < vertical
    both: np.ndarray = near_in_plan & near_in_height
    return both


def closest_point_of_approach(
    offset: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the closest point of approach (CPA) of two drones that fly at constant velocity.

    Args:
        offset: (..., 3) position of the other drone relative to the first, m.
        velocity: (..., 3) velocity of the other drone relative to the first, m/s.

    Returns:
        The time to the CPA (...), s, 0 if the drones already diverge; and their distance at the CPA
        (...), m.
    """
    square = (velocity**2).sum(axis=-1)
    along = -(offset * velocity).sum(axis=-1)
    time = np.divide(along, square, out=np.zeros_like(along), where=square > 0)
    time = np.maximum(time, 0.0)
    return time, np.linalg.norm(offset + velocity * time[..., None], axis=-1)


def time_to_conflict(offset: np.ndarray, velocity: np.ndarray, d_safe: float) -> np.ndarray:
    """Compute the time until two drones at constant velocity are closer than `d_safe`.

    Args:
        offset: (..., 3) position of the other drone relative to the first, m.
        velocity: (..., 3) velocity of the other drone relative to the first, m/s.
        d_safe: Separation below which two drones are in conflict, m.

    Returns:
        The time to conflict (...), s: 0 if the distance is below `d_safe` already, inf if it never
        will be.
    """
    square = (velocity**2).sum(axis=-1)
    along = (offset * velocity).sum(axis=-1)
    outside = (offset**2).sum(axis=-1) - d_safe**2
    root = along**2 - square * outside
    meets = (along < 0) & (root > 0)
    # The smaller root of the quadratic equation, as outside / (-along + sqrt(root)), which does
    # not cancel at low relative speeds.
    denominator = -along + np.sqrt(np.maximum(root, 0.0))
    never = np.full(root.shape, np.inf)
    time = np.divide(outside, denominator, out=never, where=meets)
    return np.where(outside < 0, 0.0, time)


def conflict_probability(
    offset: np.ndarray, sigma: np.ndarray | float, d_safe: float
) -> np.ndarray:
    """Compute the probability that two drones are closer than `d_safe`, for an isotropic error.

    The error of the offset is normal, with the same standard deviation along each axis. The
    distance then has the noncentral chi distribution with 3 degrees of freedom, which has a closed
    form. The error of the result is 1e-14, or the effect of rounding the arguments to 1e-16.

    Args:
        offset: (..., 3) expected offset, m.
        sigma: (...) or one number for all, standard deviation of the error along each axis, m; its
            square is the sum of the variances of both positions.
        d_safe: Separation below which two drones are in conflict, m.

    Returns:
        The probability (...).

    Raises:
        ValueError: If `sigma` or `d_safe` is not positive and finite.
    """
    from scipy.special import exprel, ndtr  # which takes long to import

    _require_positive("sigma", sigma)
    _require_positive("d_safe", d_safe)
    # All lengths in standard deviations.
    radius = d_safe / np.asarray(sigma, dtype=float)
    distance = np.linalg.norm(offset, axis=-1) / sigma
    near = radius - distance
    far = radius + distance
    density = np.exp(-0.5 * near**2) / math.sqrt(2 * math.pi)
    # (density(near) - density(far)) / distance, without its 0 / 0.
    ring = 2 * radius * density * exprel(-2 * radius * distance)
    probability: np.ndarray = np.clip(ndtr(near) - ndtr(-far) - ring, 0.0, 1.0)
    return probability


def conflict_probability_of(
    offset: np.ndarray, covariance: np.ndarray, d_safe: float, tolerance: float = 1e-9
) -> np.ndarray:
    """Compute the probability that two drones are closer than `d_safe`, for any normal error.

    The Laplace transform of the squared distance's distribution is inverted along a hyperbola
    through its saddle point. The integrand is largest at the saddle, so nothing cancels or
    overflows. The error of the trapezoidal sum decreases exponentially with the number of terms.
    The step is halved until two sums agree to `tolerance`; the last sum is then much more accurate.
    This is an estimate of the error, not a proven bound.

    In double precision, rounding of the arguments adds an error of about 1e-15 times the ratio of
    the largest to the smallest variance if the axes are oblique, and of 1e-15 d_safe divided by the
    smallest sigma at the edge of the ball.

    Args:
        offset: (..., 3) expected offset, m.
        covariance: (..., 3, 3) covariance of the error of the offset, m^2.
        d_safe: Separation below which two drones are in conflict, m.
        tolerance: Maximum error of the result.

    Returns:
        The probability (...).

    Raises:
        ValueError: If a covariance is not finite, symmetric and positive definite; `d_safe` is not
            positive and finite; or the sums do not agree. They do not agree for a `tolerance` close
            to rounding errors, a sigma below 1e-8 of d_safe right at the edge, and an offset that
            is not finite.

    References:
        S. Rice (1980); J. Weideman and L. Trefethen (2007).
    """
    _require_positive("d_safe", d_safe)
    offset = np.asarray(offset, dtype=float)
    covariance = np.asarray(covariance, dtype=float)
    variance, axes = _principal_axes(covariance)
    # The offset along the principal axes, all lengths in d_safe.
    mean = np.einsum("...ji,...j->...i", axes, offset, order="C") / d_safe
    variance = np.array(np.broadcast_to(variance / d_safe**2, mean.shape), order="C")
    out = np.empty(mean.shape[:-1])
    _fill_ball_probability(mean.reshape(-1, 3), variance.reshape(-1, 3), tolerance, out.reshape(-1))
    lost = np.isnan(out)
    if lost.any():
        where = np.broadcast_to(offset, mean.shape)[lost][0].tolist()
        raise ValueError(
            f"no conflict probability to within {tolerance} at offset {where} m: "
            f"try a larger tolerance"
        )
    return out


def _principal_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the variances (..., 3) along the principal axes, and the axes.

    Raises:
        ValueError: If a matrix is not finite, symmetric and positive definite.
    """
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
    return variance, axes


def _require_positive(name: str, value: np.ndarray | float) -> None:
    """Raise ValueError unless lengths are positive and finite."""
    wrong = np.extract(~((np.asarray(value) > 0) & np.isfinite(value)), value)
    if wrong.size:
        raise ValueError(f"{name} is {wrong[0]} m: a positive, finite length is needed")


@kernel
def _fill_ball_probability(
    mean: np.ndarray, variance: np.ndarray, tolerance: float, out: np.ndarray
) -> None:
    """Fill `out` (M,) for means (M, 3) and variances (M, 3) along the principal axes."""
    for k in range(len(out)):
        square = (mean[k, 0] ** 2, mean[k, 1] ** 2, mean[k, 2] ** 2)
        out[k] = _ball_probability(square, point(variance, k), tolerance)


@func
def _ball_probability(square: Vec3, variance: Vec3, tolerance: float) -> float:
    """Return the probability of the unit ball under a normal distribution.

    The distribution is given by its squared means and variances along the principal axes. The
    result is NaN if no two sums agree.
    """
    saddle, width = _saddle(square, variance)
    total = 0.5 * abs(_term(0.0, saddle, width, square, variance))
    last = math.nan
    for halving in range(_HALVINGS + 1):
        step = _STEP * 0.5**halving
        # Add the terms that are new at this step: after the first time only the odd ones.
        k = 1
        while True:
            term = _term(k * step, saddle, width, square, variance)
            total += term.real
            # The remaining terms decrease double exponentially.
            if not abs(term) > 1e-3 * tolerance:
                break
            k += 1 if halving == 0 else 2
        if abs(step * total - last) <= tolerance:
            return min(max(step * total, 0.0), 1.0)
        last = step * total
    return math.nan


@func
def _saddle(square: Vec3, variance: Vec3) -> tuple[float, float]:
    """Return the minimum of the integrand on the positive axis, and the width of its peak there.

    The width is across the axis. Newton's method is applied to the derivative of the integrand's
    logarithm. It is concave, so steps from below never pass the root.
    """
    # Start at or below the root, where 1 / z and each square[i] shrink^2 are at most 1.
    z = 1.0
    for i in range(3):
        z = max(z, 0.5 * (math.sqrt(square[i]) - 1.0) / variance[i])
    while True:
        # Slope of the logarithm, and its curvature, term by term
        slope = 1.0 - 1.0 / z
        curvature = 1.0 / z**2
        for i in range(3):
            shrink = 1.0 / (1.0 + 2.0 * z * variance[i])
            slope -= shrink * (variance[i] + square[i] * shrink)
            curvature += 2.0 * variance[i] * shrink**2 * (variance[i] + 2.0 * square[i] * shrink)
        # A peak of this curvature falls off like a Gaussian of this width
        width = 1.0 / math.sqrt(curvature)
        step = -slope / curvature
        # If z is so large that rounding stops the iteration, the probability is 0.
        if not step > max(0.01 * width, 1e-9 * z):
            return z, width
        z += step


@func
def _term(t: float, saddle: float, width: float, square: Vec3, variance: Vec3) -> complex:
    """Return the integrand at z(t) on the hyperbola; its real part is summed.

    It is exp(z) E exp(-z Q) / z dz/dt / (pi i), where Q is the squared distance.
    """
    # The point z(t) of the contour.
    stretch = _STRETCH * width
    turn = cmath.exp(complex(t, _TILT))
    z = saddle + stretch * (math.sin(_TILT) + 0.5j * (turn - 1.0 / turn))
    # The Laplace transform there, axis by axis.
    root = complex(math.pi * z)
    exponent = 1.0 + 0.0j
    for i in range(3):
        spread = 1.0 + 2.0 * z * variance[i]
        root *= cmath.sqrt(spread)
        exponent -= square[i] / spread
    return cmath.exp(z * exponent) / root * stretch * 0.5 * (turn + 1.0 / turn)


__getattr__ = former_names(__name__, {"offsets": "pair_offsets"})
