"""Laws of flight under test: the Crazyflie 2.x as this package models it, by its compiled code."""

import numpy as np

from bulletuav import load_airframe
from bulletuav.vehicle import aerodynamics, wake
from bulletuav.vehicle.parameters import parameter_rows

AIRFRAME = load_airframe("cf2x")
ROW = parameter_rows([AIRFRAME])[0]
ROTOR_DRAG = (AIRFRAME.drag_xy, AIRFRAME.drag_xy, AIRFRAME.drag_z)
"""N for each rad/s (sum of the rotors) and m/s"""


def rotor_speed(pwm: np.ndarray, volts: np.ndarray) -> np.ndarray:
    """Return commanded rotor speeds.

    Measured maps of three sources agree, see docs/explanation/truth.md. The package's battery is
    this line
    about hover: 4670.5 rpm and more at its PWM map, at 3.57 V.

    Args:
        pwm: Motor commands, shares of the greatest.
        volts: Voltage of the battery under load.

    Returns:
        Speeds, rad/s.
    """
    return (1900.0 + 6980.0 * pwm * volts) * (2.0 * np.pi / 60.0)


def _wakes(
    distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return push and push over squared width, each of the shape of the arguments together."""
    apart, below, lift = np.broadcast_arrays(distance, drop, thrust)
    pairs = zip(apart.ravel(), below.ravel(), lift.ravel(), strict=True)
    rows = [wake.downwash(d * d, z, t, ROW) for d, z, t in pairs]
    push, tip = np.array(rows).reshape(-1, 2).T
    return push.reshape(apart.shape), tip.reshape(apart.shape)


def wake_force(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the push of a drone's wake on a drone below it.

    Args:
        distance: Horizontal distance of the two, m.
        drop: How far the other is below, m; none above.
        thrust: Thrust of the upper one, any unit.

    Returns:
        The force downwards, in the unit of the thrust.
    """
    return _wakes(distance, drop, thrust)[0]


def wake_moment(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the moment by which a wake tips the lower drone towards the upper one's axis.

    Its unit is that of the thrust, times m; see `wake_force`.
    """
    moment: np.ndarray = AIRFRAME.arm**2 * _wakes(distance, drop, thrust)[1] * distance
    return moment


def ground_effect(height: np.ndarray) -> np.ndarray:
    """Return the share by which thrust grows `height` metres above the ground."""
    heights = np.asarray(height, float)
    shares = [aerodynamics.ground_effect(h, ROW) for h in heights.ravel().tolist()]
    return np.array(shares).reshape(heights.shape)
