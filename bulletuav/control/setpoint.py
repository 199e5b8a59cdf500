"""Setpoint levels: the staircase that controllers step down from an action to rotor speeds."""

from enum import IntEnum


class SetpointLevel(IntEnum):
    """What a setpoint row means; world ENU, body FLU, SI units. Controllers go from lower numbers to higher ones."""

    POSITION = 0
    """x, y, z, yaw"""
    VELOCITY = 1
    """vx, vy, vz, yaw"""
    ACCELERATION = 2
    """ax, ay, az, yaw; net of gravity and drag"""
    ATTITUDE = 3
    """roll, pitch, yaw, collective thrust"""
    RATES = 4
    """p, q, r, collective thrust"""
    ROTOR = 5
    """speed of each rotor, rad/s"""
