"""Action types: the meaning of an agent's numbers, and their conversion to setpoints.

Each function that is registered as "action" makes one kind of action for the drones of an
`ActionContext`. Unless its docstring says otherwise, each number is from -1 to 1.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from bulletuav.control.actions.attitudes import attitude, rates
from bulletuav.control.actions.base import Action, ActionContext, ActionMaker, limit_norm
from bulletuav.control.actions.choices import CHOICES, discrete, discrete_27
from bulletuav.control.actions.mixed import mix_actions
from bulletuav.control.actions.motion import (
    acceleration,
    heading_speed,
    heading_speed_climb,
    target_position,
    turn_speed,
    velocity,
    velocity_increment,
)
from bulletuav.control.actions.rotors import hover_rpm, rotor, rpm
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import find
from bulletuav.vehicle.airframe import Airframe

__all__ = [
    "ACTIONS",
    "CHOICES",
    "LEVEL_ACTIONS",
    "Action",
    "ActionContext",
    "ActionMaker",
    "ActionNames",
    "action_names",
    "limit_norm",
    "make_action",
    "make_actions",
    "usable_action",
]

ACTIONS: Mapping[str, ActionMaker] = MappingProxyType(
    {
        maker.__name__: maker
        for maker in (
            velocity,
            velocity_increment,
            acceleration,
            heading_speed,
            heading_speed_climb,
            turn_speed,
            target_position,
            attitude,
            rates,
            rotor,
            rpm,
            hover_rpm,
            discrete,
            discrete_27,
        )
    }
)
"""Makers of the package's own actions, by name; read-only"""
ActionNames = str | tuple[str, ...] | Mapping[str, str]
"""Name of the action of all drones, a name for each drone, or names by team"""
LEVEL_ACTIONS: Mapping[SetpointLevel, str] = MappingProxyType(
    {
        SetpointLevel.POSITION: "target_position",
        SetpointLevel.VELOCITY: "velocity",
        SetpointLevel.ACCELERATION: "acceleration",
        SetpointLevel.ATTITUDE: "attitude",
        SetpointLevel.RATES: "rates",
        SetpointLevel.ROTOR: "rotor",
    }
)
"""Name of the plain action of each setpoint level; read-only"""


def make_action(source: str | ActionMaker, context: ActionContext) -> Action:
    """Make an action for the drones of an environment.

    Args:
        source: Name of an action, `module:name` of its maker, or the maker itself.
        context: Facts about the environment.

    Returns:
        The action.

    Raises:
        ValueError: If there is no such action; the message lists the nearest names.
    """
    maker: ActionMaker = find("action", source, callable)
    return maker(context)


def make_actions(names: Sequence[str], context: ActionContext) -> Action:
    """Make the action of drones that may differ in kind.

    Args:
        names: Name of each drone's action.
        context: Facts about the environment.

    Returns:
        The action of that name if all drones have the same one, else the mix of them.

    Raises:
        ValueError: If there is no such action, or discrete actions are mixed with others.
    """
    kinds = list(dict.fromkeys(names))
    if len(kinds) == 1:
        return make_action(kinds[0], context)
    part_of = [kinds.index(name) for name in names]
    parts = []
    for k, kind in enumerate(kinds):
        own = zip(context.airframes, part_of, strict=True)
        airframes = tuple(airframe for airframe, part in own if part == k)
        parts.append(make_action(kind, dataclasses.replace(context, airframes=airframes)))
    return mix_actions(names, parts, part_of)


def action_names(action: ActionNames) -> tuple[str, ...]:
    """List the different names in an option `action`, in the order in which they are given."""
    if isinstance(action, str):
        return (action,)
    return tuple(dict.fromkeys(action.values() if isinstance(action, Mapping) else action))


def usable_action(action: str, airframes: Sequence[Airframe], consumes: SetpointLevel) -> str:
    """Return the default action of a task for a dynamics.

    Args:
        action: Name of the task's default action.
        airframes: Airframe of each drone.
        consumes: Setpoint level that drives the dynamics.

    Returns:
        The same action if the dynamics can be driven by its setpoints, directly or through the
        controllers. Otherwise the action of the level that the dynamics consumes, which is the
        nearest to the task's own.

    Raises:
        ValueError: If there is no such action; the message lists the nearest names.
    """
    # No action's level depends on speeds, the arena or gravity
    context = ActionContext(airframes, 1.0, 1.0, -np.ones(3), np.ones(3), 1.0, 1.0)
    return action if make_action(action, context).level <= consumes else LEVEL_ACTIONS[consumes]
