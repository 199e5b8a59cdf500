"""Rotation of a free rigid body: angular momentum is constant, angular velocity is not.

Small rotations use Taylor series of the exponential map (F. S. Grassia, Practical parameterization
of rotations using the exponential map, 1998). They take a fifth of the time of sine and cosine.
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2
from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Quat4, Vec3, dot, exp_map, product, to_body, to_world
from bulletuav.vehicle.wrench import num_spin_steps

MAX_STEP_ANGLE = 0.2
"""Maximum rotation in one step of the midpoint rule, rad"""
MAX_SERIES_ANGLE = 1.0
"""Angle up to which the series are exact to the last digit, rad"""
NUM_TERMS = 8
"""Number of terms of the series, see `_evaluate_series`"""
HALF_SINE = tuple(
    (-1) ** k / (2 ** (2 * k + 1) * math.factorial(2 * k + 1)) for k in range(NUM_TERMS)
)
HALF_COSINE = tuple((-1) ** k / (2 ** (2 * k) * math.factorial(2 * k)) for k in range(NUM_TERMS))
"""Series of sin(a / 2) / a and cos(a / 2) in powers of a^2"""


@func
def _compute_relative_rotation(before: Quat4, after: Quat4) -> Quat4:
    """Return the rotation from one attitude to another, as a quaternion."""
    return product(after, (-before[0], -before[1], -before[2], before[3]))


@func
def bound_angle(before: Quat4, after: Quat4) -> float:
    """Return an upper bound of the angle between two attitudes, rad; tight for small angles."""
    x, y, z, w = _compute_relative_rotation(before, after)
    sine = math.sqrt(x * x + y * y + z * z)
    # Twice the tangent of half the angle, which is more than the angle
    return 2.0 * sine / abs(w) if sine < abs(w) else math.pi


@func
def compute_rotation_between(before: Quat4, after: Quat4) -> Vec3:
    """Return the shorter rotation from one attitude to another, as axis times angle."""
    x, y, z, w = _compute_relative_rotation(before, after)
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0.0, 0.0, 0.0
    scale = 2.0 * atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z


@func
def _evaluate_series(c: tuple[float, ...], x: float) -> float:
    """Return c[0] + c[1] x + ... + c[7] x^7, in pairs for instruction-level parallelism."""
    square = x * x
    low = (c[0] + c[1] * x) + square * (c[2] + c[3] * x)
    high = (c[4] + c[5] * x) + square * (c[6] + c[7] * x)
    return low + square * square * high


@func
def rotate_by_fraction(rotation: Vec3, fraction: float, quaternion: Quat4) -> Quat4:
    """Rotate an attitude by a fraction of a rotation (axis times angle, world axes).

    The norm of the quaternion is preserved up to rounding.
    """
    part = (fraction * rotation[0], fraction * rotation[1], fraction * rotation[2])
    square = dot(part, part)
    if square > MAX_SERIES_ANGLE * MAX_SERIES_ANGLE:
        return product(exp_map(part), quaternion)
    scale = _evaluate_series(HALF_SINE, square)
    turn = (
        scale * part[0],
        scale * part[1],
        scale * part[2],
        _evaluate_series(HALF_COSINE, square),
    )
    return product(turn, quaternion)


@func
def compute_angular_momentum(quaternion: Quat4, spin: Vec3, row: np.record) -> Vec3:
    """Return the angular momentum (N m s) of an angular velocity (rad/s), both in world axes."""
    p, q, r = to_body(quaternion, spin)
    inertia = row.inertia
    return to_world(quaternion, (inertia[0] * p, inertia[1] * q, inertia[2] * r))


@func
def compute_angular_velocity(quaternion: Quat4, angular: Vec3, row: np.record) -> Vec3:
    """Return the angular velocity (rad/s) of an angular momentum (N m s), both in world axes."""
    p, q, r = to_body(quaternion, angular)
    inertia = row.inertia
    return to_world(quaternion, (p / inertia[0], q / inertia[1], r / inertia[2]))


@func
def integrate_free_rotation(
    here: Quat4, spin: Vec3, duration: float, row: np.record
) -> tuple[Quat4, Vec3]:
    """Integrate a torque-free rotation; returns the attitude, and the rotation as axis times angle.

    Uses the midpoint rule: the angular velocity halfway, with constant angular momentum.
    """
    angular = compute_angular_momentum(here, spin, row)
    # Subdivide fast rotations, so that their energy is conserved
    parts = num_spin_steps(spin, duration, MAX_STEP_ANGLE)
    part = duration / parts
    there = here
    for _ in range(parts):
        halfway = rotate_by_fraction(
            compute_angular_velocity(there, angular, row), 0.5 * part, there
        )
        spin = compute_angular_velocity(halfway, angular, row)
        there = rotate_by_fraction(spin, part, there)
    turn = (duration * spin[0], duration * spin[1], duration * spin[2])
    return there, turn if parts == 1 else compute_rotation_between(here, there)
