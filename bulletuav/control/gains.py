"""Controller gains of each drone, as rows for the compiled loops.

Gains are computed from the loop frequencies that the drone's motors allow.
"""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Protocol

import numpy as np

from bulletuav.compiled.functions import sin, tan
from bulletuav.compiled.plain import record_type
from bulletuav.vehicle.airframe import MAX_ROTORS, STANDARD_GRAVITY, Airframe
from bulletuav.vehicle.envelope import find_climb, find_envelope

NUM_CLIMBS = 5
"""Number of airspeeds at which `GainRow.excess_climb` is stored."""

GAINS = record_type(
    [
        ("attitude_frequency", "f8", 3),
        ("position_frequency", "f8"),
        ("damping", "f8"),
        ("max_speed", "f8"),
        ("max_deceleration", "f8"),
        ("max_tilt", "f8"),
        ("max_thrust", "f8"),
        ("max_push", "f8"),
        ("min_speed", "f8"),
        ("cruise_speed", "f8"),
        ("max_bank", "f8"),
        ("max_climb", "f8"),
        ("max_sink", "f8"),
        ("excess_climb", "f8", NUM_CLIMBS),
        ("mixer", "f8", (MAX_ROTORS, 4)),
        ("pid_mixer", "f8", (MAX_ROTORS, 3)),
        ("pwm_slope", "f8"),
        ("pwm_intercept", "f8"),
        ("pwm_min", "f8"),
        ("pwm_max", "f8"),
    ]
)
"""NumPy type of the rows; `GainRow` documents the fields"""

DAMPING = 0.8
"""Damping ratio of all loops"""
FASTEST_ATTITUDE = 10.0
"""Highest frequency of the attitude loop, rad/s"""
MAX_TILT = math.radians(55)
"""Largest tilt that controllers command, rad"""
MAX_PUSH = 0.5
"""Bound of the estimated disturbance in a flight without loads, in multiples of gravity"""
MAX_DECELERATION = 5.0
"""Deceleration towards a target position, m/s^2"""

GLIDE_DECELERATION = 0.6
"""Deceleration of a VTOL towards a target position, relative to that by its drag in a glide"""


class GainRow(Protocol):
    """One row of `GAINS`, as typed for compiled functions.

    Attributes:
        attitude_frequency: (3,) frequencies of the attitude loop about x, y, z, rad/s.
        position_frequency: Frequency of the position loop, rad/s.
        damping: Damping ratio of all loops.
        max_speed: Highest speed towards a target position, m/s.
        max_deceleration: Deceleration towards a target position, m/s^2.
        max_tilt: Tangent of the largest tilt.
        max_thrust: Thrust of all rotors at their highest speed, N.
        max_push: Bound of the estimated disturbance, in multiples of gravity.
        min_speed: Minimum airspeed of aircraft that cannot hover, m/s; 0 for all others, like the
            next five.
        cruise_speed: Cruise speed, m/s.
        max_bank: Tangent of the largest bank angle.
        max_climb: Largest rate of climb, m/s.
        max_sink: Largest rate of descent, m/s.
        excess_climb: (NUM_CLIMBS,) steady climb at full throttle, m/s, at airspeeds evenly spaced
            from min_speed to max_speed: the specific excess power.
        mixer: (MAX_ROTORS, 4) thrust of each rotor from collective thrust and torques.
        pid_mixer: (MAX_ROTORS, 3) PWM steps of each rotor per unit of the PID's roll, pitch and yaw
            output, which is not a torque in N m.
        pwm_slope: Slope of rpm = slope pwm + intercept.
        pwm_intercept: Intercept of rpm = slope pwm + intercept.
        pwm_min: Smallest PWM.
        pwm_max: Largest PWM.
    """

    attitude_frequency: np.ndarray
    position_frequency: float
    damping: float
    max_speed: float
    max_deceleration: float
    max_tilt: float
    max_thrust: float
    max_push: float
    min_speed: float
    cruise_speed: float
    max_bank: float
    max_climb: float
    max_sink: float
    excess_climb: np.ndarray
    mixer: np.ndarray
    pid_mixer: np.ndarray
    pwm_slope: float
    pwm_intercept: float
    pwm_min: float
    pwm_max: float


def gain_rows(airframes: Sequence[Airframe], max_speed: float) -> np.ndarray:
    """Compute the controller gains of drones.

    The attitude loop runs at w_R = min(10 rad/s, 1 / (2 tau)), where tau is the slower motor lag.
    The position loop is four times slower, and yaw runs at w_R / 2. All loops have damping 0.8.
    Inner loops therefore settle before outer loops.

    Next to loads, a drone may learn any weight that its spare thrust lifts.

    Args:
        airframes: Airframe of each of N drones.
        max_speed: Highest speed that the drones can be commanded to fly at, m/s.

    Returns:
        (N,) rows of `GAINS`.
    """
    rows = np.zeros(len(airframes), dtype=GAINS)
    any_load = any(airframe.is_load for airframe in airframes)
    is_mixed = any(airframe.needs_airspeed for airframe in airframes)
    for row, airframe in zip(rows, airframes, strict=True):
        lag = max(airframe.lag_up, airframe.lag_down)
        frequency = min(FASTEST_ATTITUDE, 1 / (2 * lag)) if lag > 0 else FASTEST_ATTITUDE
        num_rotors = len(airframe.rotors)

        row["attitude_frequency"] = frequency, frequency, frequency / 2
        row["position_frequency"] = frequency / 4
        row["damping"] = DAMPING
        # Drones of a mixed fleet may be slower than its fastest
        row["max_speed"] = min(max_speed, airframe.max_speed) if is_mixed else max_speed
        row["max_deceleration"] = _max_deceleration(airframe)
        row["max_tilt"] = tan(MAX_TILT)
        row["max_thrust"] = airframe.max_thrust
        spare = airframe.max_thrust / (airframe.mass * STANDARD_GRAVITY) - 1.0
        row["max_push"] = max(MAX_PUSH, spare) if any_load else MAX_PUSH
        if airframe.needs_airspeed:
            _write_envelope(row, airframe)
        elif num_rotors:
            row["mixer"][:num_rotors] = exact_pseudo_inverse(airframe.allocation())

        # The PID needs a motor map from PWM to rpm.
        if airframe.pwm is not None:
            row["pid_mixer"][:num_rotors] = _pid_mixer(airframe)
            row["pwm_slope"] = airframe.pwm.slope
            row["pwm_intercept"] = airframe.pwm.intercept
            row["pwm_min"] = airframe.pwm.minimum
            row["pwm_max"] = airframe.pwm.maximum
    return rows


def _write_envelope(row: np.void, airframe: Airframe) -> None:
    """Write the limits of an aircraft that cannot hover.

    Raises:
        ValueError: If the speed limit is below its minimum speed.
    """
    envelope = find_envelope(airframe)
    if row["max_speed"] < envelope.min_speed:
        raise ValueError(
            f"max_speed is {row['max_speed']:g} m/s: airframe {airframe.name!r} needs at least "
            f"{envelope.min_speed:.4g} m/s to fly, so raise it"
        )
    row["max_speed"] = min(row["max_speed"], envelope.max_speed)
    row["min_speed"], row["cruise_speed"] = envelope.min_speed, envelope.cruise_speed
    row["max_bank"] = tan(envelope.max_bank)
    row["max_climb"], row["max_sink"] = envelope.max_climb, envelope.max_sink
    speeds = np.linspace(row["min_speed"], row["max_speed"], NUM_CLIMBS).tolist()
    row["excess_climb"] = [v * sin(find_climb(airframe, v).climb) for v in speeds]


def _max_deceleration(airframe: Airframe) -> float:
    """Return the deceleration towards a target position, m/s^2.

    A VTOL slows down by the drag of a glide, of which it uses a part.
    """
    if not (airframe.wings and airframe.can_hover and airframe.forward_rotors):
        return MAX_DECELERATION
    envelope = find_envelope(airframe)
    glide = STANDARD_GRAVITY * envelope.max_sink / envelope.cruise_speed
    return min(MAX_DECELERATION, GLIDE_DECELERATION * glide)


def exact_pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Compute the Moore-Penrose inverse A^T (A A^T)^-1 in rational numbers.

    Linear algebra libraries round differently on different processors. This function rounds only
    the result.

    Args:
        matrix: (M, R) matrix A of full row rank, M <= R.

    Returns:
        (R, M) float64; each entry is correctly rounded.
    """
    return np.array(_invert(tuple(map(tuple, matrix.tolist())))).T


@lru_cache(128)
def _invert(matrix: tuple[tuple[float, ...], ...]) -> list[list[float]]:
    """Compute the transpose of `exact_pseudo_inverse`, cached as drones share airframes."""
    rows = [[Fraction(value) for value in row] for row in matrix]
    size = len(rows)
    # Gauss-Jordan elimination of [A A^T | A] leaves (A A^T)^-1 A on the right.
    gram = [[_dot(one, other) for other in rows] for one in rows]
    table = [left + right for left, right in zip(gram, rows, strict=True)]
    for k in range(size):
        # Swap in a row with a nonzero pivot, and scale the pivot to one.
        pivot = next(i for i in range(k, size) if table[i][k])
        table[k], table[pivot] = table[pivot], table[k]
        table[k] = [value / table[k][k] for value in table[k]]
        # Clear the pivot's column in all other rows.
        for i in range(size):
            if i != k:
                factor = table[i][k]
                table[i] = [
                    value - factor * of_pivot
                    for value, of_pivot in zip(table[i], table[k], strict=True)
                ]
    return [[float(value) for value in row[size:]] for row in table]


def _dot(one: list[Fraction], other: list[Fraction]) -> Fraction:
    """Compute the scalar product of two rows."""
    return sum((a * b for a, b in zip(one, other, strict=True)), Fraction(0))


def _pid_mixer(airframe: Airframe) -> np.ndarray:
    """Compute (R, 3) PWM steps of each rotor per unit of roll, pitch and yaw command.

    For an X configuration they are +-1/2, +-1/2, +-1.
    """
    x, y, turn = np.array(airframe.rotors).T
    roll = y / (np.abs(y).sum() / 2)
    pitch = -x / (np.abs(x).sum() / 2)
    return np.stack([roll, pitch, turn], axis=1)
