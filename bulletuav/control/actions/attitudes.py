"""Action types that command an attitude or body rates, with a collective thrust."""

import math

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.control.actions.base import Action, ActionContext, Compiled, normalised
from bulletuav.control.gains import MAX_TILT
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register

MAX_RATES = np.array((2 * math.pi, 2 * math.pi, math.pi))
"""Largest body rates of action `rates`, rad/s"""


@kernel
def _decode(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    scale: np.ndarray,
    most: np.ndarray,
) -> None:
    """Write angles or rates, scaled by `scale` (3,), and thrusts from 0 to `most` (N,)."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for k in range(3):
                setpoint[w, i, k] = scale[k] * action[w, i, k]
            setpoint[w, i, 3] = most[i] * (action[w, i, 3] + 1) / 2


def _collective_thrusts(context: ActionContext) -> np.ndarray:
    """Return the largest collective thrust of each drone, N.

    It is that of the forward rotors, at rest, for aircraft that cannot hover.
    """
    thrusts = []
    for airframe in context.airframes:
        speed, count = airframe.max_rotor_speed, len(airframe.forward_rotors)
        forward = count * airframe.thrust_coefficient * (speed * speed)
        thrusts.append(forward if airframe.needs_airspeed else airframe.max_thrust)
    return np.array(thrusts)


@register("action")
def attitude(context: ActionContext) -> Action:
    """Hold roll and pitch (over 55 degrees), yaw (over 180 degrees) and a collective thrust.

    The thrust is none at -1 and the most at 1. Aircraft that cannot hover fly coordinated turns,
    and ignore the yaw; the thrust is that of their forward rotors.
    """
    # Bounds of angles, rad, and of the thrust of each airframe, N
    scale = np.array((MAX_TILT, MAX_TILT, np.pi))
    most = _collective_thrusts(context)
    labels = (
        "roll / 55 degrees",
        "pitch / 55 degrees",
        "yaw / 180 degrees",
        "2 thrust / max thrust - 1",
    )

    return normalised(
        context,
        name="attitude",
        level=SetpointLevel.ATTITUDE,
        labels=labels,
        decode=Compiled(_decode, 4, scale, most),
    )


@register("action")
def rates(context: ActionContext) -> Action:
    """Turn at body rates (over 360, 360 and 180 degrees a second) with a collective thrust.

    The thrust is none at -1 and the most at 1; that of the forward rotors for aircraft that cannot
    hover.
    """
    most = _collective_thrusts(context)
    labels = (
        "p / 360 degrees/s",
        "q / 360 degrees/s",
        "r / 180 degrees/s",
        "2 thrust / max thrust - 1",
    )

    return normalised(
        context,
        name="rates",
        level=SetpointLevel.RATES,
        labels=labels,
        decode=Compiled(_decode, 4, MAX_RATES, most),
    )
