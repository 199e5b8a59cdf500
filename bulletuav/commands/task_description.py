"""`bulletuav tasks TASK`: describe the MDP and options of one task."""

import argparse
import dataclasses
import inspect
import itertools
import re
from collections.abc import Mapping
from typing import Any

from rich.table import Table

from bulletuav.commands.arguments import given_options
from bulletuav.commands.output import print_table, print_text
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.envs.teams import team_rows
from bulletuav.tasks import find_task
from bulletuav.tasks.base import Task
from bulletuav.tasks.ingredients import find_term

MDP = ("Observation", "Action", "Reward", "- ", "End:", "Success:")
"""First words of the paragraphs of a task docstring that describe its MDP"""
MAIN_OPTIONS = 10
"""Number of options in the summary of a task"""
ENDING = ("at_goal", "boundary", "contact_ends", "conflict_ends")
"""Options that define what ends an episode"""
OPTION = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)
"""Entry of an option in the attributes of a docstring: name and description"""


def describe(arguments: argparse.Namespace) -> None:
    """Print MDP, options or observation of one task."""
    if arguments.show_observation:
        print_table(observation_table(arguments.task, given_options(arguments)))
    elif arguments.all:
        _explain(arguments.task)
    else:
        _summarise(arguments.task)


def observation_table(task: str, options: Mapping[str, Any]) -> Table:
    """Return a table of the numbers of an observation.

    Args:
        task: Name of the task.
        options: Options of the environment, on which the observation depends.

    Returns:
        A table with the index, name, unit and bounds of each number, and a row for each picture. If
        teams observe different blocks, the index follows the name of the team.
    """
    spec = EnvSpec(task, 1, dict(options))
    table = Table(title=f"observation of {task}, one drone of {spec.options.num_drones}, float32")
    for heading in ("index", "number", "unit", "low", "high"):
        table.add_column(heading, justify="left" if heading in ("number", "unit") else "right")
    kinds = {"": spec.observer}
    if len(spec.observer.kinds) > 1:
        teams = team_rows(spec.task).items()
        kinds = {f"{team} ": spec.observer.of(rows[0]) for team, rows in teams}
    # First the numbers of the vector by index, then the images by name
    for team, observer in kinds.items():
        numbers = zip(observer.labels, observer.low, observer.high, strict=True)
        for index, (label, low, high) in enumerate(numbers):
            table.add_row(f"{team}{index}", label.name, label.unit, f"{low:g}", f"{high:g}")
    for name in spec.observer.images:
        table.add_row(name, "picture", "", "", "")
    return table


def _summarise(name: str) -> None:
    """Print the MDP of a task, the options of its difficulties, and its main options."""
    task = find_task(name)
    first, *others = (inspect.getdoc(task) or "").split("\n\n")
    print_text(f"{name}: {first}\n")
    for paragraph in others:
        if paragraph.startswith(MDP):
            is_list = paragraph.startswith("- ")
            print_text(paragraph if is_list else " ".join(paragraph.split()))
    print()
    print_table(main_options_table(task))
    print()
    print_text(
        f"Meaning of these, and all other options: bulletuav tasks {name} --all. "
        f"Numbers of the observation: bulletuav tasks {name} --observation."
    )


def main_options_table(task: type[Task[Any]]) -> Table:
    """Return a table of the main options of a task.

    These are the options that its difficulties set, its own options, and common options.

    Args:
        task: Class of the task.

    Returns:
        A table with name and default of each option, and its value at each difficulty, which is
        empty if it is the default. For random options their number is shown.
    """
    own = vars(task.Config).get("__annotations__", {})
    common = {field.name: field.default for field in dataclasses.fields(EnvOptions)}
    common["randomization"] = {}
    defaults = {**common, **_defaults(task), **task.defaults}
    levels = task.difficulties
    table = Table(title="Main options", box=None)
    for heading in ("option", "default", *levels):
        table.add_column(heading)
    varied = dict.fromkeys(itertools.chain(*levels.values()))
    names = list(dict.fromkeys([*varied, *own, *task.defaults, *_defaults(task)]))
    # Show all options that difficulties set, even if more than `MAIN_OPTIONS`
    for name in names[: max(MAIN_OPTIONS, len(varied))]:
        values = (_short(level[name]) if name in level else "" for level in levels.values())
        table.add_row(name, _short(defaults[name]), *values)
    return table


def _short(value: Any) -> str:
    """Format the value of an option in a few characters."""
    if isinstance(value, Mapping):
        return f"{len(value)} uncertain" if value else "none"
    return str(value)


def _explain(name: str) -> None:
    """Print the docstring of a task, and tables of its observation, reward, ends and options."""
    task = find_task(name)
    print(f"{inspect.getdoc(task)}\n")
    print_table(observation_table(name, {}))
    for table in (reward_table, ends_table, difficulties_table):
        print_table(table(task))
    print(f"\n{_before_attributes(task.Config)}\n")
    print_table(options_table(task))
    print(f"\n{inspect.getdoc(EnvOptions)}")


def reward_table(task: type[Task[Any]]) -> Table:
    """Return a table of all reward terms of a task, including terms of weight 0.

    Args:
        task: Class of the task.

    Returns:
        A table with name, weight and description of each term. If the task has weights for training
        (`reward="training"`), they are a column after the weights.
    """
    title = "reward of a decision: weighted sum of these terms"
    training = task.training_weights
    table = _table(f"{title} (second number: weights for training)" if training else title)
    for name, value in task.reward.items():
        term, weight = value if isinstance(value, tuple) else (name, value)
        computed = name in task.computed_terms
        function = task.compute_terms if computed else find_term("reward", term)
        weights = [weight, training.get(name, weight)] if training else [weight]
        table.add_row(name, *(f"{one:g}" for one in weights), summary_of(function))
    return table


def ends_table(task: type[Task[Any]]) -> Table:
    """Return a table of the conditions that end the episode of a drone, with default options.

    Args:
        task: Class of the task.

    Returns:
        A table of the functions in `ends`, the options that say what ends an episode, the battery
        and the horizon.
    """
    spec = EnvSpec(task, 1, {})
    table = _table("ends of an episode, with default options")
    for one in task.ends:
        table.add_row(one.__name__, "terminated", summary_of(one))
    descriptions = option_texts(task.Config)
    for name in ENDING:
        if name in descriptions:
            value = getattr(spec.task.config, name)
            table.add_row(name, repr(value), descriptions[name])
    if spec.options.battery_capacity is not None:
        table.add_row("battery", "terminated", "The battery is empty.")
    table.add_row("horizon", "truncated", f"After {spec.options.horizon} decisions.")
    return table


def difficulties_table(task: type[Task[Any]]) -> Table:
    """Return a table of the options that difficulties and presets set.

    Args:
        task: Class of the task.

    Returns:
        A table with the name of each difficulty and preset, and its options as NAME=VALUE.
    """
    table = _table("options of difficulties and presets")
    for name, values in task.difficulties.items():
        table.add_row(f"difficulty {name}", _pairs(values) or "the defaults")
    for name, values in task.presets.items():
        table.add_row(f"preset {name}", _pairs(values))
    return table


def options_table(task: type[Task[Any]]) -> Table:
    """Return a table of the options of a task, and of its defaults of common options.

    Args:
        task: Class of the task.

    Returns:
        A table with name, default and description of each option.
    """
    table = _table("options and their defaults")
    descriptions = option_texts(task.Config)
    for name, default in _defaults(task).items():
        table.add_row(name, repr(default), descriptions.get(name, ""))
    for name, value in task.defaults.items():
        table.add_row(name, repr(value), "Common to all tasks, see below.")
    if (actions := _default_actions(task)) is not None:
        table.add_row("action by dynamics", actions, "Default action of each dynamics model.")
    return table


def _defaults(task: type[Task[Any]]) -> dict[str, Any]:
    """Return the defaults of the options of a task."""
    # Fields without a plain default are dicts, empty by default
    return {
        field.name: {} if field.default is dataclasses.MISSING else field.default
        for field in dataclasses.fields(task.Config)
    }


def _default_actions(task: type[Task[Any]]) -> str | None:
    """Return the default action of each dynamics as NAME=VALUE; None if all are equal."""
    actions = {name: resolve_options(task, {"dynamics": name}).options.action for name in DYNAMICS}
    return _pairs(actions) if len(set(actions.values())) > 1 else None


def option_texts(config: type) -> dict[str, str]:
    """Read the description of each option from the docstrings of a config class and its bases.

    Args:
        config: The config class.

    Returns:
        Descriptions by name of the option; those of derived classes take precedence.
    """
    texts: dict[str, str] = {}
    for kind in inspect.getmro(config):
        found = OPTION.findall(inspect.cleandoc(kind.__doc__ or ""))
        texts = {name: " ".join(text.split()) for name, text in found} | texts
    return texts


def _before_attributes(config: type) -> str:
    """Return the docstring of a config without its attributes."""
    return inspect.cleandoc(config.__doc__ or "").partition("\n\nAttributes:")[0]


def summary_of(function: Any) -> str:
    """Return the first line of a docstring."""
    return (inspect.getdoc(function) or "").partition("\n")[0]


def _table(title: str) -> Table:
    """Make a table without headings."""
    return Table(title=title, title_justify="left", show_header=False, show_lines=True)


def _pairs(options: Mapping[str, Any]) -> str:
    """Return options as comma-separated NAME=VALUE."""
    return ", ".join(f"{name}={value!r}" for name, value in options.items())
