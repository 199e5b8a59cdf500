"""`bulletuav doctor`: what is active and what is missing."""

import argparse

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bulletuav.report.doctor import examine

ABOUT = {
    "help": "print versions, what is active and what is missing",
    "description": (
        "Print the versions, whether the C extension is active, and how to get what is missing."
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command takes no arguments."""


def run(arguments: argparse.Namespace) -> None:
    """Examine the installation and print the findings."""
    console, findings = Console(), examine()
    table = Table(show_header=False)
    for _ in range(2):
        table.add_column(overflow="fold")
    for finding in findings:
        table.add_row(escape(finding.subject), escape(finding.state))
    console.print(table)
    # Below the table, where a command can be copied.
    for finding in findings:
        if finding.remedy:
            line = f"{finding.subject}: {finding.remedy}"
            console.print(line, soft_wrap=True, markup=False, highlight=False)
