"""Tasks: one file each, found by themselves; those of other packages by their entry points."""

import importlib
import importlib.metadata
import inspect
import pkgutil
import warnings
from functools import cache

from bulletuav.errors import pick
from bulletuav.tasks.base import Task

TaskSource = str | type[Task]
"""A task by its name, or its class"""
ENTRY_POINTS = "bulletuav.tasks"
"""Group of entry points by which other packages tell of their tasks"""


@cache
def _tasks() -> dict[str, type[Task]]:
    modules = [importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)]
    found = [
        value
        for module in modules
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, Task) and value.__module__ == module.__name__ != Task.__module__
    ]
    tasks = {task.name: task for task in found}
    for point in importlib.metadata.entry_points(group=ENTRY_POINTS):
        try:
            task = point.load()
            if not (inspect.isclass(task) and issubclass(task, Task)) or task.name in tasks:
                raise TypeError(f"{task!r} is not a task of a new name")
            tasks[task.name] = task
        except Exception as error:  # whatever another package does, our tasks stay
            warnings.warn(f"entry point {point.name!r} of {ENTRY_POINTS} is left out: {error}", stacklevel=2)
    return dict(sorted(tasks.items()))


def list_tasks() -> list[str]:
    """Names of all tasks."""
    return list(_tasks())


def find_task(task: TaskSource) -> type[Task]:
    """The task of that name, or the class itself. Raises ValueError with the nearest names when there is none."""
    if inspect.isclass(task) and issubclass(task, Task):
        return task
    return pick("task", task, _tasks())
