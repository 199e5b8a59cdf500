"""Tasks: one file each, found by themselves; those of other packages by their entry points."""

import dataclasses
import importlib
import importlib.metadata
import inspect
import pkgutil
import warnings
from collections.abc import Mapping
from functools import cache

from bulletuav.errors import choose, shown
from bulletuav.tasks.base import Task

TaskSource = str | type[Task]
"""A task by its name, or its class"""
NEEDED = ("name", "Config", "defaults", "difficulties", "observation", "reward_weights")
"""Attributes that every task class has"""
ENTRY_POINTS = "bulletuav.tasks"
"""Group of entry points by which other packages tell of their tasks"""


@cache
def _tasks() -> dict[str, type[Task]]:
    modules = [
        importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)
    ]
    found = [
        value
        for module in modules
        for value in vars(module).values()
        if inspect.isclass(value)
        and issubclass(value, Task)
        and value.__module__ == module.__name__ != Task.__module__
    ]
    tasks = {task.name: task for task in found}
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        try:
            task = point.load()
            if not (inspect.isclass(task) and issubclass(task, Task)) or task.name in tasks:
                raise TypeError(f"{task!r} is not a task of a new name")
            tasks[task.name] = task
        except Exception as error:  # whatever another package does, our tasks stay
            warnings.warn(
                f"entry point {point.name!r} of {ENTRY_POINTS} is left out: {error}", stacklevel=2
            )
    return dict(sorted(tasks.items()))


def list_tasks() -> list[str]:
    """Names of all tasks."""
    return list(_tasks())


def require_task(kind: type[Task]) -> None:
    """Raise ValueError, naming what is missing, unless a class has what a task is made of."""
    name = kind.__name__
    lacks = sorted(kind.__abstractmethods__) or [
        one for one in NEEDED if getattr(kind, one, None) in (None, ())
    ]
    if lacks:
        raise ValueError(
            f"task {name} has no {lacks[0]}: a task needs it, see bulletuav.tasks.base.Task"
        )
    if not isinstance(kind.name, str):
        raise ValueError(f"name of task {name} is {shown(kind.name)}: a text is needed")
    fields = (
        {field.name for field in dataclasses.fields(kind.Config)}
        if dataclasses.is_dataclass(kind.Config)
        else set()
    )
    for field in ("d_safe", "weights"):
        if field not in fields:
            raise ValueError(
                f"Config of task {name} has no field {field}: a dataclass with d_safe and weights is needed"
            )
    for one in ("defaults", "difficulties", "presets", "reward_weights"):
        if not isinstance(getattr(kind, one), Mapping):
            raise ValueError(
                f"{one} of task {name} is {shown(getattr(kind, one))}: a dict is needed"
            )


def find_task(task: TaskSource) -> type[Task]:
    """The task of that name, or the class itself. Raises ValueError with the nearest names when there is none."""
    if inspect.isclass(task) and issubclass(task, Task):
        require_task(task)
        return task
    return choose("task", task, _tasks())
