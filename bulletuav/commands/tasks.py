"""`bulletuav tasks`: the tasks, or one's MDP and options."""

import argparse
import dataclasses
import inspect

from rich.console import Console
from rich.table import Table

from bulletuav.commands.arguments import add_options, given_options
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.options import EnvOptions
from bulletuav.tasks import find_task, list_tasks
from bulletuav.tasks.base import Task

ABOUT = {
    "help": "list the tasks, or print one's MDP and options",
    "description": "List the tasks, or explain one.",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The task, if any, and the options that its observation depends on."""
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
        width = max(map(len, list_tasks()))
        for name in list_tasks():
            print(f"{name:{width}s} {inspect.getdoc(find_task(name)).splitlines()[0]}")  # type: ignore[union-attr]
    elif arguments.show_observation:
        Console().print(observation_table(arguments.task, given_options(arguments)))
    else:
        _explain(arguments.task)


def observation_table(task: str, options: dict) -> Table:
    """What each number of an observation is, with its bounds."""
    plan = EnvSpec(task, 1, options)
    table = Table(title=f"observation of {task}, one drone of {plan.options.num_drones}, float32")
    for heading in ("index", "number", "unit", "low", "high"):
        table.add_column(heading, justify="left" if heading in ("number", "unit") else "right")
    bounds = zip(plan.observer.labels, plan.observer.low, plan.observer.high, strict=True)
    for index, (label, low, high) in enumerate(bounds):
        table.add_row(str(index), label.name, label.unit, f"{low:g}", f"{high:g}")
    for name in plan.observer.images:
        table.add_row(name, "picture", "", "", "")
    return table


def explanations(task: type[Task]) -> list[str]:
    """The docstrings that tell a task's MDP: its own, and that of what it has in common with others."""
    kinds = [kind for kind in inspect.getmro(task) if issubclass(kind, Task) and kind is not Task]
    return [inspect.cleandoc(kind.__doc__) for kind in kinds if kind.__doc__]


def _explain(name: str) -> None:
    task = find_task(name)
    print("\n\n".join(explanations(task)))
    print(
        "\nDefaults of the options common to all tasks, where the task has its own: "
        + ", ".join(f"{name}={value!r}" for name, value in task.defaults.items())
    )
    for name, values in task.presets.items():
        print(
            f"Preset {name}: "
            + ", ".join(f"{option}={value!r}" for option, value in values.items())
        )
    print(f"\n{inspect.getdoc(task.Config)}\n")
    for field in dataclasses.fields(task.Config):
        default = field.default if field.default is not dataclasses.MISSING else {}
        print(f"  {field.name:16s} {default!r}")
    print(f"\n{inspect.getdoc(EnvOptions)}")
