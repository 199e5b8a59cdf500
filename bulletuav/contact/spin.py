"""How a rigid body turns that nothing touches: its angular momentum stays, its spin does not."""

import math

import numpy as np

from bulletuav.functions import atan2
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    exponential,
    normalised,
    product,
    to_body,
    to_world,
)
from bulletuav.kernel import func
from bulletuav.vehicle.wrench import spin_parts

SMALL_TURN = 0.2
"""Angle by which a drone turns in one step of the midpoint rule, rad"""


@func
def rotation_between(before: Quat4, after: Quat4) -> Vec3:
    """Return the rotation from one attitude to another as axis times angle, the shorter way."""
    x, y, z, w = product(after, (-before[0], -before[1], -before[2], before[3]))
    sine = math.sqrt(x * x + y * y + z * z)
    if sine == 0.0:
        return 0.0, 0.0, 0.0
    scale = 2.0 * atan2(sine, abs(w)) / sine
    if w < 0.0:
        scale = -scale
    return scale * x, scale * y, scale * z


@func
def turned(
    rotation: Vec3,
    share: float,
    quaternion: Quat4,
) -> Quat4:
    """Return an attitude after a share of a rotation (axis times angle, world axes)."""
    part = (
        share * rotation[0],
        share * rotation[1],
        share * rotation[2],
    )
    return normalised(product(exponential(part), quaternion))


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
    parts = spin_parts(spin, rest, SMALL_TURN)
    part = rest / parts
    there = here
    for _ in range(parts):
        halfway = turned(spin_of(there, angular, row), 0.5 * part, there)
        spin = spin_of(halfway, angular, row)
        there = turned(spin, part, there)
    turn = (rest * spin[0], rest * spin[1], rest * spin[2])
    return there, turn if parts == 1 else rotation_between(here, there)
