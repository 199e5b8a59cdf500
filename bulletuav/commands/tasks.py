"""`bulletuav tasks`: list the tasks, or describe the MDP and options of one task."""

import argparse

from bulletuav.catalogue import declarations, list_names


def run(arguments: argparse.Namespace) -> None:
    """List the tasks, or describe one."""
    if arguments.task is None:
        _print_list()
    else:
        from bulletuav.commands.task_description import describe  # which imports all of a task

        describe(arguments)


def _print_list() -> None:
    """Print the name of each task and the first line of its docstring."""
    own, names = declarations("task"), list_names("task")
    width = max(map(len, names))
    for name in names:
        summary = own[name].summary if name in own else _summary_of_plugin(name)
        print(f"{name:{width}s} {summary}")


def _summary_of_plugin(name: str) -> str:
    """Import a task of another package, and return the first line of its docstring."""
    from bulletuav.commands.task_description import summary_of
    from bulletuav.tasks import find_task

    return summary_of(find_task(name))
