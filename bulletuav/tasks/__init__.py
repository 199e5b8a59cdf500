"""Tasks, one module each, and the classes and decorators to define them."""

import dataclasses
import inspect
import re
from collections.abc import Mapping
from typing import Any

from bulletuav.errors import finite, shown, unknown
from bulletuav.registry import find, names, require_declared
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.frame import Frame, Scene, Spawn, StepResult, TaskContext
from bulletuav.tasks.ingredients import block, end, reward

__all__ = [
    "Frame",
    "Scene",
    "Spawn",
    "StepResult",
    "Task",
    "TaskConfig",
    "TaskContext",
    "TaskSource",
    "block",
    "end",
    "find_task",
    "list_tasks",
    "require_task",
    "reward",
]

TaskSource = str | type[Task[Any]]
"""A task: its name, optionally with a version, `module:Name`, or its class"""
VERSIONED = re.compile(r"(\w+?)[-_]v(\d+)")
"""Pattern of a task name with the version of its environment"""
OPTIONS = "Options of environments go into defaults, options of the task alone into its Config. "
"""Hint in the error for an unknown attribute of a task class"""
NEEDED = ("name", "observation", "reward")
"""Attributes that every task class must define"""


def list_tasks() -> list[str]:
    """Return the names of all registered tasks."""
    return names("task")


def find_task(source: TaskSource) -> type[Task[Any]]:
    """Return the class of a task, given its name, `module:Name` or the class itself.

    A name may end with the version of its environment: "hover_v2" or "hover-v2".

    Raises:
        ValueError: If no task has this name or version (the message suggests similar names), or if
            the class is incomplete.
    """
    versioned = VERSIONED.fullmatch(source) if isinstance(source, str) else None
    kind: type[Task[Any]] = find("task", versioned[1] if versioned else source, _is_task)
    require_task(kind)
    if versioned and int(versioned[2]) != kind.version:
        raise ValueError(
            f"task {source!r}: this is version {kind.version} of {versioned[1]!r}, and results of "
            f"versions differ; ask for '{versioned[1]}-v{kind.version}', or install a package "
            f"that has the other"
        )
    return kind


def _is_task(found: Any) -> bool:
    return inspect.isclass(found) and issubclass(found, Task)


def require_task(kind: type[Task[Any]]) -> None:
    """Check that a class defines everything that a task needs.

    Raises:
        ValueError: If an attribute or method is missing or invalid; the message names it.
    """
    name = kind.__name__
    missing = [one for one in NEEDED if getattr(kind, one, None) in (None, ())]
    if lacks := sorted(kind.__abstractmethods__) or missing:
        raise ValueError(
            f"task {name} has no {lacks[0]}: every task needs it, see bulletuav.tasks.base.Task"
        )
    require_declared("task", kind, Task, OPTIONS)
    if not isinstance(kind.name, str):
        raise ValueError(f"name of task {name} is {shown(kind.name)}: a text is needed")
    options = kind.Config if dataclasses.is_dataclass(kind.Config) else None
    if options and "__dataclass_params__" not in vars(options) and options.__annotations__:
        raise ValueError(
            f"Config of task {name} is no dataclass: write @dataclass(frozen=True) above it"
        )
    fields = {field.name for field in dataclasses.fields(options)} if options else set()
    for field in ("d_safe", "weights"):
        if field not in fields:
            raise ValueError(
                f"Config of task {name} has no field {field}: derive it from "
                f"bulletuav.tasks.config.TaskConfig, as a frozen dataclass"
            )
    for one in ("defaults", "difficulties", "presets", "reward", "training_weights", "shows"):
        if not isinstance(getattr(kind, one), Mapping):
            raise ValueError(
                f"{one} of task {name} is {shown(getattr(kind, one))}: a dict is needed"
            )
    # A str would be read as a tuple of letters
    given = kind.observation
    for observed in given.values() if isinstance(given, Mapping) else (given,):
        if not isinstance(observed, list | tuple):
            raise ValueError(
                f"observation of task {name} is {shown(given)}: a tuple is needed, such as "
                f'("velocity",), or a dict with one for each team'
            )
    if not isinstance(kind.ends, list | tuple) or not all(map(callable, kind.ends)):
        raise ValueError(
            f"ends of task {name} are {shown(kind.ends)}: a tuple of functions is needed"
        )
    for one, changes in kind.difficulties.items():
        if not isinstance(changes, Mapping):
            raise ValueError(
                f"difficulty {one!r} of task {name} is {shown(changes)}: a dict is needed"
            )
    if not kind.difficulties:
        raise ValueError(f"difficulties of task {name} are empty: leave them out, or name one")
    _check_reward(kind)


def _check_reward(kind: type[Task[Any]]) -> None:
    for term, value in kind.reward.items():
        weight = value[1] if isinstance(value, tuple) and len(value) == 2 else value
        if isinstance(weight, bool) or not isinstance(weight, int | float):
            raise ValueError(
                f"reward of task {kind.__name__} has {term!r}: {shown(value)}; a weight, or "
                f"(term, weight), is needed"
            )
    for term, weight in vars(kind).get("training_weights", {}).items():
        where = f"training_weights of task {kind.__name__}"
        if term not in kind.reward:
            raise ValueError(f"{where}: {unknown('reward term', term, kind.reward)}")
        finite(f"{where}: weight of {term!r}", weight)
