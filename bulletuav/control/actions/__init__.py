"""Actions: meanings of the numbers that an agent gives, and how they become setpoints.

Each function that is registered as "action" makes one kind of action for the drones of an
`ActionContext`. Unless its docstring says otherwise, each number is from -1 to 1.
"""

from collections.abc import Mapping
from types import MappingProxyType

from bulletuav.control.actions.attitudes import attitude, rates
from bulletuav.control.actions.base import Action, ActionContext, ActionMaker, limit_norm
from bulletuav.control.actions.choices import CHOICES, discrete, discrete_27
from bulletuav.control.actions.motion import (
    acceleration,
    heading_speed,
    target_position,
    velocity,
    velocity_increment,
)
from bulletuav.control.actions.rotors import hover_rpm, rotor, rpm
from bulletuav.registry import find

__all__ = [
    "ACTIONS",
    "CHOICES",
    "Action",
    "ActionContext",
    "ActionMaker",
    "limit_norm",
    "make_action",
]

ACTIONS: Mapping[str, ActionMaker] = MappingProxyType(
    {
        maker.__name__: maker
        for maker in (
            velocity,
            velocity_increment,
            acceleration,
            heading_speed,
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


def make_action(source: str | ActionMaker, context: ActionContext) -> Action:
    """Make an action for the drones of an environment.

    Args:
        source: Name of an action, `module:name` of its maker, or the maker itself.
        context: Facts about the environment.

    Returns:
        The action.

    Raises:
        ValueError: There is no such action; the nearest names are told.
    """
    maker: ActionMaker = find("action", source, callable)
    return maker(context)
