"""Arguments of `bulletuav verify`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import add_trust

ABOUT = {
    "help": "reproduce a recording, evaluation, leaderboard or dataset, bit for bit",
    "description": (
        "Check the seals (hashes) of files of fly, evaluate, compare or dataset, fly the episodes "
        "again, and compare the hashes. The exit code is 1 if anything differs."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav verify flight
  bulletuav evaluate hover --episodes 20 --out hovering
  bulletuav verify hovering --workers 2""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file or folder, --workers and --trust."""
    parser.add_argument("path", type=Path, metavar="FILE", help="file of results, or its folder")
    parser.add_argument("--workers", type=int, default=1, help="number of processes (default: 1)")
    add_trust(parser)
