"""Setpoints and their levels, from position down to rotor speeds."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func

SPEED_ROUNDING = 1e-6
"""Relative rounding that a command of the minimum speed may have"""


class SetpointLevel(IntEnum):
    """Meaning of the numbers in a setpoint.

    World axes are ENU, body axes FLU, units SI. Controllers convert lower levels to higher ones.

    Attributes:
        POSITION: Position x, y, z (m, world), yaw (rad).
        VELOCITY: Velocity vx, vy, vz (m/s, world), yaw (rad).
        ACCELERATION: Acceleration ax, ay, az (m/s^2, world; net of gravity and drag), yaw (rad).
        ATTITUDE: Roll, pitch, yaw (rad) and collective thrust (N).
        RATES: Body rates p, q, r (rad/s) and collective thrust (N).
        ROTOR: Speed of each rotor (rad/s), then deflection of each control surface (rad).
    """

    POSITION = 0
    VELOCITY = 1
    ACCELERATION = 2
    ATTITUDE = 3
    RATES = 4
    ROTOR = 5


class Setpoints(NamedTuple):
    """Setpoints of W worlds of N drones, held during a decision.

    Attributes:
        level: (W, N) `SetpointLevel` of each drone's setpoint.
        value: (W, N, S) numbers of the setpoints, in the columns of their level.
    """

    level: np.ndarray
    value: np.ndarray


@func
def is_flying_speed(x: float, y: float, min_speed: float) -> bool:
    """Check whether a horizontal velocity is at least the minimum speed, but for rounding.

    Setpoints at the minimum speed itself, such as those of `heading_speed_climb`, come from sines
    and cosines, and may come from single precision.

    Args:
        x: East component, m/s.
        y: North component, m/s.
        min_speed: Minimum speed, m/s.
    """
    low = (1.0 - SPEED_ROUNDING) * min_speed
    return x * x + y * y >= low * low
