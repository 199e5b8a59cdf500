"""Action types with a number for each rotor."""

import math
from collections.abc import Callable

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.control.actions.base import Action, ActionContext, Compiled
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register
from bulletuav.vehicle.rotors import RPM

HOVER_RPM_RANGE = 0.05
"""Largest change of action `hover_rpm`, as a fraction of the hover speed"""


@kernel
def _decode_thrust(
    action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray, most: np.ndarray
) -> None:
    """Write the rotor speeds, at most `most` (N,), of action `rotor`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for r in range(setpoint.shape[2]):
                setpoint[w, i, r] = most[i] * math.sqrt(0.5 * (action[w, i, r] + 1))


@kernel
def _decode_rpm(action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray) -> None:
    """Write the rotor speeds of action `rpm`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for r in range(setpoint.shape[2]):
                setpoint[w, i, r] = action[w, i, r] * RPM


@kernel
def _decode_change(
    action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray, hover: np.ndarray
) -> None:
    """Write the rotor speeds of action `hover_rpm`, about those of `hover` (N,)."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for r in range(setpoint.shape[2]):
                setpoint[w, i, r] = hover[i] * (1 + HOVER_RPM_RANGE * action[w, i, r])


def _per_rotor(
    context: ActionContext,
    name: str,
    label: str,
    low: float,
    high: np.ndarray,
    decode: Callable[..., None],
    *numbers: np.ndarray,
) -> Action:
    """Create an action with a number for each rotor; `high` (N,) bounds the numbers of each drone.

    `decode` and its numbers are the arguments of a `Compiled`.
    """
    counts = [len(airframe.rotors) for airframe in context.airframes]
    exists = np.arange(max(counts)) < np.array(counts)[:, None]
    return Action(
        name=name,
        level=SetpointLevel.ROTOR,
        labels=tuple(tuple(f"rotor {r}{label}" for r in range(count)) for count in counts),
        low=np.where(exists, low, 0.0),
        high=np.where(exists, high[:, None], 0.0),
        decode=Compiled(decode, max(counts), *numbers),
    )


@register("action")
def rotor(context: ActionContext) -> Action:
    """Set the thrust of each rotor: none at -1, the most at 1.

    The speed is max_rotor_speed sqrt((a + 1) / 2).
    """
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes])
    label, high = ": 2 thrust / max thrust - 1", np.ones(len(most))
    return _per_rotor(context, "rotor", label, -1.0, high, _decode_thrust, most)


@register("action")
def rpm(context: ActionContext) -> Action:
    """Set the speed of each rotor in revolutions per minute, as they are."""
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes]) / RPM
    return _per_rotor(context, "rpm", ", rpm", 0.0, most, _decode_rpm)


@register("action")
def hover_rpm(context: ActionContext) -> Action:
    """Change the speed of each rotor by up to 5 % of that of hover.

    This is the action of HoverAviary in gym-pybullet-drones.
    """
    speeds = [airframe.hover_speed(context.gravity) for airframe in context.airframes]
    label, ones = ": 20 (rpm / hover rpm - 1)", np.ones(len(speeds))
    return _per_rotor(context, "hover_rpm", label, -1.0, ones, _decode_change, np.array(speeds))
