"""Setpoints that users give to an airspace: their levels and numbers, checked and held."""

import contextlib
from typing import Any

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics.setpoints import CONVERTED
from bulletuav.envs.agents import in_c
from bulletuav.envs.airspace_inputs import YAW, numbers
from bulletuav.envs.options import EnvOptions
from bulletuav.errors import find_choice

LEVELS = {one.name.lower(): one for one in SetpointLevel}
"""Setpoint levels by name"""


def level_of(
    level: Any,
    consumes: SetpointLevel,
    options: EnvOptions,
) -> SetpointLevel:
    """Take a setpoint level, or its name, that drones can be told.

    Args:
        level: What was given.
        consumes: What the dynamics consumes.
        options: Options of the airspace.

    Returns:
        The level.

    Raises:
        ValueError: There is no such level, or it cannot drive the dynamics.
    """
    if isinstance(level, SetpointLevel):
        chosen = level
    elif isinstance(level, np.integer) and level in LEVELS.values():  # as `levels` tells it
        chosen = SetpointLevel(int(level))
    else:
        chosen = find_choice(
            "setpoint level", level.lower() if isinstance(level, str) else level, LEVELS
        )
    # Nothing leads up: a dynamics of points has no attitude to command
    if chosen > consumes:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints: "
            f"command that level or one above it, not {chosen.name}; or use 'rigid_body', 'bullet'"
        )
    # Own dynamics may consume levels that no controller gives
    if chosen != consumes and consumes not in CONVERTED:
        raise ValueError(
            f"dynamics {options.dynamics_name!r} is driven by {consumes.name.lower()} setpoints, "
            f"to which no controller leads: command {consumes.name}"
        )
    # Controllers of rotors tilt thrust against the weight
    if chosen < consumes == SetpointLevel.ROTOR:
        if options.gravity == 0:
            raise ValueError(
                f"setpoints of {chosen.name} need gravity, against which thrust is steered: "
                f"without it command ROTOR"
            )
        options.check_controller(chosen)
    return chosen


def usual_widths(
    consumes: SetpointLevel,
    options: EnvOptions,
    rotors: int,
) -> dict[SetpointLevel, int]:
    """Tell the levels that drones can be told with no more ado, and how many numbers each has.

    Args:
        consumes: What the dynamics consumes.
        options: Options of the airspace.
        rotors: How many rotors setpoints are for.
    """
    widths = {}
    for level in SetpointLevel:
        with contextlib.suppress(ValueError):
            widths[level_of(level, consumes, options)] = YAW + 1
    if SetpointLevel.ROTOR in widths:
        widths[SetpointLevel.ROTOR] = rotors
    if options.controller == "pid":  # what it has summed up is to be forgotten
        widths.pop(SetpointLevel.ROTOR, None)
    return widths


def hold_plainly(
    levels: np.ndarray,
    setpoint: np.ndarray,
    told: np.ndarray,
    drones: Any,
    level: SetpointLevel,
    width: int,
    numbers: Any,
) -> bool:
    """Let drones hold a setpoint, if it is as usual: one or all, floats as they lie in memory.

    Args:
        levels: (1, N) that drones hold, written.
        setpoint: (1, N, S) that they hold, written.
        told: (1, N) bool, whether they were told any, written.
        drones: What was given.
        level: One of `usual_widths`.
        width: How many numbers it has; drones that hold a yaw already need not be told one.
        numbers: What was given.

    Returns:
        Whether it was done. Here nothing is, and all is left to the closer look that follows.
    """
    return False


hold = in_c(hold_plainly)


def setpoint_numbers(
    level: SetpointLevel,
    setpoint: Any,
    count: tuple[int, ...],
    rotors: int,
    speaks: bool,
) -> np.ndarray:
    """Take the numbers of a setpoint.

    Args:
        level: Its level.
        setpoint: What was given.
        count: (M,) for M drones, () for one.
        rotors: How many rotors setpoints are for, R.
        speaks: Whether a yaw or its rate is told beside it.

    Returns:
        Numbers that broadcast to (M, numbers of the level); without the yaw where it is left out.

    Raises:
        ValueError: They cannot be.
    """
    array, width = numbers("setpoint", setpoint), rotors
    # Three numbers and a yaw, which may be left out or told beside it
    if level < SetpointLevel.ROTOR:
        width = YAW + 1
        if level < SetpointLevel.ATTITUDE:
            width -= speaks or array.shape[-1:] == (YAW,)
        elif speaks:
            raise ValueError(
                f"yaw and yaw_rate go with POSITION, VELOCITY and ACCELERATION, not {level.name}"
            )
    # One setpoint for all, or one for each
    if array.shape != (width,) and array.shape != (*count, width):
        twice = "; the yaw is told beside it" if speaks else ""
        raise ValueError(
            f"setpoint of {level.name} has shape {array.shape}: {(*count, width)} is needed{twice}"
        )
    return array
