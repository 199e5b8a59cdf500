"""Rotors of one drone: first-order speed lag, thrust k_f w^2 and reaction torque k_m w^2.

The rotors' inertia J exerts the torque J dw/dt on the body while they accelerate, and a gyroscopic
torque.

References:
    R. Mahony, V. Kumar, P. Corke, Multirotor Aerial Vehicles, IEEE RAM 2012.
"""

import math

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import where
from bulletuav.geometry.rotation import Vec3
from bulletuav.vehicle.parameters import ParameterRow

RPM = 2.0 * math.pi / 60.0
"""One revolution per minute, rad/s."""

Rotors = tuple[float, Vec3, float, float]
"""Thrust (N), torque about the body axes (N m), sum of the rotor speeds (rad/s), and angular
momentum of the rotors about the body's z axis (N m s)
"""


@func
def lag_decay(elapsed: float, row: ParameterRow) -> tuple[float, float]:
    """Return the remaining fraction of a rotor's speed error after a time, for a first-order lag.

    Args:
        elapsed: Time since the command, s.
        row: Constants of the drone.

    Returns:
        The fraction for rotors that speed up, and for rotors that slow down.
    """
    # Most motors have a single time constant, which needs one exponential only.
    up = exp(-elapsed / row.lag_up) if row.lag_up > 0.0 else 0.0
    if row.lag_down == row.lag_up:
        return up, up
    down = exp(-elapsed / row.lag_down) if row.lag_down > 0.0 else 0.0
    return up, down


@func
def rotor_speed_after(speed: float, command: float, decay: tuple[float, float]) -> float:
    """Return the speed of a rotor under a constant command (exact solution of the first-order lag).

    Args:
        speed: Speed at the time of the command, rad/s.
        command: Commanded speed, rad/s.
        decay: Result of `lag_decay` for the time since the command.

    Returns:
        The present speed, rad/s.
    """
    left: float = where(command > speed, decay[0], decay[1])
    return command + (speed - command) * left


@func
def lag_rates(row: ParameterRow) -> tuple[float, float]:
    """Return 1 / time constant of rotors that speed up and slow down, 1/s; 0 without lag."""
    up = where(row.lag_up > 0.0, 1.0 / row.lag_up, 0.0)
    down = where(row.lag_down > 0.0, 1.0 / row.lag_down, 0.0)
    return up, down


@func
def rotor_acceleration(speed: float, command: float, rate: tuple[float, float]) -> float:
    """Return the angular acceleration of a rotor towards its command, rad/s^2; 0 without lag.

    Args:
        speed: Present speed, rad/s.
        command: Commanded speed, rad/s.
        rate: Result of `lag_rates`.
    """
    pace: float = where(command > speed, rate[0], rate[1])
    return (command - speed) * pace


@func
def rotor_wrench(speed: np.ndarray, winding: float, row: ParameterRow) -> Rotors:
    """Compute the wrench of the rotors on the body, and their angular momentum.

    Args:
        speed: (R,) rotor speeds, rad/s.
        winding: Sum over the rotors of turn dw/dt, rad/s^2, from their acceleration.
        row: Constants of the drone.

    Returns:
        Thrust, torque, sum of the rotor speeds and angular momentum, see `Rotors`.
    """
    square = square_x = square_y = square_turn = total = turn = 0.0
    for r in range(row.num_rotors):
        now = speed[r]
        total += now
        turned = row.rotor_turn[r] * now
        turn += turned
        square_turn += turned * now
        squared = now * now
        square += squared
        square_x += row.rotor_x[r] * squared
        square_y += row.rotor_y[r] * squared
    # Torques of the thrust at the rotor's position, and of the rotor's drag
    lift = row.thrust_coefficient
    torque_z = row.torque_coefficient * square_turn + row.rotor_inertia * winding
    # A rotor spins opposite to the torque that it exerts on the body.
    momentum = -row.rotor_inertia * turn
    return lift * square, (lift * square_y, -lift * square_x, torque_z), total, momentum
