"""The Crazyflie's position and attitude PID, for comparison with work that uses it.

Source: the PID of the University of Toronto's Dynamic Systems Lab (`DSLPIDControl` of
gym-pybullet-drones, J. Panerati et al. 2021): same gains, limits and motor map. Two differences:
the rate error uses the measured body rates instead of differences of Euler angles, and the
integrals are reset with the episode. The PID is tuned for motors without lag.

In all functions `row` is the drone's row of the nominal `PARAMETERS`, and `gain` that of `GAINS`.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.control.gains import GainRow
from bulletuav.control.lee import attitude_error, desired_axes
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, axes, dot
from bulletuav.vehicle.rotors import RPM

MEMORY = 6
"""Number of integrals of each drone: of the position error (3) and of the attitude error (3)"""

# Gains on each axis: of the force (N per m, m s and m/s) and of the torque (PWM units).
FORCE_P = (0.4, 0.4, 1.25)
FORCE_I = (0.05, 0.05, 0.05)
FORCE_D = (0.2, 0.2, 0.5)
TORQUE_P = (7e4, 7e4, 6e4)
TORQUE_I = (0.0, 0.0, 500.0)
TORQUE_D = (2e4, 2e4, 1.2e4)

# Bounds of the integrals (m s, and s) and of each torque command (PWM units).
POSITION_INTEGRAL_LIMIT = (2.0, 2.0, 0.15)
ATTITUDE_INTEGRAL_LIMIT = (1.0, 1.0, 1500.0)
TORQUE_LIMIT = 3200.0


@func
def clipped(value: float, limit: float) -> float:
    """Limit `value` to [-limit, limit]."""
    return min(max(value, -limit), limit)


@func
def integrated(integral: Vec3Like, error: Vec3Like, dt: float, limit: Vec3) -> Vec3:
    """Advance the integral of an error by one step.

    Args:
        integral: Integral before the step.
        error: Error during the step.
        dt: Length of the step, s.
        limit: Bound of each component's magnitude.

    Returns:
        Integral after the step, within its limit.
    """
    return (
        clipped(integral[0] + error[0] * dt, limit[0]),
        clipped(integral[1] + error[1] * dt, limit[1]),
        clipped(integral[2] + error[2] * dt, limit[2]),
    )


@func
def pid_force(
    position_error: Vec3Like,
    velocity_error: Vec3Like,
    integral: Vec3Like,
    row: np.record,
    gravity: float,
) -> Vec3:
    """Compute the force that drives position and velocity errors to zero.

    Args:
        position_error: Target minus position, m, world.
        velocity_error: Target minus velocity, m/s, world.
        integral: Integral of the position error, m s.
        row: Row of `PARAMETERS`.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        Force setpoint, N, world.
    """
    # The upward force also compensates the weight
    return (
        FORCE_P[0] * position_error[0] + FORCE_I[0] * integral[0] + FORCE_D[0] * velocity_error[0],
        FORCE_P[1] * position_error[1] + FORCE_I[1] * integral[1] + FORCE_D[1] * velocity_error[1],
        FORCE_P[2] * position_error[2]
        + FORCE_I[2] * integral[2]
        + FORCE_D[2] * velocity_error[2]
        + row.mass * gravity,
    )


@func
def pid_torque(error: Vec3Like, rates: Vec3Like, integral: Vec3Like) -> Vec3:
    """Compute the roll, pitch and yaw commands that turn the drone to the desired attitude.

    Args:
        error: Attitude error from `attitude_error`.
        rates: Body rates, rad/s.
        integral: Integral of the error with the opposite sign.

    Returns:
        Commands about the body axes, PWM units, each within `TORQUE_LIMIT`.
    """
    # A positive error is an overshoot, so P and D oppose error and rates
    roll = -TORQUE_P[0] * error[0] + TORQUE_I[0] * integral[0] - TORQUE_D[0] * rates[0]
    pitch = -TORQUE_P[1] * error[1] + TORQUE_I[1] * integral[1] - TORQUE_D[1] * rates[1]
    yaw = -TORQUE_P[2] * error[2] + TORQUE_I[2] * integral[2] - TORQUE_D[2] * rates[2]
    return clipped(roll, TORQUE_LIMIT), clipped(pitch, TORQUE_LIMIT), clipped(yaw, TORQUE_LIMIT)


@func
def pid_rotors(
    position_error: Vec3Like,
    velocity_error: Vec3Like,
    yaw: float,
    quaternion: Quat4Like,
    rates: Vec3Like,
    integrals: tuple[Vec3, Vec3],
    dt: float,
    gravity: float,
    row: np.record,
    gain: GainRow,
    command: np.ndarray,
) -> tuple[Vec3, Vec3]:
    """Compute the rotor speeds of one step of the PID.

    Args:
        position_error: Target minus position, m, world.
        velocity_error: Target minus velocity, m/s, world.
        yaw: Yaw to hold, rad.
        quaternion: Attitude of the drone, body to world.
        rates: Body rates of the drone, rad/s.
        integrals: Integrals of the position error and, with the opposite sign, the attitude error.
        dt: Time since the last step, s.
        gravity: Gravitational acceleration, m/s^2.
        row: Row of `PARAMETERS`.
        gain: Row of `GAINS`.
        command: (R,) speed of each rotor, rad/s, which is written.

    Returns:
        The integrals after the step.
    """
    # Outer loop: force from position and velocity errors; motor speed for its part along body z.
    along = integrated(integrals[0], position_error, dt, POSITION_INTEGRAL_LIMIT)
    force = pid_force(position_error, velocity_error, along, row, gravity)
    thrust = max(0.0, dot(force, axes(quaternion)[2]))
    rpm = math.sqrt(thrust / (row.num_rotors * row.thrust_coefficient)) / RPM
    base = (rpm - gain.pwm_intercept) / gain.pwm_slope

    # Inner loop: torques that turn body z along the force and the nose towards the yaw.
    error = attitude_error(quaternion, desired_axes(force, yaw))
    about = integrated(integrals[1], error, -dt, ATTITUDE_INTEGRAL_LIMIT)
    torque = pid_torque(error, rates, about)

    # PWM of each motor, clamped to its range, and the resulting speed.
    for r in range(row.num_rotors):
        pwm = base
        for axis in range(3):
            pwm += gain.pid_mixer[r, axis] * torque[axis]
        pwm = min(max(pwm, gain.pwm_min), gain.pwm_max)
        command[r] = (gain.pwm_slope * pwm + gain.pwm_intercept) * RPM
    return along, about
