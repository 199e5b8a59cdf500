"""`bulletuav verify`: reproduce recorded results, and compare them bit for bit."""

import argparse
import sys
from pathlib import Path

from rich.table import Table
from rich.text import Text

from bulletuav.commands.arguments import add_trust
from bulletuav.commands.output import print_table
from bulletuav.commands.progress import show_progress
from bulletuav.report.verification import Check, Verifier

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


def run(arguments: argparse.Namespace) -> None:
    """Verify, print the comparison, and exit with code 1 if anything differs."""
    verifier = Verifier(arguments.workers, arguments.trust, show_progress)
    checks = verifier.verify(arguments.path)
    print_table(_table(arguments.path, checks))
    if not all(check.same for check in checks):
        sys.exit(1)


def _table(path: Path, checks: list[Check]) -> Table:
    """Return a table of the comparisons."""
    table = Table(title=str(path))
    for heading in ("what", "in the file", "found", "same"):
        table.add_column(heading)
    for check in checks:
        same = Text("yes" if check.same else "NO", style="" if check.same else "bold red")
        table.add_row(check.what, check.expected[:12], check.found[:12], same)
    return table
