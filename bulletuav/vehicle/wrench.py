"""The wrench (force and torque) on one drone, for all dynamics with six degrees of freedom."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Quat4, Quat4Like, Vec3, Vec3Like, axes, dot, minus, plus
from bulletuav.vehicle.aerodynamics import drag_torque, ground_wrench, thrust_and_drag
from bulletuav.vehicle.parameters import ParameterRow
from bulletuav.vehicle.rotors import Rotors

MAX_PART_ROTATION = 0.25
"""Maximum rotation angle of a body in one step of RK4, rad"""
MAX_PARTS = 64
"""Maximum number of parts of a step"""

Surroundings = tuple[Vec3, float, float, Vec3, Vec3]
"""Wind (m/s), height of the surface below (m), gravity (m/s^2), external force (N, world axes) and
external torque (N m, body axes)
"""


class Wrenches(NamedTuple):
    """Forces and torques on the drones of W worlds of N drones in a substep.

    Attributes:
        force: (W, N, 3) forces at the centres of mass, world axes, N.
        torque: (W, N, 3) torques, body axes, N m.
    """

    force: np.ndarray
    torque: np.ndarray


@func
def make_surroundings(
    wind: Vec3, surface: float, gravity: float, force: Vec3, torque: Vec3, wake: Quat4
) -> Surroundings:
    """Combine the external influences on a drone with its wake force and torque.

    Args:
        wind: Velocity of the air, m/s.
        surface: Height of the surface below, m.
        gravity: m/s^2, downwards.
        force: External force, world axes, N.
        torque: External torque, body axes, N m.
        wake: Downward force of wakes, N, and their torque, body axes, N m.
    """
    return (
        wind,
        surface,
        gravity,
        (force[0], force[1], force[2] - wake[0]),
        plus(torque, 1.0, (wake[1], wake[2], wake[3])),
    )


@func
def compute_wrench(
    quaternion: Quat4Like,
    velocity: Vec3Like,
    altitude: float,
    speed: np.ndarray,
    rotors: Rotors,
    around: Surroundings,
    lifted: int,
    row: ParameterRow,
) -> tuple[Vec3, Vec3]:
    """Compute force and torque on one drone.

    Args:
        quaternion: Attitude, body to world.
        velocity: Velocity, world axes, m/s.
        altitude: Height of the centre of mass in the world, m.
        speed: (R,) rotor speeds, rad/s.
        rotors: Result of `rotors.rotor_wrench` for these speeds.
        around: External influences on the drone.
        lifted: Result of `aerodynamics.num_lifted_rotors`.
        row: Constants of the drone.

    Returns:
        The force, world axes, N, and the torque, body axes, N m. Torques that depend on the body
        rates are part of `body_acceleration`.
    """
    wind, surface, gravity, push, twist = around
    thrust, torque, total_speed, _ = rotors
    # Thrust along the body's z axis, more near the surface.
    ahead, left, up = axes(quaternion)
    lean = (ahead[2], left[2], up[2])
    more, more_x, more_y = ground_wrench(altitude - surface, lean, speed, lifted, row)
    # Drag against the air, which moves with the wind.
    v = minus(velocity, wind)
    force = thrust_and_drag(v, up, thrust + more, total_speed, row)
    tipped = drag_torque((dot(ahead, v), dot(left, v), 0.0), total_speed, row)
    # Terms that all stages of a substep have in common are summed first.
    held = (push[0], push[1], push[2] - row.mass * gravity)
    turn = plus(torque, 1.0, twist)
    return plus(force, 1.0, held), (
        turn[0] + (more_x + tipped[0]),
        turn[1] + (more_y + tipped[1]),
        turn[2],
    )


@func
def damping_torque(rates: Vec3Like, total_speed: float, row: ParameterRow) -> Vec3:
    """Return the damping torque c w of spinning rotors on a rotating body, N m.

    Args:
        rates: Angular velocity w, body axes, rad/s.
        total_speed: Sum of the rotor speeds, rad/s.
        row: Constants of the drone.
    """
    return (
        row.damping[0] * total_speed * rates[0],
        row.damping[1] * total_speed * rates[1],
        row.damping[2] * total_speed * rates[2],
    )


@func
def body_acceleration(
    rates: Vec3Like, torque: Vec3Like, total_speed: float, momentum: float, row: ParameterRow
) -> Vec3:
    """Return the angular acceleration by Euler's equation, J^-1 (M - w x (J w + h) - c w).

    h is the angular momentum of the rotors. c w is the damping by rotors that move through the air
    as the body rotates; it grows with the rotor speeds.

    Args:
        rates: Angular velocity w, body axes, rad/s.
        torque: Torque M, body axes, N m.
        total_speed: Sum of the rotor speeds, rad/s.
        momentum: Angular momentum of the rotors about the body's z axis, N m s.
        row: Constants of the drone.

    Returns:
        The angular acceleration, body axes, rad/s^2.
    """
    jx = row.inertia[0]
    jy = row.inertia[1]
    jz = row.inertia[2]
    turned = damping_torque(rates, total_speed, row)
    # Terms of the rates are summed before the torque, which is known last.
    x = turned[0] + rates[1] * (momentum + (jz - jy) * rates[2])
    y = turned[1] + rates[0] * ((jx - jz) * rates[2] - momentum)
    z = turned[2] + (jy - jx) * rates[0] * rates[1]
    # With 1 / J, so that the compiler computes the divisions once for several calls.
    return (
        (torque[0] - x) * (1.0 / jx),
        (torque[1] - y) * (1.0 / jy),
        (torque[2] - z) * (1.0 / jz),
    )


@func
def free_rates(rates: Vec3, dt: float, row: ParameterRow) -> Vec3:
    """Return the body rates after a time of torque-free rotation, by RK4, rad/s."""
    parts = num_spin_steps(rates, dt, MAX_PART_ROTATION)
    step = dt / parts
    none = (0.0, 0.0, 0.0)
    for _ in range(parts):
        # At the start, twice in the middle, and at the end of the step
        k1 = body_acceleration(rates, none, 0.0, 0.0, row)
        k2 = body_acceleration(plus(rates, 0.5 * step, k1), none, 0.0, 0.0, row)
        k3 = body_acceleration(plus(rates, 0.5 * step, k2), none, 0.0, 0.0, row)
        k4 = body_acceleration(plus(rates, step, k3), none, 0.0, 0.0, row)
        slopes = (
            k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0],
            k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1],
            k1[2] + 2 * k2[2] + 2 * k3[2] + k4[2],
        )
        rates = plus(rates, step / 6.0, slopes)
    return rates


@func
def num_spin_steps(spin: Vec3Like, dt: float, small: float) -> int:
    """Return the number of parts of a step that resolve the precession, from 1 to MAX_PARTS.

    Args:
        spin: Angular velocity, any axes, rad/s.
        dt: Duration of the step, s.
        small: Maximum rotation angle of a body in a part, rad.
    """
    angle = math.sqrt(dot(spin, spin)) * dt
    # Also 1 for angles that are not finite, which are reported elsewhere
    if not small < angle < np.inf:
        return 1
    return int(min(float(MAX_PARTS), 1.0 + angle / small))
