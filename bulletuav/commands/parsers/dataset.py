"""Arguments of `bulletuav dataset`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import (
    add_episodes,
    add_options,
    add_sharing,
    task_policy_help,
)

ABOUT = {
    "help": "record the transitions of a policy as Parquet tables and Minari datasets",
    "description": (
        "Fly episodes and record observations, actions and rewards (extra dataset): Parquet tables "
        "of all drones, and a Minari dataset of each drone. The same command resumes an "
        "interrupted recording."
    ),
    "epilog": """examples:
  bulletuav dataset crossing --policy orca --episodes 100 --workers 2 --out flights
  bulletuav dataset crossing --dynamics point_mass --piece 3/8 --out flights""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add task, policy, episodes, output folder and environment options."""
    parser.add_argument("task", help="one of `bulletuav tasks`")
    parser.add_argument("--policy", help=task_policy_help)
    add_episodes(parser)
    add_sharing(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in datasets/)"
    )
    add_options(parser)
