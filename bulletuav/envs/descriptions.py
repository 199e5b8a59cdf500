"""Descriptions of a simulation: as JSON values, and as texts that can be compared."""

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from bulletuav.city.model import City
from bulletuav.envs.bodies import describe_bodies
from bulletuav.envs.options import EnvOptions
from bulletuav.geometry.solids import Solids
from bulletuav.network.mobility.base import Mobility
from bulletuav.sensors.suite import find_sensor
from bulletuav.tasks.base import Task
from bulletuav.tasks.observations.observer import observation_name
from bulletuav.vehicle.airframe import Airframe
from bulletuav.version import __version__

WITHOUT_EFFECT = frozenset(
    {
        # They only set other options
        *("difficulty", "preset"),
        # Random generators are part of the state; a seed only initialises them
        "seed",
        # Rendering does not change the state
        *("render_mode", "render_size", "render_address"),
        # The same results, computed in Python
        "debug",
        "threads",
        # Infos only
        "action_masks",
    }
)
"""Options that do not change how a simulation continues from a given state"""
MAX_SHOWN_LENGTH = 60
"""Characters of a value that is written in full; longer ones are written as a hash"""


def describe_options(options: EnvOptions, config: Any) -> dict[str, Any]:
    """Return all options of an environment as values that JSON can store.

    Args:
        options: Common options.
        config: Config of the task, a dataclass.

    Returns:
        Values by name; airframes, cities, mobility models and functions are replaced by their
        names.
    """
    ranges = options.randomization.ranges
    random = {name: ranges[name] for name in options.randomization.active}
    own = {one.name: getattr(config, one.name) for one in dataclasses.fields(config)}
    city = own.get("city")
    if isinstance(city, City | Path):
        own["city"] = getattr(city, "name", "")
    mobility = own.get("mobility")
    if isinstance(mobility, Mobility):
        own["mobility"] = {"model": mobility.name, **dataclasses.asdict(cast(Any, mobility))}
    return {
        **vars(options),
        "airframe": [airframe.name for airframe in options.airframe],
        "wind": "function" if callable(options.wind) else options.wind,
        "randomization": random,
        "bodies": describe_bodies(options.bodies),
        "events": [event.described() for event in options.events],
        "communication": options.communication and options.communication.described(),
        "thermals": options.thermals and dataclasses.asdict(options.thermals),
        "dynamics": options.dynamics_name,
        "observation": _observed_names(options.observation),
        "sensors": [find_sensor(one).name for one in options.sensors],
        "reward": {
            name: (observation_name(term), weight)
            for name, (term, weight) in options.reward.items()
        },
        **own,
    }


def _observed_names(observation: Any) -> Any:
    """Return the names of the blocks of an observation, or of that of each team."""
    if isinstance(observation, Mapping):
        return {team: _observed_names(one) for team, one in observation.items()}
    return observation and [observation_name(one) for one in observation]


def describe_parts(
    options: EnvOptions, task: Task[Any] | None = None, **made: Any
) -> dict[str, str]:
    """Describe everything that a simulation is made from, except for `WITHOUT_EFFECT`.

    Args:
        options: Common options.
        task: The task with its config; None if there is none.
        **made: Further components by name.

    Returns:
        A text for each component, by the names of the options. Components with equal texts are
        equal. "airframe.mass" and the like are the numbers of airframes.
    """
    names = vars(options) if task is None else describe_options(options, task.config)
    values = {one.name: getattr(options, one.name) for one in dataclasses.fields(options)}
    if task is not None:
        values |= {
            one.name: getattr(task.config, one.name) for one in dataclasses.fields(task.config)
        }
        values |= {"obstacles": task.obstacles(), "layouts": faces_of(task.layouts())}
        values["arena"] = (task.arena_low, task.arena_high)
    values |= made
    # Only active randomization matters; airframes are described by their numbers below
    ranges = options.randomization.ranges
    values["randomization"] = {name: ranges[name] for name in options.randomization.active}
    airframes = values.pop("airframe")
    parts = {"bulletuav": __version__, "airframe": _shown([one.name for one in airframes])}
    if task is not None:
        parts |= {"task": task.name, "task.code": _digest(canonical_text(type(task)))}
    for field in dataclasses.fields(Airframe):
        if field.name != "urdf":  # the numbers count, not where the file is
            values[f"airframe.{field.name}"] = [getattr(one, field.name) for one in airframes]
    for name in sorted(values.keys() - WITHOUT_EFFECT):
        parts[name] = _shown(values[name], names.get(name))
    return parts


def faces_of(layouts: Sequence[Solids]) -> list[list[np.ndarray]]:
    """Return the faces of cities, by which cities are compared."""
    return [[corners for corners, _ in solids.faces] for solids in layouts]


def _shown(value: Any, name: Any = None) -> str:
    """Return a value as text; if that is long, its name and a hash."""
    texts = {canonical_text(one) for one in value} if isinstance(value, list) else set()
    # All drones have the same value
    text = texts.pop() if len(texts) == 1 else canonical_text(value)
    if len(text) <= MAX_SHOWN_LENGTH:
        return text
    named = "" if name is None else repr(name)
    return f"{named[:MAX_SHOWN_LENGTH]} (hash {_digest(text)})".strip()


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=6).hexdigest()


def canonical_text(value: Any, within: tuple[int, ...] = ()) -> str:
    """Return a value as text, so that equal values have equal texts in every process.

    Code is represented by its source file, with the defaults and closure of a function; objects by
    their class and attributes; arrays by their numbers; paths by their last name.

    Args:
        value: The value.
        within: Identities of the objects that contain the value.
    """
    if value is None or isinstance(value, bool | int | float | str | bytes | np.generic):
        return repr(value.item() if isinstance(value, np.generic) else value)
    if isinstance(value, Path):
        return repr(value.name)
    if isinstance(value, np.ndarray) and value.dtype != object:
        digest = hashlib.blake2b(np.ascontiguousarray(value).tobytes(), digest_size=8).hexdigest()
        return f"array {value.dtype.str} {value.shape} {digest}"
    # An object that contains itself
    if id(value) in within:
        return "itself"
    inner = functools.partial(canonical_text, within=(*within, id(value)))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{inner(k)}: {inner(one)}" for k, one in value.items()) + "}"
    if isinstance(value, set | frozenset):
        return "{" + ", ".join(sorted(map(inner, value))) + "}"
    if isinstance(value, list | tuple):
        return "(" + ", ".join(map(inner, value)) + ")"
    if inspect.isroutine(value) or inspect.isclass(value):
        cells = [one.cell_contents for one in getattr(value, "__closure__", None) or ()]
        made = [*cells, getattr(value, "__defaults__", None), getattr(value, "__self__", None)]
        name: str = value.__qualname__
        return f"{name} {_source(cast(Any, value))} {inner(made)}"
    kind: Any = type(value)
    if dataclasses.is_dataclass(value):
        own = {one.name: getattr(value, one.name) for one in dataclasses.fields(value)}
    elif hasattr(value, "__dict__"):
        cached = functools.cached_property
        own = {k: v for k, v in vars(value).items() if not isinstance(vars(kind).get(k), cached)}
    else:
        own = {"pickled": None}
        with contextlib.suppress(Exception):
            own["pickled"] = pickle.dumps(value, protocol=5)
    return f"{kind.__qualname__} {_source(kind)} {inner(own)}"


@functools.lru_cache(maxsize=1024)
def _source(code: Any) -> str:
    """Return a hash of the source file of a class or function; empty if there is none."""
    with contextlib.suppress(OSError, TypeError):
        return hashlib.blake2b(Path(inspect.getfile(code)).read_bytes(), digest_size=8).hexdigest()
    return ""
