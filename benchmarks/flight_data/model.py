"""Laws of flight under test: the Crazyflie 2.x as this repository models it."""

import numpy as np

MASS = 0.027
"""kg"""
ARM = 0.046
"""Distance of the rotors from the centre, m"""
THRUST = 2.1885e-8
"""N/(rad/s)^2"""
TORQUE_RATIO = 0.00596
"""Drag torque over thrust, m"""
INERTIA = (1.68e-5, 1.68e-5, 2.93e-5)
"""kg m^2"""
LAG = 0.065
"""s"""
ROTOR_DRAG = (1.6e-6, 1.6e-6, 1.4e-6)
"""N for each rad/s (sum of the rotors) and m/s"""
DRAG_HEIGHT = 0.034
"""Height above the centre of mass at which the horizontal drag acts, m: rotor plane and flapping"""
RATE_DAMPING = (2.0, 2.0, 2.5)
"""1/s at hover, in proportion to the sum of the rotor speeds"""
WAKE_SHARE = 0.32
"""Push of a wake right below the rotors, in thrusts of the upper drone"""
WAKE_GROWTH = 0.095
"""Growth of a wake's width with the drop"""
GROUND_SHARE = 0.35
"""Share by which thrust grows at height 0"""
GROUND_HEIGHT = 0.031
"""Height in which that falls to 1/e, m"""


def rotor_speed(pwm: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Return commanded rotor speeds.

    Args:
        pwm: Motor commands, shares of the greatest.
        volts: Voltage of the battery under load.

    Returns:
        Speeds, rad/s.
    """
    return (1900.0 + 6980.0 * pwm * volts) * (2.0 * np.pi / 60.0)


def wake_width_squared(drop: np.ndarray) -> np.ndarray:
    """Return the square of a wake's width, m^2, `drop` metres below the rotors."""
    return np.asarray(ARM * ARM + np.square(WAKE_GROWTH * drop))


def wake_force(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the push of a drone's wake on a drone below it.

    Args:
        distance: Horizontal distance of the two, m.
        drop: How far the other is below, m; none above.
        thrust: Thrust of the upper one, any unit.

    Returns:
        The force downwards, in the unit of the thrust.
    """
    square = wake_width_squared(drop)
    push = WAKE_SHARE * thrust * ARM / np.sqrt(square) * np.exp(-0.5 * distance * distance / square)
    return np.asarray(np.where(drop > 0.0, push, 0.0))


def wake_moment(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the moment by which a wake tips the lower drone towards the upper one's axis.

    It is the slope of the push times the square of the arm.
    """
    push = wake_force(distance, drop, thrust)
    return np.asarray(ARM * ARM * push * distance / wake_width_squared(drop))


def ground_effect(height: np.ndarray) -> np.ndarray:
    """Return the share by which thrust grows `height` metres above the ground."""
    return np.asarray(GROUND_SHARE * np.exp(-height / GROUND_HEIGHT))
