"""Actions with a number for each rotor."""

import numpy as np

from bulletuav.control.actions.base import Action, ActionContext, Decoder
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register
from bulletuav.vehicle.rotors import RPM

HOVER_RPM_RANGE = 0.05
"""Share of the hover speed by which action `hover_rpm` can change it"""


def _per_rotor(
    context: ActionContext,
    name: str,
    label: str,
    low: float,
    high: np.ndarray,
    decode: Decoder,
) -> Action:
    """Make an action with a number for each rotor; `high` (N,) bounds the numbers of each drone."""
    counts = [len(airframe.rotors) for airframe in context.airframes]
    exists = np.arange(max(counts)) < np.array(counts)[:, None]
    return Action(
        name=name,
        level=SetpointLevel.ROTOR,
        labels=tuple(tuple(f"rotor {r}{label}" for r in range(count)) for count in counts),
        low=np.where(exists, low, 0.0),
        high=np.where(exists, high[:, None], 0.0),
        decode=decode,
    )


@register("action")
def rotor(context: ActionContext) -> Action:
    """Set the thrust of each rotor: none at -1, the most at 1.

    The speed is max_rotor_speed sqrt((a + 1) / 2).
    """
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes])[:, None]
    ones = np.ones(len(most))

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return most * np.sqrt(0.5 * (action + 1))

    return _per_rotor(
        context,
        name="rotor",
        label=": 2 thrust / max thrust - 1",
        low=-1.0,
        high=ones,
        decode=decode,
    )


@register("action")
def rpm(context: ActionContext) -> Action:
    """Set the speed of each rotor in revolutions per minute, as they are."""
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes]) / RPM

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return action * RPM

    return _per_rotor(
        context,
        name="rpm",
        label=", rpm",
        low=0.0,
        high=most,
        decode=decode,
    )


@register("action")
def hover_rpm(context: ActionContext) -> Action:
    """Change the speed of each rotor by up to 5 % of that of hover.

    This is the action of HoverAviary in gym-pybullet-drones.
    """
    speeds = [airframe.hover_speed(context.gravity) for airframe in context.airframes]
    hover = np.array(speeds)[:, None]
    ones = np.ones(len(hover))

    def decode(action: np.ndarray, commanded: np.ndarray) -> np.ndarray:
        return hover * (1 + HOVER_RPM_RANGE * action)

    return _per_rotor(
        context,
        name="hover_rpm",
        label=": 20 (rpm / hover rpm - 1)",
        low=-1.0,
        high=ones,
        decode=decode,
    )
