"""How a rigid body turns that nothing touches: its angular momentum stays, its spin does not.

Small rotations are Taylor series of the exponential map: F. S. Grassia, Practical parameterization
of rotations using the exponential map, 1998. They take a fifth of the time of sine and cosine.
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2
from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    dot,
    exp_map,
    product,
    to_body,
    to_world,
)
from bulletuav.vehicle.wrench import num_spin_steps

SMALL_TURN = 0.2
"""Angle by which a drone turns in one step of the midpoint rule, rad"""
SERIES_TURN = 1.0
"""Angle up to which the series are exact to the last digit, rad"""
TERMS = 8
"""Terms of these series, see `_series`"""
HALF_SINE = tuple((-1) ** k / (2 ** (2 * k + 1) * math.factorial(2 * k + 1)) for k in range(TERMS))
HALF_COSINE = tuple((-1) ** k / (2 ** (2 * k) * math.factorial(2 * k)) for k in range(TERMS))
"""Series of sin(a / 2) / a and cos(a / 2) in powers of a^2"""


@func
def _change(before: Quat4, after: Quat4) -> Quat4:
    """Return the rotation from one attitude to another, as a quaternion."""
    return product(after, (-before[0], -before[1], -before[2], before[3]))


@func
def angle_at_most(before: Quat4, after: Quat4) -> float:
    """Return a bound of the angle from one attitude to another, rad; close where it is small."""
    x, y, z, w = _change(before, after)
    sine = math.sqrt(x * x + y * y + z * z)
    # Twice the tangent of half the angle, which is more than the angle
    return 2.0 * sine / abs(w) if sine < abs(w) else math.pi


@func
def rotation_between(before: Quat4, after: Quat4) -> Vec3:
    """Return the rotation from one attitude to another as axis times angle, the shorter way."""
    x, y, z, w = _change(before, after)
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0.0, 0.0, 0.0
    scale = 2.0 * atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z


@func
def _series(c: tuple[float, ...], x: float) -> float:
    """Return c[0] + c[1] x + ... + c[7] x^7, in pairs, so that few terms wait for others."""
    square = x * x
    low = (c[0] + c[1] * x) + square * (c[2] + c[3] * x)
    high = (c[4] + c[5] * x) + square * (c[6] + c[7] * x)
    return low + square * square * high


@func
def turned(
    rotation: Vec3,
    share: float,
    quaternion: Quat4,
) -> Quat4:
    """Return an attitude after a share of a rotation (axis times angle, world axes).

    Its length is that of the attitude before, but for rounding.
    """
    part = (
        share * rotation[0],
        share * rotation[1],
        share * rotation[2],
    )
    square = dot(part, part)
    if square > SERIES_TURN * SERIES_TURN:
        return product(exp_map(part), quaternion)
    scale = _series(HALF_SINE, square)
    turn = (scale * part[0], scale * part[1], scale * part[2], _series(HALF_COSINE, square))
    return product(turn, quaternion)


@func
def momentum(
    quaternion: Quat4,
    spin: Vec3,
    row: np.record,
) -> Vec3:
    """Return the angular momentum (N m s) of an angular velocity (rad/s), both in world axes."""
    p, q, r = to_body(quaternion, spin)
    inertia = row.inertia
    return to_world(quaternion, (inertia[0] * p, inertia[1] * q, inertia[2] * r))


@func
def spin_of(
    quaternion: Quat4,
    angular: Vec3,
    row: np.record,
) -> Vec3:
    """Return the angular velocity (rad/s) of an angular momentum (N m s), both in world axes."""
    p, q, r = to_body(quaternion, angular)
    inertia = row.inertia
    return to_world(quaternion, (p / inertia[0], q / inertia[1], r / inertia[2]))


@func
def spun(
    here: Quat4,
    spin: Vec3,
    rest: float,
    row: np.record,
) -> tuple[Quat4, Vec3]:
    """Return the attitude after a time without torque, and the rotation to it, axis times angle.

    The rotation takes the angular velocity halfway (midpoint rule), with the angular momentum held.
    """
    angular = momentum(here, spin, row)
    # Fast spins in parts, so that their energy stays
    parts = num_spin_steps(spin, rest, SMALL_TURN)
    part = rest / parts
    there = here
    for _ in range(parts):
        halfway = turned(spin_of(there, angular, row), 0.5 * part, there)
        spin = spin_of(halfway, angular, row)
        there = turned(spin, part, there)
    turn = (rest * spin[0], rest * spin[1], rest * spin[2])
    return there, turn if parts == 1 else rotation_between(here, there)
