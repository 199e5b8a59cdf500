"""Convert keyword arguments to validated options and the task's config."""

import dataclasses
import typing
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from bulletuav.control.actions import usable_action
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.dynamics import default_dynamics, find_dynamics
from bulletuav.dynamics.base import Dynamics
from bulletuav.envs.options import (
    LIST_OPTIONS,
    MAX_COUNT,
    MAX_DRONES,
    MAX_NAMES,
    MAX_SIZE,
    MAX_WEIGHT,
    NAME_LISTS,
    EnvOptions,
)
from bulletuav.envs.randomization import Randomization, known_uncertainties
from bulletuav.errors import (
    UnknownOptionError,
    as_int,
    as_sequence,
    find_choice,
    finite,
    shown,
    suggest_names,
)
from bulletuav.sensors.base import Sensor
from bulletuav.sensors.suite import known_sensors
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import DEFAULTS, TaskConfig
from bulletuav.tasks.observations.base import Block
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.airframes import load_airframe
from bulletuav.vehicle.cruise import limiting_airframe, top_speed

NEVER_NONE = (
    "num_drones",
    "airframe",
    "action",
    "decision_hz",
    "horizon",
    "max_speed",
    "dynamics",
    "controller",
)
"""Options that must be left out, instead of None, for the task's default"""
INGREDIENTS = ("observation", "sensors")
"""Lists of names or objects"""


class ResolvedOptions(NamedTuple):
    """Result of `resolve_options`.

    Attributes:
        options: Common options.
        config: Config of the task.
        sensors: All available sensors, by name.
    """

    options: EnvOptions
    config: TaskConfig
    sensors: dict[str, Sensor]


def resolve_options(task: type[Task[Any]], given: Mapping[str, Any]) -> ResolvedOptions:
    """Create common options and the task's config from keyword arguments.

    Given values override those of the preset, which override those of the difficulty, which
    override the task's defaults. If no action is given and the dynamics does not support the
    default, the action of the highest setpoint level that the dynamics supports is used.

    Args:
        task: The task.
        given: Options by name, of both kinds.

    Returns:
        The common options, the task's config, and the sensors.

    Raises:
        UnknownOptionError: If there is no such option; the message suggests similar names. It is a
            TypeError, too.
        ValueError: If a preset or difficulty is unknown (the message suggests similar names), or a
            value is invalid.
    """
    common = {field.name for field in dataclasses.fields(EnvOptions)}
    own = {field.name for field in dataclasses.fields(task.Config)}
    values = _with_defaults(task, given, common | own)
    for name in NEVER_NONE:
        if values.get(name, "") is None:
            raise ValueError(f"{name} is None: leave it out for the task's default")
    if "dynamics" not in values:
        values["dynamics"] = default_dynamics(values.get("contacts"))
    make_tuples(values)
    _split_range(values)
    _load_airframes(values, given)
    _fit_forward_flight(task, values, given)
    if "action" not in given and isinstance(values["action"], str):
        values["action"] = action_for(values["dynamics"], values["action"], values["airframe"])
    sensors = known_sensors(values.get("sensors", ()))
    known = known_uncertainties(sensors)
    values["randomization"] = Randomization(values.get("randomization"), known)
    # `EnvOptions` validates itself; the task's config is validated by the types of its fields
    for_all = {name: value for name, value in values.items() if name in common}
    for_task = {name: value for name, value in values.items() if name in own}
    options = EnvOptions(**for_all)
    config = _validate_config(task.Config(**for_task))
    # A task's config may be any dataclass
    idle = config.idle_options(options.num_drones) if isinstance(config, TaskConfig) else {}
    for name, reason in idle.items():
        if name in given:
            raise ValueError(
                f"{name} is {shown(given[name])}, which has no effect, as {reason}: leave it out"
            )
    return ResolvedOptions(options, config, sensors)


def _with_defaults(
    task: type[Task[Any]], given: Mapping[str, Any], known: set[str]
) -> dict[str, Any]:
    """Add the values of preset, difficulty and task to the given options."""
    for name in given:
        if name not in known:
            # Some wrappers search for these words of Python's own TypeError
            raise UnknownOptionError(
                f"unknown option of task {task.name!r}: unexpected keyword argument {name!r}: "
                f"{suggest_names(name, known)}"
            )
    first = "easy" if "easy" in task.difficulties else next(iter(task.difficulties))
    usual_difficulty = task.defaults.get("difficulty", first)
    difficulty = given.get("difficulty", usual_difficulty)
    changes = find_choice("difficulty", difficulty, dict(task.difficulties))
    preset: Mapping[str, Any] = {}
    if given.get("preset") is not None:
        if not task.presets:
            raise ValueError(f"preset is {shown(given['preset'])}: task {task.name!r} has none")
        preset = find_choice("preset", given["preset"], dict(task.presets))
    # Later ones override earlier ones
    usual = {**DEFAULTS, **task.defaults, **changes, **preset}
    for name in usual:
        find_choice(f"option among the defaults of task {task.name!r}:", name, dict.fromkeys(known))
    values = {**usual, **given, "difficulty": difficulty}
    # Weights for training override those of the preset one by one, and given weights both
    weights = {**preset.get("weights", {}), **_named_weights(task, values)}
    if isinstance(given.get("weights", {}), Mapping):
        values["weights"] = {**weights, **given.get("weights", {})}
    return values


def _named_weights(task: type[Task[Any]], values: dict[str, Any]) -> dict[str, float]:
    """Replace the name of a reward in the options by no additional terms; return its weights."""
    if not isinstance(values.get("reward"), str):
        return {}
    # A task that replaces the reward terms of its base class inherits the weights of the others
    training = {name: one for name, one in task.training_weights.items() if name in task.reward}
    choices: dict[str, dict[str, float]] = {"benchmark": {}, "training": training}
    return find_choice("reward", values.pop("reward"), choices)


def make_tuples(values: dict[str, Any]) -> None:
    """Convert list options to tuples, including single entries of such lists."""
    for name in LIST_OPTIONS:
        value = values.get(name)
        if name == "observation" and isinstance(value, Mapping):
            values[name] = {team: _listed(name, one) for team, one in value.items()}
        elif name in values and not _is_unlisted(name, value):
            values[name] = _listed(name, value)


def _listed(name: str, value: Any) -> tuple[Any, ...]:
    """Convert the value of a list option to a tuple."""
    if isinstance(value, str) or (name in INGREDIENTS and _is_ingredient(value)):
        return (value,)
    return as_sequence(name, value, most=MAX_NAMES if name in NAME_LISTS else None)


def _is_ingredient(value: Any) -> bool:
    """Return True for a single object instead of a list."""
    return callable(value) or isinstance(value, Sensor | Block)


def _is_unlisted(name: str, value: Any) -> bool:
    """Return True if an option that can be a list has a valid value that is not a list."""
    return (name == "wind" and callable(value)) or (name == "observation" and value is None)


def _split_range(values: dict[str, Any]) -> None:
    """Split num_drones=(min, max) into num_drones and min_drones."""
    given = values["num_drones"]
    if not isinstance(given, list | tuple):
        return
    if values.get("min_drones") is not None:
        raise ValueError(
            f"min_drones is {shown(values['min_drones'])}, and num_drones {shown(given)} sets it, "
            f"too: leave min_drones out"
        )
    low, high = (
        as_int("num_drones", one, 1, MAX_DRONES) for one in as_sequence("num_drones", given, 2)
    )
    if low > high:
        raise ValueError(f"num_drones is {shown(given)}: from low to high is needed")
    values["num_drones"], values["min_drones"] = high, low


def _load_airframes(values: dict[str, Any], given: Mapping[str, Any]) -> None:
    """Load an airframe for each drone.

    The airframes determine the number of drones and the speed limit if these are not given.
    """
    several = isinstance(values["airframe"], list | tuple)
    if not several:
        as_int("num_drones", values["num_drones"], 1, MAX_DRONES)
    values["airframe"] = load_airframes(values["airframe"], values["num_drones"])
    if any(one.is_load for one in values["airframe"]):
        raise ValueError("airframe is a load, without rotors: only an Airspace has loads")
    if several and "num_drones" not in given:
        values["num_drones"] = len(values["airframe"])
    if "max_speed" not in given:
        limit = finite("max_speed", values["max_speed"])
        values["max_speed"] = min(limit, top_speed(limiting_airframe(values["airframe"])))


def _fit_forward_flight(
    task: type[Task[Any]], values: dict[str, Any], given: Mapping[str, Any]
) -> None:
    """Fit a task's sizes to aircraft that cannot hover; given ones and those of a preset stay.

    Raises:
        ValueError: If the task is not for such aircraft.
    """
    forward = [one for one in values["airframe"] if one.needs_airspeed]
    if not forward:
        return
    name = forward[0].name
    if task.needs_hover:
        fit = [one for one in list_tasks() if not find_task(one).needs_hover]
        raise ValueError(
            f"airframe {name!r} cannot hover, as task {task.name!r} needs: choose an airframe that "
            f"hovers, or another task: {', '.join(fit)}, or your own with needs_hover = False"
        )
    if values.get("take_off"):
        raise ValueError(
            f"take_off is True, and airframe {name!r} cannot take off from its start: leave "
            f"take_off out, and it starts in flight"
        )
    # Sizes are computed from these before all options are checked
    for option in ("num_drones", "horizon", "decision_hz", "max_speed"):
        finite(option, values[option])
    preset = task.presets.get(given.get("preset") or "", {})
    # The name of a reward has become weights
    kept = {name: values[name] for name in (*preset, *given) if name in values}
    values |= {**task.forward_options(forward, values, kept), **kept}


def action_for(dynamics: str | type[Dynamics], action: str, airframes: Sequence[Airframe]) -> str:
    """Return an action if the dynamics supports it, else the nearest that it supports.

    Args:
        dynamics: The dynamics, by name or class.
        action: Name of the preferred action.
        airframes: Airframe of each drone.

    Returns:
        The same action, or if the dynamics does not support its setpoints, the action of the
        highest level that the dynamics supports.

    Raises:
        ValueError: If there is no such dynamics or action.
    """
    # If the level is a property, only the instance of an environment has it
    level: object = find_dynamics(dynamics).consumes
    if not isinstance(level, SetpointLevel) or level == SetpointLevel.ROTOR:
        return action
    return usable_action(action, airframes, level)


def load_airframes(airframe: Any, count: int) -> tuple[Airframe, ...]:
    """Load the airframe of each drone.

    Args:
        airframe: One for all, or a list with one for each.
        count: Number of drones that share one.

    Returns:
        One for each drone; for a list, as many as it has.

    Raises:
        ValueError: If there is no such airframe, or the list is empty.
    """
    if not isinstance(airframe, list | tuple):
        return (load_airframe(airframe),) * count
    if not airframe:
        raise ValueError("airframe is an empty list: give one airframe, or one for each drone")
    as_sequence("airframe", airframe, most=MAX_DRONES)
    return tuple(load_airframe(one) for one in airframe)


def _validate_config(config: TaskConfig) -> TaskConfig:
    """Validate a task's config, with numbers converted to the types of its fields.

    Raises:
        ValueError: If a value is invalid.
    """
    kinds = typing.get_type_hints(type(config))  # also where annotations are postponed
    # A field that a subclass declares again, for another default, keeps its bounds
    bounds: dict[str, dict[str, Any]] = {}
    for kind in reversed(type(config).__mro__):
        for name, field in vars(kind).get("__dataclass_fields__", {}).items():
            # Other keys are the author's own
            given = {key: field.metadata[key] for key in field.metadata.keys() & {"least", "most"}}
            bounds.setdefault(name, {}).update(given)
    stored = {
        field.name: _validate(
            field.name, kinds[field.name], getattr(config, field.name), **bounds[field.name]
        )
        for field in dataclasses.fields(config)
        if field.init
    }
    if stored["d_safe"] == 0:
        raise ValueError("d_safe is 0: it must be above 0")
    return dataclasses.replace(config, **stored)


def _validate(name: str, kind: Any, value: Any, least: int = 1, most: Any = None) -> Any:
    """Validate the value of a field by its type; float fields are sizes, so not negative.

    Args:
        name: Name of the field.
        kind: Its type.
        value: Its value.
        least: Minimum of an integer.
        most: Maximum of a number; by default `MAX_COUNT` or `MAX_SIZE`.
    """
    if most is None:
        most = MAX_COUNT if kind is int else MAX_SIZE
    if kind is int:
        return as_int(name, value, least, most)
    if kind is bool and not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: True or False is needed")
    # Values of other types are validated where they are used
    if typing.get_origin(kind) is Literal:
        find_choice(name, value, dict.fromkeys(typing.get_args(kind)))
    elif kind is float:
        value = finite(name, value, most=most)
        if value < 0:
            raise ValueError(f"{name} is {value:g}: it must not be negative")
    elif kind == tuple[float, float]:
        return tuple(finite(name, number, most=most) for number in as_sequence(name, value, 2))
    elif name == "weights":
        return _validate_weights(value)
    return value


def _validate_weights(weights: Any) -> dict[str, float]:
    if not isinstance(weights, Mapping):
        raise ValueError(
            f"weights is {shown(weights)}: a dict from reward terms to weights is needed"
        )
    return {
        term: finite(
            f"weights: weight of reward term {shown(term)}", weight, -MAX_WEIGHT, MAX_WEIGHT
        )
        for term, weight in weights.items()
    }
