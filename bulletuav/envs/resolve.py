"""From keyword arguments to checked options and the task's own config."""

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any, Literal

from bulletuav.envs.options import (
    MOST_COUNT,
    MOST_DRONES,
    MOST_NAMES,
    MOST_SIZE,
    MOST_WEIGHT,
    NAMED,
    SEVERAL,
    EnvOptions,
)
from bulletuav.envs.randomization import Randomization, known_uncertainties
from bulletuav.errors import UnknownOptionError, as_int, as_sequence, choose, finite, nearest, shown
from bulletuav.sensors.base import Sensor
from bulletuav.sensors.suite import known_sensors
from bulletuav.tasks.base import DEFAULTS, Task
from bulletuav.tasks.observations.base import Block
from bulletuav.vehicle.airframe import load_airframe


def resolve(task: type[Task[Any]], given: Mapping[str, Any]) -> tuple[EnvOptions, Any]:
    """Make common options and the task's config from keyword arguments.

    What is given goes before the preset's values, those before the difficulty's, those before the
    task's defaults.

    Raises:
        UnknownOptionError: There is no such option; a TypeError too. The nearest names are told.
        ValueError: A preset or difficulty is unknown (the nearest are told), or a value cannot be.
    """
    common = {field.name for field in dataclasses.fields(EnvOptions)}
    own = {field.name for field in dataclasses.fields(task.Config)}
    for name in given:
        if name not in common | own:
            raise UnknownOptionError(  # in the words of Python's own TypeError, which some wrappers look for
                f"unknown option of task {task.name!r}: unexpected keyword argument {name!r}: {nearest(name, common | own)}"
            )
    difficulty = given.get("difficulty", task.defaults.get("difficulty", "easy"))
    changes = choose("difficulty", difficulty, dict(task.difficulties))
    if given.get("preset") is not None and not task.presets:
        raise ValueError(f"preset is {shown(given['preset'])}: task {task.name!r} has none")
    preset = (
        {} if given.get("preset") is None else choose("preset", given["preset"], dict(task.presets))
    )
    usual = {**DEFAULTS, **task.defaults, **changes, **preset}
    for name in usual:
        choose(
            f"option among the defaults of task {task.name!r}:", name, dict.fromkeys(common | own)
        )
    values = {**usual, **given, "difficulty": difficulty}
    if isinstance(given.get("weights"), Mapping):
        values["weights"] = {**preset.get("weights", {}), **given["weights"]}
    for name in (
        "num_drones",
        "airframe",
        "action",
        "decision_hz",
        "horizon",
        "max_speed",
        "dynamics",
        "controller",
    ):
        if values.get(name, "") is None:
            raise ValueError(f"{name} is None: leave it out for the task's default")
    _make_lists(values)
    _find_airframes(values, given)
    known = known_uncertainties(known_sensors(values.get("sensors", ())))
    values["randomization"] = Randomization(values.get("randomization"), known)
    options = EnvOptions(**{name: value for name, value in values.items() if name in common})
    config = task.Config(**{name: value for name, value in values.items() if name in own})
    return options, _checked_config(config)


def _make_lists(values: dict[str, Any]) -> None:
    """Make tuples of the options that are lists, and of one name where there can be several."""
    for name in SEVERAL:
        if isinstance(values.get(name), str):
            values[name] = (values[name],)
        elif name in ("observation", "sensors") and _is_object(values.get(name)):
            values[name] = (values[name],)
        elif name in values and not _is_single(name, values[name]):
            values[name] = as_sequence(
                name, values[name], most=MOST_NAMES if name in NAMED else None
            )


def _is_object(value: Any) -> bool:
    """Tell whether one ingredient was given, and not several."""
    return callable(value) or isinstance(value, Sensor | Block)


def _is_single(name: str, value: Any) -> bool:
    return (name == "wind" and callable(value)) or (name == "observation" and value is None)


def _find_airframes(values: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Load an airframe for each drone; what nobody gave follows: how many drones there are, and the speed limit."""
    if isinstance(values["airframe"], list | tuple):
        if not values["airframe"]:
            raise ValueError("airframe is an empty list: give one airframe, or one for each drone")
        as_sequence("airframe", values["airframe"], most=MOST_DRONES)
        values["airframe"] = tuple(load_airframe(one) for one in values["airframe"])
        if "num_drones" not in given:
            values["num_drones"] = len(values["airframe"])
    else:
        as_int("num_drones", values["num_drones"], 1, MOST_DRONES)
        values["airframe"] = (load_airframe(values["airframe"]),) * values["num_drones"]
    if "max_speed" not in given:
        values["max_speed"] = min(
            finite("max_speed", values["max_speed"]),
            *(airframe.max_speed for airframe in values["airframe"]),
        )


def _checked_config(config: Any) -> Any:
    """A task's config with its numbers as its fields' types have them.

    A field's metadata may tell its "least" and "most". Raises ValueError for values that a field's type cannot hold; float
    fields are sizes, so not negative.
    """
    stored = {
        field.name: _checked(field, getattr(config, field.name))
        for field in dataclasses.fields(config)
        if field.init
    }
    if stored["d_safe"] == 0:
        raise ValueError("d_safe is 0: it must be above 0")
    return dataclasses.replace(config, **stored)


def _checked(field: dataclasses.Field, value: Any) -> Any:
    name, most = (
        field.name,
        field.metadata.get("most", MOST_COUNT if field.type is int else MOST_SIZE),
    )
    if field.type is int:
        return as_int(name, value, field.metadata.get("least", 1), most)
    if field.type is bool and not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: True or False is needed")
    if typing.get_origin(field.type) is Literal:
        choose(name, value, dict.fromkeys(typing.get_args(field.type)))
    elif field.type is float:
        value = finite(name, value, most=most)
        if value < 0:
            raise ValueError(f"{name} is {value:g}: it must not be negative")
    elif field.type == tuple[float, float]:
        return tuple(finite(name, number, most=most) for number in as_sequence(name, value, 2))
    elif name == "weights":
        if not isinstance(value, Mapping):
            raise ValueError(
                f"weights is {shown(value)}: a dict from reward terms to weights is needed"
            )
        return {
            term: finite(
                f"weights: weight of reward term {shown(term)}", one, -MOST_WEIGHT, MOST_WEIGHT
            )
            for term, one in value.items()
        }
    return value
