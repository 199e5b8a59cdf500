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
from bulletuav.vehicle.aerodynamics import drag_torque, thrust_and_drag
from bulletuav.vehicle.wrench import damping_torque


@func
def velocity_setpoint(position: Vec3Like, target: Vec3Like, gain: GainRow) -> Vec3:
    """Step from POSITION to VELOCITY: fly towards the target, slowly enough to stop there.

    Args:
        position: Position of the drone, m, world.
        target: Position to fly to, m, world.
        gain: Row of `GAINS`. The drone brakes with `max_deceleration`.

    Returns:
        Velocity setpoint, m/s, world; its norm is at most `max_speed`.
    """
    error = (target[0] - position[0], target[1] - position[1], target[2] - position[2])
    distance = math.sqrt(dot(error, error))
    rate = gain.position_frequency / (2.0 * gain.damping)
    # At smaller distances, the deceleration of the proportional law is below the limit.
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
    # 2 z w, the rate at which a velocity error decays
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
    """Step from ACCELERATION to the desired force of the rotors.

    The force compensates weight and drag in still air, and accelerates the drone. Its upward part
    is limited to between 0.3 of the weight and 0.9 of the maximum thrust. The horizontal part is
    limited to the remaining thrust and to `max_tilt`.

    Args:
        acceleration: Desired acceleration, m/s^2, world.
        quaternion: Attitude of the drone, body to world.
        velocity: Velocity at which drag is compensated, m/s, world.
        total_speed: Sum of the rotors' speeds, rad/s.
        gravity: Gravitational acceleration, m/s^2.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Force, N, world.
    """
    slowed = thrust_and_drag(velocity, axes(quaternion)[2], 0.0, total_speed, row)
    x = row.mass * acceleration[0] - slowed[0]
    y = row.mass * acceleration[1] - slowed[1]
    z = row.mass * (acceleration[2] + gravity) - slowed[2]

    # Height has priority: the horizontal force is limited to the remaining thrust, and by the tilt.
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
    """Predict the torque of the rotors' drag in still air after the rotors' lag.

    The velocity along the body axes is extrapolated by the lag: v + lag (R^T a - W x v).

    Args:
        quaternion: Attitude R of the drone, body to world.
        velocity: Velocity of the drone, m/s, world.
        rates: Body rates W of the drone, rad/s.
        acceleration: Acceleration a of the drone, m/s^2, world.
        total_speed: Sum of the rotors' speeds, rad/s.
        row: Row of `PARAMETERS`.

    Returns:
        Torque, N m, body axes.
    """
    along = to_body(quaternion, velocity)
    change = plus(to_body(quaternion, acceleration), -1.0, cross(rates, along))
    ahead = plus(along, max(row.lag_up, row.lag_down), change)
    return drag_torque(ahead, total_speed, row)


@func
def nose(yaw: float) -> Vec3:
    """Return the horizontal unit vector in the direction of `yaw` (rad)."""
    # Most flights hold a yaw of 0, which needs no sine.
    if yaw == 0.0:
        return 1.0, 0.0, 0.0
    return cos(yaw), sin(yaw), 0.0


@func
def desired_axes(force: Vec3Like, yaw: float) -> tuple[Vec3, Vec3, Vec3]:
    """Compute the attitude with thrust along a force and the nose towards a yaw (rad)."""
    return axes_along(force, nose(yaw))


@func
def axes_along(force: Vec3Like, ahead: Vec3Like) -> tuple[Vec3, Vec3, Vec3]:
    """Compute the attitude with thrust along a force and the nose towards a direction.

    Args:
        force: Desired force, N, world.
        ahead: Horizontal unit vector of the nose's direction.

    Returns:
        Body axes x, y, z in the world: the columns of the rotation matrix Rc.
    """
    size = math.sqrt(dot(force, force))
    b3 = (force[0] / size, force[1] / size, force[2] / size)
    # Body y is horizontal, normal to the thrust and to the direction of the nose
    side = cross(b3, ahead)
    size = math.sqrt(dot(side, side))
    b2 = (side[0] / size, side[1] / size, side[2] / size)
    return cross(b2, b3), b2, b3


@func
def attitude_error(quaternion: Quat4Like, desired: tuple[Vec3, Vec3, Vec3]) -> Vec3:
    """Compute vee(Rc^T R - R^T Rc), twice Lee's attitude error.

    Args:
        quaternion: Attitude R of the drone, body to world.
        desired: Columns of the desired attitude Rc.

    Returns:
        Error about the body axes, dimensionless.
    """
    # A skew-symmetric matrix has three independent entries
    b1, b2, b3 = axes(quaternion)
    c1, c2, c3 = desired
    return dot(c3, b2) - dot(b3, c2), dot(c1, b3) - dot(b1, c3), dot(c2, b1) - dot(b2, c1)


@func
def rates_setpoint(quaternion: Quat4Like, desired: tuple[Vec3, Vec3, Vec3], gain: GainRow) -> Vec3:
    """Step from ATTITUDE to RATES: -(w_R / 2z) e_R with e_R = vee(Rc^T R - R^T Rc) / 2.

    Args:
        quaternion: Attitude R of the drone, body to world.
        desired: Columns of the desired attitude Rc.
        gain: Row of `GAINS`.

    Returns:
        Body rates, rad/s.
    """
    # The scale includes the factor 1 / 2 of e_R
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

    The last term, which is not in the source, compensates the damping c of the rotors. Without it
    steady rates would stay below the target.

    Args:
        rates: Body rates W of the drone, rad/s.
        target: Desired body rates, rad/s.
        total_speed: Sum of the rotors' speeds, rad/s.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.

    Returns:
        Torque, N m, body axes.
    """
    # Gyroscopic torque W x J W, and the rotors' damping at the desired rates
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
    """Allocate collective thrust and torques to the rotors, within the limits of each rotor.

    Roll and pitch have priority over thrust above half of the maximum. Yaw has the lowest priority,
    as it matters least and takes most of the rotors' range: it gets the remaining range.

    Args:
        thrust: Collective thrust, N.
        torque: Torque about the body axes, N m.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s; written.
    """
    # Maximum thrust of one rotor, N
    most = row.thrust_coefficient * row.max_rotor_speed * row.max_rotor_speed
    # Reduce the thrust so that roll and pitch fit.
    for r in range(row.num_rotors):
        turn = gain.mixer[r, 1] * torque[0] + gain.mixer[r, 2] * torque[1]
        over = gain.mixer[r, 0] * thrust + turn > most
        if is_any(over):
            less = max(most - turn, 0.5 * most) / gain.mixer[r, 0]
            thrust = where(over, min(thrust, less), thrust)
    # Thrust of each rotor without yaw, and the largest fraction of yaw that all rotors can add.
    share = 1.0
    for r in range(row.num_rotors):
        lift = (
            gain.mixer[r, 0] * thrust + gain.mixer[r, 1] * torque[0] + gain.mixer[r, 2] * torque[1]
        )
        # Rotors have no negative thrust
        level = min(max(lift, 0.0), most)
        command[r] = level
        turn = gain.mixer[r, 3] * torque[2]
        over = level + turn > most
        under = level + turn < 0.0
        if is_any(over):
            share = where(over, min(share, (most - level) / turn), share)
        if is_any(under):
            share = where(under, min(share, -level / turn), share)

    # Add that fraction of yaw, and convert thrust to speed; rounding may make the thrust negative.
    for r in range(row.num_rotors):
        lift = max(command[r] + share * gain.mixer[r, 3] * torque[2], 0.0)
        command[r] = math.sqrt(lift / row.thrust_coefficient)
