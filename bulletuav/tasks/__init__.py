"""Tasks: one file each, found by themselves."""

import importlib
import inspect
import pkgutil
from functools import cache

from bulletuav.errors import pick
from bulletuav.tasks.base import Task


@cache
def _tasks() -> dict[str, type[Task]]:
    modules = [importlib.import_module(f"{__name__}.{m.name}") for m in pkgutil.iter_modules(__path__)]
    found = [
        value
        for module in modules
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, Task) and not inspect.isabstract(value)
    ]
    return {task.name: task for task in sorted(found, key=lambda task: task.name)}


def list_tasks() -> list[str]:
    """Names of all tasks."""
    return list(_tasks())


def find_task(name: str) -> type[Task]:
    """The task of that name. Raises ValueError with the nearest names when there is none."""
    return pick("task", name, _tasks())
