"""The Crazyflie's position and attitude PID, for comparison with work that uses it.

Source: the PID of the University of Toronto's Dynamic Systems Lab (`DSLPIDControl` of gym-pybullet-drones, J. Panerati et
al. 2021): same gains, limits and motor map. Two differences: the rate error takes the measured body rates instead of
differences of Euler angles, and the integrals are reset with the episode. It is made for motors without lag.
"""

import math

from bulletuav.control.lee import attitude_error, desired_axes
from bulletuav.geometry.rotation import axes, dot
from bulletuav.kernel import func
from bulletuav.vehicle.rotors import RPM

MEMORY = 6  # integrals of the position error (3) and of the attitude error (3)

FORCE_P, FORCE_I, FORCE_D = (0.4, 0.4, 1.25), (0.05, 0.05, 0.05), (0.2, 0.2, 0.5)
TORQUE_P, TORQUE_I, TORQUE_D = (7e4, 7e4, 6e4), (0.0, 0.0, 500.0), (2e4, 2e4, 1.2e4)
POSITION_INTEGRAL_LIMIT = (2.0, 2.0, 0.15)
ATTITUDE_INTEGRAL_LIMIT = (1.0, 1.0, 1500.0)
TORQUE_LIMIT = 3200.0


@func
def clipped(value, limit):
    """`value` within [-limit, limit]."""
    return min(max(value, -limit), limit)


@func
def integrated(integral, error, dt, limit):
    """The integral (3,) of `error` after dt, each component within its `limit`."""
    return (
        clipped(integral[0] + error[0] * dt, limit[0]),
        clipped(integral[1] + error[1] * dt, limit[1]),
        clipped(integral[2] + error[2] * dt, limit[2]),
    )


@func
def pid_force(position_error, velocity_error, integral, row, gravity):
    """Force setpoint (N, world) from errors (target minus state) and the integral of the position's."""
    return (
        FORCE_P[0] * position_error[0] + FORCE_I[0] * integral[0] + FORCE_D[0] * velocity_error[0],
        FORCE_P[1] * position_error[1] + FORCE_I[1] * integral[1] + FORCE_D[1] * velocity_error[1],
        FORCE_P[2] * position_error[2]
        + FORCE_I[2] * integral[2]
        + FORCE_D[2] * velocity_error[2]
        + row.mass * gravity,
    )


@func
def pid_torque(error, rates, integral):
    """Roll, pitch and yaw command (PWM units) against the attitude error (3,), whose negative `integral` holds."""
    return (
        clipped(
            -TORQUE_P[0] * error[0] + TORQUE_I[0] * integral[0] - TORQUE_D[0] * rates[0],
            TORQUE_LIMIT,
        ),
        clipped(
            -TORQUE_P[1] * error[1] + TORQUE_I[1] * integral[1] - TORQUE_D[1] * rates[1],
            TORQUE_LIMIT,
        ),
        clipped(
            -TORQUE_P[2] * error[2] + TORQUE_I[2] * integral[2] - TORQUE_D[2] * rates[2],
            TORQUE_LIMIT,
        ),
    )


@func
def pid_rotors(
    position_error,
    velocity_error,
    yaw,
    quaternion,
    rates,
    integrals,
    dt,
    gravity,
    row,
    gain,
    command,
):
    """Rotor speeds (rad/s, into `command`) from position and velocity errors (m, m/s) and the yaw to hold (rad).

    `integrals` are those of the position error (3,) and, negative, of the attitude error (3,); returned dt later.
    """
    along = integrated(integrals[0], position_error, dt, POSITION_INTEGRAL_LIMIT)
    force = pid_force(position_error, velocity_error, along, row, gravity)
    thrust = max(0.0, dot(force, axes(quaternion)[2]))
    rpm = math.sqrt(thrust / (row.num_rotors * row.thrust_coefficient)) / RPM
    base = (rpm - gain.pwm_intercept) / gain.pwm_slope
    error = attitude_error(quaternion, desired_axes(force, yaw))
    about = integrated(integrals[1], error, -dt, ATTITUDE_INTEGRAL_LIMIT)
    torque = pid_torque(error, rates, about)
    for r in range(row.num_rotors):
        pwm = base
        for axis in range(3):
            pwm += gain.pid_mixer[r, axis] * torque[axis]
        pwm = min(max(pwm, gain.pwm_min), gain.pwm_max)
        command[r] = (gain.pwm_slope * pwm + gain.pwm_intercept) * RPM
    return along, about
