"""`bulletuav verify`: reproduce recorded results, and compare them bit for bit."""

import argparse
import sys
from pathlib import Path

from rich.table import Table
from rich.text import Text

from bulletuav.commands.output import print_table
from bulletuav.commands.progress import show_progress
from bulletuav.report.verification import Check, Verifier


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
