"""Arguments of `bulletuav incentives`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import add_episodes, add_options

ABOUT = {
    "help": "check tasks: compare baselines with oracles, blind policies and such that shirk",
    "description": (
        "Check whether tasks can be done and whether their rewards can be gamed. Fly each task "
        "with its baseline; with its oracle, whose safe success must be 0.9 or more; with blind "
        "policies, which observe nothing and must stay at 0.1 or less; and with policies that "
        "shirk (avoid the task), generic ones and the task's own. The return of the baseline must "
        "exceed theirs by more than a tenth of its lead over staying (lower end of the 95 % "
        "interval). Policies of --others, such as trained runs, must not earn more than the "
        "baseline at less success. Print for each role the policy nearest to a fault, and all "
        "faults; write both tables."
    ),
    "epilog": """examples:
  bulletuav incentives crossing --episodes 20 --out incentives
  bulletuav incentives crossing mec --difficulties easy,hard --dynamics single_integrator
  bulletuav incentives crossing --others trained,mvp --difficulties medium""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add tasks, difficulties, episodes, output folder and environment options."""
    parser.add_argument("tasks", nargs="*", help="names of `bulletuav tasks` (default: all)")
    parser.add_argument("--policy", help="baseline policy (default: that of the task)")
    parser.add_argument(
        "--difficulties", metavar="A,B", help="easy, medium, hard, extreme (default: all)"
    )
    parser.add_argument(
        "--others",
        metavar="A,B",
        help="further policies; they should not earn more for less success",
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
