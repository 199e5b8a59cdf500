"""Rotors of one drone: first-order speed lag, thrust k_f w^2 and reaction torque k_m w^2.

Their inertia J turns the body back while they speed up, by J dw/dt, and makes them a gyroscope.
Source: R. Mahony, V. Kumar, P. Corke, Multirotor Aerial Vehicles, IEEE RAM 2012.
"""

import math

import numpy as np

from bulletuav.compiled.functions import exp
from bulletuav.compiled.kernel import func
from bulletuav.compiled.lanes import where
from bulletuav.geometry.rotation import Vec3
from bulletuav.vehicle.parameters import ParameterRow

RPM = 2.0 * math.pi / 60.0
"""One revolution a minute, rad/s."""

Rotors = tuple[float, Vec3, float, float]
"""Thrust (N), torque about the body axes (N m), sum of the rotor speeds (rad/s), and their angular
momentum about the body's z axis (N m s)"""


@func
def lag_decay(elapsed: float, row: ParameterRow) -> tuple[float, float]:
    """Return the share of the way to a command that rotors have left after a time.

    Args:
        elapsed: Time since the command, s.
        row: Constants of the drone.

    Returns:
        The share for rotors that speed up, and for rotors that slow down.
    """
    # Most motors have one time constant: they need one exponential.
    up = exp(-elapsed / row.lag_up) if row.lag_up > 0.0 else 0.0
    if row.lag_down == row.lag_up:
        return up, up
    down = exp(-elapsed / row.lag_down) if row.lag_down > 0.0 else 0.0
    return up, down


@func
def rotor_speed_after(speed: float, command: float, decay: tuple[float, float]) -> float:
    """Return the speed of a rotor on its way to a command, exact while the command is constant.

    Args:
        speed: Speed at the time of the command, rad/s.
        command: Speed that is commanded, rad/s.
        decay: What `lag_decay` returns for the time since.

    Returns:
        The speed now, rad/s.
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
    """Return how fast a rotor speeds up towards a command, rad/s^2; 0 without lag.

    Args:
        speed: Its speed, rad/s.
        command: Speed that is commanded, rad/s.
        rate: What `lag_rates` returns.
    """
    pace: float = where(command > speed, rate[0], rate[1])
    return (command - speed) * pace


@func
def rotor_wrench(speed: np.ndarray, winding: float, row: ParameterRow) -> Rotors:
    """Return what the rotors do to the body.

    Args:
        speed: (R,) rotor speeds, rad/s.
        winding: Sum over the rotors of turn dw/dt, rad/s^2: how fast they speed up.
        row: Constants of the drone.

    Returns:
        What they do.
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
    # Thrust at the rotor's place turns the body, and so does its drag torque.
    lift = row.thrust_coefficient
    torque_z = row.torque_coefficient * square_turn + row.rotor_inertia * winding
    # A rotor spins against the torque that it exerts on the body.
    momentum = -row.rotor_inertia * turn
    return lift * square, (lift * square_y, -lift * square_x, torque_z), total, momentum
