"""Arguments of `bulletuav compare`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import add_episodes, add_options, add_sharing, policy_help

ABOUT = {
    "help": "evaluate several policies in several tasks and write a leaderboard",
    "description": (
        "Evaluate each policy in each task, difficulty and (--dynamics A,B) dynamics. Write a "
        "leaderboard as markdown, csv and picture. The same command resumes an interrupted "
        "comparison. --action does not apply to trained policies, which have their own."
    ),
    "epilog": """examples:
  bulletuav compare --policies straight,potential,orca --tasks crossing,pursuit,converge \\
      --workers 2 --out leaderboard
  bulletuav compare --policies random,kmeans --tasks los,mec \\
      --dynamics single_integrator,bullet --out service""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add tasks, policies, episodes, output folder and environment options."""
    parser.add_argument(
        "--tasks", required=True, type=parse_names, metavar="A,B", help="names of `bulletuav tasks`"
    )
    parser.add_argument(
        "--policies", required=True, type=parse_names, metavar="A,B", help=policy_help
    )
    parser.add_argument(
        "--difficulties",
        type=parse_names,
        metavar="A,B",
        help="easy, medium, hard, extreme (default: that of the task)",
    )
    parser.add_argument(
        "--against",
        metavar="POLICY",
        help="reference policy: print the difference of the others from it",
    )
    add_episodes(parser)
    add_sharing(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("leaderboard"),
        metavar="DIR",
        help="folder for the files (default: leaderboard)",
    )
    add_options(parser)


def parse_names(text: str) -> list[str]:
    """Split comma-separated names, without duplicates."""
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise argparse.ArgumentTypeError(f"{text!r} has no name")
    return names
