"""Discrete action types, which select one of several velocities."""

import itertools

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.control.actions.base import Action, ActionContext, Compiled, within_climb
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.registry import register

CHOICES = ("discrete", "discrete_27")
"""Names of the actions of this module"""


@kernel
def _decode(
    action: np.ndarray, commanded: np.ndarray, setpoint: np.ndarray, table: np.ndarray
) -> None:
    """Write the selected velocities of `table` (C, 3)."""
    for w in range(action.shape[0]):
        for i in range(action.shape[1]):
            choice = int(action[w, i, 0])
            for k in range(3):
                setpoint[w, i, k] = table[choice, k]
            setpoint[w, i, 3] = 0.0


def _directions(name: str, context: ActionContext, directions: np.ndarray) -> Action:
    """Create an action that selects a velocity at max_speed; the first direction is zero.

    Velocities that climb faster than max_climb are scaled down to it.
    """
    speed = context.max_speed
    drones = len(context.airframes)
    last = len(directions) - 1
    # Diagonals are as fast as the axes; to stay has length 0
    sizes = np.linalg.norm(directions, axis=1, keepdims=True)
    table = within_climb(speed * directions / np.maximum(sizes, 1), context.max_climb)
    label = f"0 stay, 1 to {last} a velocity of {speed:g} m/s"

    return Action(
        name=name,
        level=SetpointLevel.VELOCITY,
        labels=((label,),) * drones,
        low=np.zeros((drones, 1)),
        high=np.full((drones, 1), float(last)),
        decode=Compiled(_decode, 4, table),
        choices=last + 1,
    )


@register("action")
def discrete(context: ActionContext) -> Action:
    """Choose one of 7 velocities at max_speed.

    0 is to stay; 1, 2 are east, west; 3, 4 north, south; 5, 6 up, down.
    """
    signs = np.array([1, -1, 1, -1, 1, -1])[:, None]
    axes = np.repeat(np.eye(3), 2, axis=0) * signs
    return _directions("discrete", context, np.concatenate([np.zeros((1, 3)), axes]))


@register("action")
def discrete_27(context: ActionContext) -> Action:
    """Choose one of 27 velocities at max_speed.

    0 is to stay. Then comes every other (x, y, z) of -1, 0, 1, counted up with z the fastest.
    """
    moves = [move for move in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(move)]
    return _directions("discrete_27", context, np.array([(0.0, 0.0, 0.0), *moves]))
