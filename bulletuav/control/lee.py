"""Geometric tracking control of one drone on SE(3), one function for each step of the cascade.

Source: T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3),
CDC 2010. Here z is up, and gains come from frequencies w and the damping ratio z:
k_x = m w^2, k_v = 2 z m w, k_R = J w_R^2, k_W = 2 z J w_R.

Each step is a proportional law, and their composition is the published one:
m w^2 e_x + 2 z m w e_v = 2 z m w (e_v + w / (2 z) e_x), and likewise for attitude.

In all functions `row` is the drone's row of the nominal `PARAMETERS`, and `gain` that of `GAINS`.
Names in capitals, as in "POSITION to VELOCITY", are those of `SetpointLevel`.
"""

import math

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import is_any, where
from bulletuav.control.gains import GainRow
from bulletuav.geometry.rotation import (
    Quat4Like,
    Vec3,
    Vec3Like,
    axes,
    cross,
    dot,
    plus,
    to_body,
)
from bulletuav.vehicle.aerodynamics import force_of_air, torque_of_drag
from bulletuav.vehicle.wrench import damping_torque


@func
def velocity_setpoint(position: Vec3Like, target: Vec3Like, gain: GainRow) -> Vec3:
    """Step from POSITION to VELOCITY: fly towards the target, slowly enough to brake.

    Args:
        position: Position of the drone, m, world.
        target: Position to fly to, m, world.
        gain: Row of `GAINS`. Braking takes `max_deceleration`.

    Returns:
        Velocity to fly at, m/s, world; no faster than `max_speed`.
    """
    error = (target[0] - position[0], target[1] - position[1], target[2] - position[2])
    distance = math.sqrt(dot(error, error))
    rate = gain.position_frequency / (2.0 * gain.damping)
    # Closer than this, the proportional law brakes gently enough.
    linear = gain.max_deceleration / (rate * rate)
    far = distance > linear
    fast = rate * distance > gain.max_speed
    if is_any(fast):
        rate = where(fast, gain.max_speed / distance, rate)
    if is_any(far):
        speed = math.sqrt(2.0 * gain.max_deceleration * (distance - 0.5 * linear))
        rate = where(far, min(speed, gain.max_speed) / distance, rate)
    return rate * error[0], rate * error[1], rate * error[2]


@func
def acceleration_setpoint(velocity: Vec3Like, target: Vec3Like, gain: GainRow) -> Vec3:
    """Step from VELOCITY to ACCELERATION.

    Args:
        velocity: Velocity of the drone, m/s, world.
        target: Velocity to fly at, m/s, world.
        gain: Row of `GAINS`.

    Returns:
        Acceleration, m/s^2, world.
    """
    # 2 z w, the rate at which an error of velocity decays
    rate = 2.0 * gain.damping * gain.position_frequency
    return (
        rate * (target[0] - velocity[0]),
        rate * (target[1] - velocity[1]),
        rate * (target[2] - velocity[2]),
    )


@func
def force_setpoint(
    acceleration: Vec3Like,
    quaternion: Quat4Like,
    velocity: Vec3Like,
    total_speed: float,
    gravity: float,
    row: np.record,
    gain: GainRow,
) -> Vec3:
    """Step from ACCELERATION to the force wanted from the rotors.

    The force carries weight, acceleration, and drag in still air. Its upward part stays between
    0.3 weights and 0.9 of the thrust. Height comes before sideways, and the tilt is `max_tilt` at
    most.

    Args:
        acceleration: Acceleration wanted, m/s^2, world.
        quaternion: Attitude of the drone, body to world.
        velocity: Velocity at which drag is compensated, m/s, world.
        total_speed: Sum of the rotors' speeds, rad/s.
        gravity: Gravitational acceleration, m/s^2.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Force, N, world.
    """
    slowed = force_of_air(velocity, axes(quaternion)[2], 0.0, total_speed, row)
    x = row.mass * acceleration[0] - slowed[0]
    y = row.mass * acceleration[1] - slowed[1]
    z = row.mass * (acceleration[2] + gravity) - slowed[2]

    # Height first: what is left of the thrust, within the tilt, goes sideways.
    most = 0.9 * gain.max_thrust
    z = min(max(z, 0.3 * row.mass * gravity), most)
    sideways = math.sqrt(x * x + y * y)
    limit = min(gain.max_tilt * z, math.sqrt(most * most - z * z))
    over = sideways > limit
    if is_any(over):
        share = where(over, limit / sideways, 1.0)
        x *= share
        y *= share
    return x, y, z


@func
def torque_of_drag_ahead(
    quaternion: Quat4Like,
    velocity: Vec3Like,
    rates: Vec3Like,
    acceleration: Vec3Like,
    total_speed: float,
    row: np.record,
) -> Vec3:
    """Compute the torque of the rotors' drag in still air, as it will be when rotors have answered.

    They answer to a command with their lag. So the velocity along the body's axes is taken that
    much ahead: v + lag (R^T a - W x v).

    Args:
        quaternion: Attitude R of the drone, body to world.
        velocity: Its velocity, m/s, world.
        rates: Its body rates W, rad/s.
        acceleration: Its acceleration a, m/s^2, world.
        total_speed: Sum of the rotors' speeds, rad/s.
        row: Row of `PARAMETERS`.

    Returns:
        Torque, N m, body axes.
    """
    along = to_body(quaternion, velocity)
    change = plus(to_body(quaternion, acceleration), -1.0, cross(rates, along))
    ahead = plus(along, max(row.lag_up, row.lag_down), change)
    return torque_of_drag(ahead, total_speed, row)


@func
def nose(yaw: float) -> Vec3:
    """Compute the horizontal unit vector of a nose that points towards `yaw` (rad)."""
    # Most flights hold 0, which needs no sine.
    if yaw == 0.0:
        return 1.0, 0.0, 0.0
    # The horizontal part of the body's x axis
    return cos(yaw), sin(yaw), 0.0


@func
def desired_axes(force: Vec3Like, yaw: float) -> tuple[Vec3, Vec3, Vec3]:
    """Compute the attitude that points thrust along a force and the nose towards a yaw (rad)."""
    return axes_along(force, nose(yaw))


@func
def axes_along(force: Vec3Like, ahead: Vec3Like) -> tuple[Vec3, Vec3, Vec3]:
    """Compute the attitude that points thrust along a force and the nose ahead.

    Args:
        force: Force wanted, N, world.
        ahead: Horizontal unit vector.

    Returns:
        Body axes x, y, z in the world: the columns of the rotation matrix Rc.
    """
    # Thrust acts along body z
    size = math.sqrt(dot(force, force))
    b3 = (force[0] / size, force[1] / size, force[2] / size)
    # Body y is level towards the yaw, across z and the nose
    side = cross(b3, ahead)
    size = math.sqrt(dot(side, side))
    b2 = (side[0] / size, side[1] / size, side[2] / size)
    return cross(b2, b3), b2, b3


@func
def attitude_error(quaternion: Quat4Like, desired: tuple[Vec3, Vec3, Vec3]) -> Vec3:
    """Compute vee(Rc^T R - R^T Rc), twice Lee's attitude error.

    Args:
        quaternion: Attitude R of the drone, body to world.
        desired: Columns of the attitude wanted, Rc.

    Returns:
        Error about the body axes, without unit.
    """
    # The matrix is skew: three of its entries tell it
    b1, b2, b3 = axes(quaternion)
    c1, c2, c3 = desired
    return dot(c3, b2) - dot(b3, c2), dot(c1, b3) - dot(b1, c3), dot(c2, b1) - dot(b2, c1)


@func
def rates_setpoint(quaternion: Quat4Like, desired: tuple[Vec3, Vec3, Vec3], gain: GainRow) -> Vec3:
    """Step from ATTITUDE to RATES: -(w_R / 2z) e_R with e_R = vee(Rc^T R - R^T Rc) / 2.

    Args:
        quaternion: Attitude R of the drone, body to world.
        desired: Columns of the attitude wanted, Rc.
        gain: Row of `GAINS`.

    Returns:
        Body rates, rad/s.
    """
    # Lee's e_R has a factor 1 / 2, which the scale holds with that of the formula
    error = attitude_error(quaternion, desired)
    scale = -0.25 / gain.damping
    frequency = gain.attitude_frequency
    return (
        scale * frequency[0] * error[0],
        scale * frequency[1] * error[1],
        scale * frequency[2] * error[2],
    )


@func
def torque_setpoint(
    rates: Vec3Like, target: Vec3Like, total_speed: float, row: np.record, gain: GainRow
) -> Vec3:
    """Step from RATES to a body torque: -k_W (W - W_target) + W x J W + c W_target.

    The last term, which is not in the source, carries the damping c by the rotors: without it rates
    that are held would stay below the target.

    Args:
        rates: Body rates W of the drone, rad/s.
        target: Body rates wanted, rad/s.
        total_speed: Sum of the rotors' speeds, rad/s.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Torque, N m, body axes.
    """
    # Gyroscopic torque W x J W, and the rotors' damping at the rates wanted
    momentum = (row.inertia[0] * rates[0], row.inertia[1] * rates[1], row.inertia[2] * rates[2])
    carried = plus(cross(rates, momentum), 1.0, damping_torque(target, total_speed, row))
    # Proportional part: k_W = 2 z w_R J on each axis
    twice = 2.0 * gain.damping
    frequency = gain.attitude_frequency
    return (
        carried[0] - twice * row.inertia[0] * frequency[0] * (rates[0] - target[0]),
        carried[1] - twice * row.inertia[1] * frequency[1] * (rates[1] - target[1]),
        carried[2] - twice * row.inertia[2] * frequency[2] * (rates[2] - target[2]),
    )


@func
def mix(
    thrust: float, torque: Vec3Like, row: np.record, gain: GainRow, command: np.ndarray
) -> None:
    """Share collective thrust and torques out among the rotors, within what each can do.

    Roll and pitch come first: thrust above half of the greatest gives way to them. Yaw needs the
    most of the rotors and matters least. It gets what the others leave.

    Args:
        thrust: Collective thrust, N.
        torque: Torque about the body axes, N m.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s, which is written.
    """
    # Greatest thrust of one rotor, N
    most = row.thrust_coefficient * row.max_rotor_speed * row.max_rotor_speed
    # Thrust at which roll and pitch still fit.
    for r in range(row.num_rotors):
        turn = gain.mixer[r, 1] * torque[0] + gain.mixer[r, 2] * torque[1]
        over = gain.mixer[r, 0] * thrust + turn > most
        if is_any(over):
            less = max(most - turn, 0.5 * most) / gain.mixer[r, 0]
            thrust = where(over, min(thrust, less), thrust)
    # Thrust of each rotor without yaw, and the largest share of yaw that all rotors can add.
    share = 1.0
    for r in range(row.num_rotors):
        lift = (
            gain.mixer[r, 0] * thrust + gain.mixer[r, 1] * torque[0] + gain.mixer[r, 2] * torque[1]
        )
        # A rotor cannot push down
        level = min(max(lift, 0.0), most)
        command[r] = level
        turn = gain.mixer[r, 3] * torque[2]
        over = level + turn > most
        under = level + turn < 0.0
        if is_any(over):
            share = where(over, min(share, (most - level) / turn), share)
        if is_any(under):
            share = where(under, min(share, -level / turn), share)

    # With that share of yaw, from thrust to speed; rounding may leave the thrust just below zero.
    for r in range(row.num_rotors):
        lift = max(command[r] + share * gain.mixer[r, 3] * torque[2], 0.0)
        command[r] = math.sqrt(lift / row.thrust_coefficient)
