"""Geometric tracking control of one drone on SE(3), factored into the steps of the staircase.

Source: T. Lee, M. Leok, N. McClamroch, Geometric tracking control of a quadrotor UAV on SE(3), CDC 2010, here with z up
and gains from frequencies: k_x = m w^2, k_v = 2 z m w, k_R = J w_R^2, k_W = 2 z J w_R. Each step is a proportional law, and
their composition is the published one: m w^2 e_x + 2 z m w e_v = 2 z m w (e_v + w / (2 z) e_x), likewise for attitude.
`row` is one row of the nominal `PARAMETERS`, `gain` one row of `GAINS`.
"""

import math

from bulletuav.geometry.rotation import axes, cross, dot, to_body, to_world
from bulletuav.kernel import func


@func
def velocity_setpoint(position, target, gain):
    """POSITION to VELOCITY (m/s): towards the target, no faster than can be braked at `max_deceleration`."""
    error = (target[0] - position[0], target[1] - position[1], target[2] - position[2])
    distance = math.sqrt(dot(error, error))
    rate = gain.position_frequency / (2.0 * gain.damping)
    linear = gain.max_deceleration / (
        rate * rate
    )  # closer than this, the proportional law brakes gently enough
    if distance > linear:
        speed = math.sqrt(2.0 * gain.max_deceleration * (distance - 0.5 * linear))
        rate = min(speed, gain.max_speed) / distance
    elif rate * distance > gain.max_speed:
        rate = gain.max_speed / distance
    return rate * error[0], rate * error[1], rate * error[2]


@func
def acceleration_setpoint(velocity, target, gain):
    """VELOCITY to ACCELERATION (m/s^2)."""
    rate = 2.0 * gain.damping * gain.position_frequency
    return (
        rate * (target[0] - velocity[0]),
        rate * (target[1] - velocity[1]),
        rate * (target[2] - velocity[2]),
    )


@func
def force_setpoint(acceleration, quaternion, velocity, total_speed, gravity, row, gain):
    """ACCELERATION to the force wanted from the rotors (N, world): weight, acceleration, drag in still air at `velocity`.

    Upward between 0.3 weights and 0.9 of the thrust, height before sideways, tilted by `max_tilt` at most.
    """
    v = to_body(quaternion, velocity)
    xy, z = row.drag_xy * total_speed, row.drag_z * total_speed
    drag = to_world(quaternion, (xy * v[0], xy * v[1], z * v[2]))
    x = row.mass * acceleration[0] + drag[0]
    y = row.mass * acceleration[1] + drag[1]
    z = row.mass * (acceleration[2] + gravity) + drag[2]
    most = 0.9 * gain.max_thrust
    z = min(max(z, 0.3 * row.mass * gravity), most)
    sideways = math.sqrt(x * x + y * y)
    limit = min(gain.max_tilt * z, math.sqrt(most * most - z * z))
    if sideways > limit:
        x *= limit / sideways
        y *= limit / sideways
    return x, y, z


@func
def nose(yaw):
    """Where the nose points, (3,) horizontal; most flights hold 0, which needs no sine."""
    if yaw == 0.0:
        return 1.0, 0.0, 0.0
    return math.cos(yaw), math.sin(yaw), 0.0


@func
def desired_axes(force, yaw):
    """Body axes in the world that point thrust along `force` and the nose towards `yaw` (rad)."""
    size = math.sqrt(dot(force, force))
    b3 = (force[0] / size, force[1] / size, force[2] / size)
    side = cross(b3, nose(yaw))
    size = math.sqrt(dot(side, side))
    b2 = (side[0] / size, side[1] / size, side[2] / size)
    return cross(b2, b3), b2, b3


@func
def attitude_error(quaternion, desired):
    """vee(Rc^T R - R^T Rc), `desired` the columns of Rc."""
    b1, b2, b3 = axes(quaternion)
    c1, c2, c3 = desired
    return dot(c3, b2) - dot(b3, c2), dot(c1, b3) - dot(b1, c3), dot(c2, b1) - dot(b2, c1)


@func
def rates_setpoint(quaternion, desired, gain):
    """ATTITUDE to RATES (rad/s, body): -(w_R / 2z) e_R with e_R = vee(Rc^T R - R^T Rc) / 2, `desired` the columns of Rc."""
    error = attitude_error(quaternion, desired)
    scale = -0.25 / gain.damping
    frequency = gain.attitude_frequency
    return (
        scale * frequency[0] * error[0],
        scale * frequency[1] * error[1],
        scale * frequency[2] * error[2],
    )


@func
def torque_setpoint(rates, target, row, gain):
    """RATES to body torque (N m): -k_W (W - W_target) + W x J W."""
    momentum = (row.inertia[0] * rates[0], row.inertia[1] * rates[1], row.inertia[2] * rates[2])
    gyroscopic = cross(rates, momentum)
    twice = 2.0 * gain.damping
    frequency = gain.attitude_frequency
    return (
        gyroscopic[0] - twice * row.inertia[0] * frequency[0] * (rates[0] - target[0]),
        gyroscopic[1] - twice * row.inertia[1] * frequency[1] * (rates[1] - target[1]),
        gyroscopic[2] - twice * row.inertia[2] * frequency[2] * (rates[2] - target[2]),
    )


@func
def mix(thrust, torque, row, gain, command):
    """Collective thrust and torques to rotor speeds (rad/s, into `command`), each within what the rotor can do.

    Yaw, which needs the most of the rotors and matters least, gets only what thrust, roll and pitch leave.
    """
    most = row.thrust_coefficient * row.max_rotor_speed * row.max_rotor_speed
    share = 1.0
    for r in range(row.num_rotors):
        lift = (
            gain.mixer[r, 0] * thrust + gain.mixer[r, 1] * torque[0] + gain.mixer[r, 2] * torque[1]
        )
        command[r] = min(max(lift, 0.0), most)
        turn = gain.mixer[r, 3] * torque[2]
        if command[r] + turn > most:
            share = min(share, (most - command[r]) / turn)
        elif command[r] + turn < 0.0:
            share = min(share, -command[r] / turn)
    for r in range(row.num_rotors):
        lift = max(
            command[r] + share * gain.mixer[r, 3] * torque[2], 0.0
        )  # rounding may leave it just below
        command[r] = math.sqrt(lift / row.thrust_coefficient)
