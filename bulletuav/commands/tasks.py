"""`bulletuav tasks`: the list of tasks, or the MDP and options of one."""

import argparse
import dataclasses
import inspect
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table

from bulletuav.commands.arguments import add_options, given_options
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.options import EnvOptions
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.base import Task

ABOUT = {
    "help": "list the tasks, or print the MDP and options of one",
    "description": "List the tasks, or explain one.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the task, if any, and the options that its observation depends on."""
    parser.add_argument("task", nargs="?", help="print this task's MDP and options")
    parser.add_argument(
        "--observation",
        dest="show_observation",
        action="store_true",
        help="print what each number of an observation is, with the options given",
    )
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """List the tasks, or print one's MDP and options, or its observation."""
    if arguments.task is None:
        _print_list()
    elif arguments.show_observation:
        Console().print(observation_table(arguments.task, given_options(arguments)))
    else:
        _explain(arguments.task)


def observation_table(task: str, options: Mapping[str, Any]) -> Table:
    """Lay out what each number of an observation is.

    Args:
        task: Name of the task.
        options: Options of the environment, on which the observation depends.

    Returns:
        A table with the index, name, unit and bounds of each number, and a row for each picture.
    """
    spec = EnvSpec(task, 1, dict(options))
    table = Table(title=f"observation of {task}, one drone of {spec.options.num_drones}, float32")
    for heading in ("index", "number", "unit", "low", "high"):
        table.add_column(heading, justify="left" if heading in ("number", "unit") else "right")
    numbers = zip(spec.observer.labels, spec.observer.low, spec.observer.high, strict=True)
    # Numbers of the vector come first, each with its place in it; pictures have names instead.
    for index, (label, low, high) in enumerate(numbers):
        table.add_row(str(index), label.name, label.unit, f"{low:g}", f"{high:g}")
    for name in spec.observer.images:
        table.add_row(name, "picture", "", "", "")
    return table


def explanations(task: type[Task[Any]]) -> list[str]:
    """Collect the docstrings that explain a task's MDP.

    Args:
        task: Class of the task.

    Returns:
        Its own docstring, then those of the classes that it shares with other tasks.
    """
    kinds = [kind for kind in inspect.getmro(task) if issubclass(kind, Task) and kind is not Task]
    return [inspect.cleandoc(kind.__doc__) for kind in kinds if kind.__doc__]


def _print_list() -> None:
    """Print each task's name and the first line of its docstring."""
    tasks = list_tasks()
    width = max(map(len, tasks))
    for name in tasks:
        summary = (inspect.getdoc(find_task(name)) or "").partition("\n")[0]
        print(f"{name:{width}s} {summary}")


def _explain(name: str) -> None:
    """Print a task's docstrings, defaults, presets and options."""
    task = find_task(name)
    print("\n\n".join(explanations(task)) + "\n")
    Console().print(observation_table(name, {}))
    # After the MDP in words come the values: defaults, presets and the task's own options.
    print(
        "\nDefaults of the options common to all tasks, where the task has its own: "
        + _pairs(task.defaults)
    )
    for preset, values in task.presets.items():
        print(f"Preset {preset}: {_pairs(values)}")
    print(f"\n{inspect.getdoc(task.Config)}\n")
    for field in dataclasses.fields(task.Config):
        # Fields without a plain default are dicts, empty unless the user fills them.
        default = field.default if field.default is not dataclasses.MISSING else {}
        print(f"  {field.name:16s} {default!r}")
    print(f"\n{inspect.getdoc(EnvOptions)}")


def _pairs(options: Mapping[str, Any]) -> str:
    """Write options as NAME=VALUE with commas between them."""
    return ", ".join(f"{name}={value!r}" for name, value in options.items())
