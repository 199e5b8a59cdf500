"""`bulletuav doctor`: what is active and what is missing."""

import argparse

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bulletuav.report.doctor import Finding, examine

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
    table = Table(show_header=False)
    for _ in Finding._fields:
        table.add_column(overflow="fold")
    for finding in examine():
        table.add_row(*map(escape, finding))
    Console().print(table)
