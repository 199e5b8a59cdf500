"""Arguments of `bulletuav incentives`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import add_episodes, add_options

ABOUT = {
    "help": "check rewards: compare returns of baselines and of policies that shirk",
    "description": (
        "Check the reward functions of tasks. Fly each task with its baseline and with policies "
        "that shirk (avoid the task): stay, climb, dive, leave, crash, circle the goal, clump, fly "
        "straight. The return of the baseline must exceed that of each by more than a tenth of its "
        "lead over staying (lower end of the 95 % interval). Print the shirker with the "
        "smallest gap to the baseline in each task, and write the whole table."
    ),
    "epilog": """examples:
  bulletuav incentives crossing --episodes 20 --out incentives
  bulletuav incentives crossing mec --difficulties easy,hard --dynamics single_integrator""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add tasks, difficulties, episodes, output folder and environment options."""
    parser.add_argument("tasks", nargs="*", help="names of `bulletuav tasks` (default: all)")
    parser.add_argument("--policy", help="baseline policy (default: that of the task)")
    parser.add_argument(
        "--difficulties", metavar="A,B", help="easy, medium, hard, extreme (default: all)"
    )
    add_episodes(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("incentives"),
        metavar="DIR",
        help="folder for the tables (default: incentives)",
    )
    add_options(parser)
