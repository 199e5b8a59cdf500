"""`bulletuav doctor`: print what is installed and what is missing."""

import argparse

from rich.table import Table

from bulletuav.commands.output import print_table
from bulletuav.report.doctor import examine


def run(arguments: argparse.Namespace) -> None:
    """Examine the installation and print the findings."""
    findings = examine()
    table = Table(show_header=False)
    for finding in findings:
        table.add_row(finding.subject, finding.state)
    print_table(table)
    # Below the table, where commands can be copied
    for finding in findings:
        if finding.remedy:
            print(f"{finding.subject}: {finding.remedy}")
