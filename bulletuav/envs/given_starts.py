"""Starts of episodes that users set in a reset."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import find_dynamics
from bulletuav.envs.airspace_inputs import require_motion, require_unit
from bulletuav.envs.options import EnvOptions
from bulletuav.errors import numbers_of, shown
from bulletuav.tasks.base import Task
from bulletuav.tasks.given import CHARGE, MOTIONS, PLACES, GivenMotion, GivenPositions, GivenStart
from bulletuav.tasks.starts import read_given_positions

STARTS = (*PLACES, *MOTIONS, CHARGE)
"""Options of a reset that set the start of episodes"""
WIDTHS = {"quaternion": (4,), CHARGE: ()}
"""Shapes of the values of a drone; (3,) for others"""


def read_given_starts(
    task: Task[Any],
    options: EnvOptions,
    usual: GivenPositions,
    worlds: Sequence[int],
    num_worlds: int,
    given: Mapping[str, Any],
) -> list[GivenStart]:
    """Convert and validate what a user sets at the start of episodes.

    Args:
        task: The task.
        options: Options of the environment.
        usual: Positions from the task's options, where a reset gives none.
        worlds: Indices of the S worlds that start.
        num_worlds: W.
        given: Values of `STARTS` by name, for all worlds or with a row for each of the W worlds;
            None for those that are not set.

    Returns:
        The start of each of the S worlds.

    Raises:
        ValueError: If a value is invalid, or has no effect in this task.
    """
    rows = {
        name: split_worlds(name, value, options.num_drones, num_worlds)
        for name, value in given.items()
        if value is not None
    }
    _require_effects(task, options, rows)
    starts: dict[tuple[int, ...], GivenStart] = {}
    found = []
    for world in worlds:
        own = {name: values[min(world, len(values) - 1)] for name, values in rows.items()}
        # Values for all worlds are checked once
        key = tuple(map(id, own.values()))
        if key not in starts:
            starts[key] = _read_world(task, usual, own)
        found.append(starts[key])
    return found


def split_worlds(name: str, value: Any, num_drones: int, num_worlds: int) -> list[np.ndarray]:
    """Split a value of a reset by worlds.

    Args:
        name: One of `STARTS`.
        value: (N, ...) for all worlds, or (W, N, ...).
        num_drones: N.
        num_worlds: W.

    Returns:
        One array (N, ...), or W arrays.

    Raises:
        ValueError: If the value has another shape, or is not numeric.
    """
    array = numbers_of(f"{name} is", value)
    shape = (num_drones, *WIDTHS.get(name, (3,)))
    if array.shape == shape:
        return [array]
    if array.shape == (num_worlds, *shape):
        return list(array)
    raise ValueError(
        f"{name} is {shown(value)}: numbers of shape {shape} for all worlds, or "
        f"{(num_worlds, *shape)} with a row for each world, are needed"
    )


def _read_world(
    task: Task[Any], usual: GivenPositions, given: Mapping[str, np.ndarray]
) -> GivenStart:
    """Validate what is set in one world; see `read_given_starts`."""
    for name, check in _CHECKS.items():
        if name in given:
            check(name, given[name])
    positions = read_given_positions(task, *(given.get(name) for name in PLACES))
    places = (b if a is None else a for a, b in zip(positions, usual, strict=True))
    motion = {name: given[name] for name in MOTIONS if name in given}
    if "quaternion" in motion:
        turn = motion["quaternion"]
        motion["quaternion"] = turn / np.sqrt((turn * turn).sum(axis=-1, keepdims=True))
    return GivenStart(GivenPositions(*places), GivenMotion(**motion), given.get(CHARGE))


def _require_effects(
    task: Task[Any], options: EnvOptions, given: Mapping[str, list[np.ndarray]]
) -> None:
    """Raise ValueError for values by world that would have no effect."""
    moving = [name for name in MOTIONS if name in given]
    if moving and task.takes_off:
        raise ValueError(
            f"{moving[0]} cannot be given in task {task.name!r}: its drones start level and at "
            f"rest on the ground; leave it out"
        )
    if "velocity" in given and options.dynamics_name == "single_integrator":
        raise ValueError(
            "velocity has no effect in dynamics 'single_integrator', which flies as commanded: "
            "leave it out, or use other dynamics"
        )
    consumes: object = find_dynamics(options.dynamics).consumes
    rotates = not isinstance(consumes, SetpointLevel) or consumes == SetpointLevel.ROTOR
    for name in ("quaternion", "rates"):
        if name in given and not rotates:
            raise ValueError(
                f"{name} has no effect in dynamics {options.dynamics_name!r}, whose drones do not "
                f"rotate: leave it out, or use 'rigid_body' or 'bullet'"
            )
    if CHARGE in given and options.battery_capacity is None:
        raise ValueError(
            "charge has no effect without the option battery_capacity: set it in W h, or to "
            "'airframe'"
        )


def _require_charge(name: str, values: np.ndarray) -> None:
    """Raise ValueError for charges (N,) that are no fraction of a full battery."""
    if not ((values > 0) & (values <= 1)).all():
        raise ValueError(f"{name} is {shown(values)}: above 0 and at most 1 is needed")


_CHECKS = {
    "velocity": require_motion,
    "rates": require_motion,
    "quaternion": require_unit,
    CHARGE: _require_charge,
}
