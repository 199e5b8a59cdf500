"""The wrench on one drone (force and torque) that every six-degree-of-freedom dynamics shares."""

import math

import numpy as np

from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, axes, dot, minus, plus
from bulletuav.kernel import func
from bulletuav.vehicle.aerodynamics import ground_effect, rotor_drag
from bulletuav.vehicle.parameters import ParameterRow

SMALL_TURN = 0.25
"""Angle by which a body may turn in one step of RK4, rad"""
MOST_PARTS = 64
"""Most parts of a step"""

Around = tuple[Vec3, float, float, Vec3, Vec3]
"""Wind (m/s), height of the surface below (m), gravity (m/s^2), and what pushes from outside: a
force (N, world axes) and a torque (N m, body axes)"""


@func
def wrench(
    quaternion: Quat4Like,
    velocity: Vec3Like,
    altitude: float,
    rotors: tuple[float, Vec3, float],
    around: Around,
    downwash: float,
    row: ParameterRow,
) -> tuple[Vec3, Vec3]:
    """Return force and torque on one drone.

    Args:
        quaternion: Attitude, body to world.
        velocity: Velocity, world axes, m/s.
        altitude: Height of the centre of mass in the world, m.
        rotors: What `rotors.rotor_wrench` returns.
        around: What surrounds the drone.
        downwash: Downward force of the wakes of other drones, N.
        row: Constants of the drone.

    Returns:
        The force, world axes, N, and the torque, body axes, N m.
    """
    wind, surface, gravity, push, twist = around
    thrust, torque, total_speed = rotors
    # Thrust along the body's z axis, more near the surface.
    up = axes(quaternion)[2]
    thrust *= 1.0 + ground_effect(altitude - surface, up[2], row)
    # Drag against the air, which moves with the wind.
    drag = rotor_drag(quaternion, minus(velocity, wind), total_speed, row)
    force = (
        thrust * up[0] + drag[0],
        thrust * up[1] + drag[1],
        thrust * up[2] + drag[2] - downwash - row.mass * gravity,
    )
    return plus(force, 1.0, push), plus(torque, 1.0, twist)


@func
def body_acceleration(rates: Vec3Like, torque: Vec3Like, row: ParameterRow) -> Vec3:
    """Return the angular acceleration by Euler's equation, J^-1 (M - w x J w).

    Args:
        rates: Angular velocity w, body axes, rad/s.
        torque: Torque M, body axes, N m.
        row: Constants of the drone.

    Returns:
        The angular acceleration, body axes, rad/s^2.
    """
    jx = row.inertia[0]
    jy = row.inertia[1]
    jz = row.inertia[2]
    # Written with 1 / J, divisions that several calls for one drone share.
    return (
        (torque[0] - (jz - jy) * rates[1] * rates[2]) * (1.0 / jx),
        (torque[1] - (jx - jz) * rates[2] * rates[0]) * (1.0 / jy),
        (torque[2] - (jy - jx) * rates[0] * rates[1]) * (1.0 / jz),
    )


@func
def spin_parts(spin: Vec3Like, dt: float, small: float) -> int:
    """Return into how many parts a step is cut so that precession is followed, 1 to MOST_PARTS.

    Args:
        spin: Angular velocity, any axes, rad/s.
        dt: Duration of the step, s.
        small: Angle by which a body may turn in a part, rad.
    """
    angle = math.sqrt(dot(spin, spin)) * dt
    # Also 1 where it is not finite, which is told elsewhere
    if not small < angle < np.inf:
        return 1
    return int(min(float(MOST_PARTS), 1.0 + angle / small))
