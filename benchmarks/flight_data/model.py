"""Laws of flight under test: the Crazyflie 2.x as this package models it, by its compiled code."""

import numpy as np

from bulletuav import load_airframe
from bulletuav.reproduction.nanobench_flights import compute_rotor_commands as rotor_speed
from bulletuav.reproduction.wake_pairs import predict_wake
from bulletuav.vehicle import aerodynamics
from bulletuav.vehicle.parameters import parameter_rows

AIRFRAME = load_airframe("cf2x")
ROW = parameter_rows([AIRFRAME])[0]
ROTOR_DRAG = (AIRFRAME.drag_xy, AIRFRAME.drag_xy, AIRFRAME.drag_z)
"""N for each rad/s (sum of the rotors) and m/s"""
__all__ = [
    "AIRFRAME",
    "ROTOR_DRAG",
    "ROW",
    "ground_effect",
    "rotor_speed",
    "wake_force",
    "wake_moment",
]


def wake_force(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the push of a drone's wake on a drone below it.

    Args:
        distance: Horizontal distance of the two, m.
        drop: How far the other is below, m; none above.
        thrust: Thrust of the upper one, any unit.

    Returns:
        The force downwards, in the unit of the thrust.
    """
    return predict_wake(distance, drop, thrust, ROW)[0]


def wake_moment(distance: np.ndarray, drop: np.ndarray, thrust: np.ndarray) -> np.ndarray:
    """Return the moment by which a wake tips the lower drone towards the upper one's axis.

    Its unit is that of the thrust, times m; see `wake_force`.
    """
    moment: np.ndarray = AIRFRAME.arm**2 * predict_wake(distance, drop, thrust, ROW)[1] * distance
    return moment


def ground_effect(height: np.ndarray) -> np.ndarray:
    """Return the share by which thrust grows `height` metres above the ground."""
    heights = np.asarray(height, float)
    shares = [aerodynamics.ground_effect(h, ROW) for h in heights.ravel().tolist()]
    return np.array(shares).reshape(heights.shape)
