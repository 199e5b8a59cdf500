"""Arguments of `bulletuav evaluate`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import (
    add_episodes,
    add_options,
    add_sharing,
    task_policy_help,
)

ABOUT = {
    "help": "evaluate a policy over many episodes, with confidence intervals",
    "description": (
        "Fly many episodes in batches and processes. Print metrics with 95 % confidence "
        "intervals. Write these, the metrics of each episode, and a picture. The same command "
        "resumes an interrupted evaluation. The folder of a training run in place of the task "
        "evaluates its policy with the options of its run.yaml, which given options override."
    ),
    "epilog": """examples:
  bulletuav evaluate converge --policy orca --episodes 100 --workers 2 --out converge-orca
  bulletuav evaluate crossing --difficulty hard --out crossing-hard
  bulletuav evaluate hover --dynamics rigid_body --wind 3 0 0""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add task, policy, episodes, metrics, output folder and environment options."""
    parser.add_argument(
        "task", help="one of `bulletuav tasks`, or the folder of a run of `bulletuav train`"
    )
    parser.add_argument("--policy", help=task_policy_help)
    add_episodes(parser)
    # Training runs have their own number of episodes
    parser.set_defaults(episodes=None)
    add_sharing(parser)
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help="additional metric: a registered name, or module:Name, also from a file mine.py in "
        "the current folder; can be repeated",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in evaluation/)"
    )
    add_options(parser)
