"""Arguments of `bulletuav tasks`."""

import argparse

from bulletuav.commands.parsers.shared import add_options

ABOUT = {
    "help": "list the tasks, or describe the MDP and options of one task",
    "description": (
        "List the tasks, or describe one: its observation, action, reward, ends, difficulties and "
        "main options, or with --all all of its terms and options."
    ),
    "epilog": """examples:
  bulletuav tasks
  bulletuav tasks crossing
  bulletuav tasks crossing --all
  bulletuav tasks crossing --observation --drones 3 --set observation=position,goal""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the task, the parts to print, and environment options."""
    parser.add_argument("task", nargs="?", help="task to describe (default: list all tasks)")
    parser.add_argument(
        "--observation",
        dest="show_observation",
        action="store_true",
        help="print name, unit and bounds of each number of an observation, with the given options",
    )
    parser.add_argument(
        "--all", action="store_true", help="print all reward terms, ends and options of the task"
    )
    add_options(parser)
