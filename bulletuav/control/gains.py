"""Controller gains of each drone, as rows for the compiled loops, from the frequencies that its motors allow."""

import math
from collections.abc import Sequence

import numpy as np

from bulletuav.physics.airframe import MAX_ROTORS, Airframe

GAINS = np.dtype(
    [
        ("attitude_frequency", "f8", 3),  # rad/s about x, y, z
        ("position_frequency", "f8"),  # rad/s
        ("damping", "f8"),
        ("max_speed", "f8"),  # m/s
        ("max_deceleration", "f8"),  # m/s^2, towards a target position
        ("max_tilt", "f8"),  # tangent of the angle
        ("max_thrust", "f8"),  # N, all rotors
        ("mixer", "f8", (MAX_ROTORS, 4)),  # thrust of each rotor from collective thrust and torques
        ("pid_mixer", "f8", (MAX_ROTORS, 3)),  # PWM of each rotor from the PID's torques
        ("pwm_slope", "f8"),  # rpm = slope pwm + intercept
        ("pwm_intercept", "f8"),
        ("pwm_min", "f8"),
        ("pwm_max", "f8"),
    ]
)

DAMPING = 0.8
FASTEST_ATTITUDE = 10.0  # rad/s
MAX_TILT = math.radians(55)
MAX_DECELERATION = 5.0  # m/s^2


def gain_rows(airframes: Sequence[Airframe], max_speed: float) -> np.ndarray:
    """(N,) rows of `GAINS` for drones that may be told to fly at up to `max_speed` m/s.

    The attitude loop runs at w_R = min(10 rad/s, 1 / (2 tau)) with tau the slower motor lag, the position loop four times
    slower, yaw at w_R / 2, all with damping 0.8: loops that each leave the one below it time to settle.
    """
    rows = np.zeros(len(airframes), dtype=GAINS)
    for row, airframe in zip(rows, airframes, strict=True):
        lag = max(airframe.lag_up, airframe.lag_down)
        frequency = min(FASTEST_ATTITUDE, 1 / (2 * lag)) if lag > 0 else FASTEST_ATTITUDE
        rotors = len(airframe.rotors)
        row["attitude_frequency"] = frequency, frequency, frequency / 2
        row["position_frequency"] = frequency / 4
        row["damping"] = DAMPING
        row["max_speed"] = max_speed
        row["max_deceleration"] = MAX_DECELERATION
        row["max_tilt"] = math.tan(MAX_TILT)
        row["max_thrust"] = airframe.max_thrust
        row["mixer"][:rotors] = np.linalg.pinv(airframe.allocation())
        if airframe.pwm is not None:
            row["pid_mixer"][:rotors] = _pid_mixer(airframe)
            row["pwm_slope"], row["pwm_intercept"] = airframe.pwm.slope, airframe.pwm.intercept
            row["pwm_min"], row["pwm_max"] = airframe.pwm.minimum, airframe.pwm.maximum
    return rows


def _pid_mixer(airframe: Airframe) -> np.ndarray:
    """(R, 3): PWM steps of each rotor per unit of roll, pitch and yaw command; +-1/2, +-1/2, +-1 for an X."""
    x, y, turn = np.array(airframe.rotors).T
    return np.stack([y / (np.abs(y).sum() / 2), -x / (np.abs(x).sum() / 2), turn], axis=1)
