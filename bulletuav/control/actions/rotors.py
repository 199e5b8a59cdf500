"""Action types with a number for each rotor, and for each control surface."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.control.actions.base import Action, ActionContext, Compiled
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.rotors import RPM
from bulletuav.vehicle.wings import MAX_SURFACES

HOVER_RPM_RANGE = 0.05
"""Largest change of action `hover_rpm`, as a fraction of the hover speed"""


class Columns(NamedTuple):
    """Numbers of an action of rotors and control surfaces, of N drones.

    Attributes:
        rotors: (N,) number of rotors.
        surfaces: (N,) number of control surfaces, whose numbers follow those of the rotors.
        middle: (N, MAX_SURFACES) middle of the range of each surface, rad.
        half: (N, MAX_SURFACES) half of its range, rad.
    """

    rotors: np.ndarray
    surfaces: np.ndarray
    middle: np.ndarray
    half: np.ndarray

    @classmethod
    def of(cls, airframes: Sequence[Airframe]) -> "Columns":
        """Count the rotors and control surfaces of airframes, and read their ranges."""
        counts = [[len(one.rotors), len(one.surfaces)] for one in airframes]
        rotors, surfaces = np.array(counts).T.copy()
        middle, half = np.zeros((2, len(airframes), MAX_SURFACES))
        for i, airframe in enumerate(airframes):
            for k, one in enumerate(airframe.surfaces):
                middle[i, k], half[i, k] = (one.high + one.low) / 2, (one.high - one.low) / 2
        return cls(rotors, surfaces, middle, half)


@func
def _write_deflections(
    action: np.ndarray, setpoint: np.ndarray, w: int, i: int, columns: Columns
) -> None:
    """Write the deflections of the control surfaces of a drone, -1 to 1 over their ranges."""
    for k in range(columns.surfaces[i]):
        turned = columns.half[i, k] * action[w, i, columns.rotors[i] + k]
        setpoint[w, i, columns.rotors[i] + k] = columns.middle[i, k] + turned


@kernel
def _decode_thrust(
    action: np.ndarray,
    commanded: np.ndarray,
    setpoint: np.ndarray,
    most: np.ndarray,
    columns: Columns,
) -> None:
    """Write the rotor speeds, at most `most` (N,), and deflections of action `rotor`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for r in range(columns.rotors[i]):
                setpoint[w, i, r] = most[i] * math.sqrt(0.5 * (action[w, i, r] + 1))
            _write_deflections(action, setpoint, w, i, columns)


@kernel
def _decode_rpm(
    action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray, columns: Columns
) -> None:
    """Write the rotor speeds and deflections of action `rpm`."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            for r in range(columns.rotors[i]):
                setpoint[w, i, r] = action[w, i, r] * RPM
            _write_deflections(action, setpoint, w, i, columns)


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
    *numbers: Any,
) -> Action:
    """Create an action with a number for each rotor, then one for each control surface.

    `high` (N,) bounds the numbers of each drone's rotors. `decode` and its numbers are the
    arguments of a `Compiled`.
    """
    airframes = context.airframes
    columns = Columns.of(airframes)
    count = columns.rotors + columns.surfaces
    width = int(count.max())
    number = np.arange(width)
    is_rotor = number < columns.rotors[:, None]
    is_surface = ~is_rotor & (number < count[:, None])
    return Action(
        name=name,
        level=SetpointLevel.ROTOR,
        labels=tuple(_labels(airframe, label) for airframe in airframes),
        low=np.where(is_rotor, low, -1.0 * is_surface),
        high=np.where(is_rotor, high[:, None], 1.0 * is_surface),
        decode=Compiled(decode, width, *numbers),
    )


def _labels(airframe: Airframe, label: str) -> tuple[str, ...]:
    """Return the labels of the rotors and control surfaces of an airframe."""
    rotors = [f"rotor {r}{label}" for r in range(len(airframe.rotors))]
    surfaces = [
        f"{one.name}: -1 to 1 for {math.degrees(one.low):g} to {math.degrees(one.high):g} degrees"
        for one in airframe.surfaces
    ]
    return (*rotors, *surfaces)


@register("action")
def rotor(context: ActionContext) -> Action:
    """Set the thrust of each rotor: none at -1, the most at 1.

    The speed is max_rotor_speed sqrt((a + 1) / 2). The deflection of each control surface follows,
    from -1 to 1 over its range; 1 moves its trailing edge down.
    """
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes])
    label, high = ": 2 thrust / max thrust - 1", np.ones(len(most))
    columns = Columns.of(context.airframes)
    return _per_rotor(context, "rotor", label, -1.0, high, _decode_thrust, most, columns)


@register("action")
def rpm(context: ActionContext) -> Action:
    """Set the speed of each rotor in revolutions per minute, as they are.

    The deflection of each control surface follows, from -1 to 1 over its range; 1 moves its
    trailing edge down.
    """
    most = np.array([airframe.max_rotor_speed for airframe in context.airframes]) / RPM
    columns = Columns.of(context.airframes)
    return _per_rotor(context, "rpm", ", rpm", 0.0, most, _decode_rpm, columns)


@register("action")
def hover_rpm(context: ActionContext) -> Action:
    """Change the speed of each rotor by up to 5 % of that of hover.

    This is the action of HoverAviary in gym-pybullet-drones. It is for multirotors.

    Raises:
        ValueError: If an airframe has wings.
    """
    for airframe in context.airframes:
        if airframe.wings:
            raise ValueError(
                f"action 'hover_rpm' is for multirotors, and airframe {airframe.name!r} has wings: "
                f"use 'rotor'"
            )
    speeds = [airframe.hover_speed(context.gravity) for airframe in context.airframes]
    label, ones = ": 20 (rpm / hover rpm - 1)", np.ones(len(speeds))
    return _per_rotor(context, "hover_rpm", label, -1.0, ones, _decode_change, np.array(speeds))
