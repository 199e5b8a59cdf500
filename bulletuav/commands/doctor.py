"""`bulletuav doctor`: print what is installed and what is missing."""

import argparse
from collections.abc import Sequence

from rich.table import Table

from bulletuav.commands.output import print_table
from bulletuav.report.doctor import EXTRA, Finding, examine


def run(arguments: argparse.Namespace) -> None:
    """Examine the installation and print the findings."""
    findings = examine()
    print(summarize_findings(findings))
    # Outside the table, where commands can be copied
    for finding in findings:
        if finding.remedy:
            print(f"{finding.subject}: {finding.remedy}")
    table = Table(show_header=False)
    for finding in findings:
        table.add_row(finding.subject, finding.state)
    print_table(table)


def summarize_findings(findings: Sequence[Finding]) -> str:
    """Return one line with the names of all findings that have a remedy, optional extras apart."""
    lacking = [finding.subject for finding in findings if finding.remedy]
    extras = [name.removeprefix(EXTRA) for name in lacking if name.startswith(EXTRA)]
    problems = [name for name in lacking if not name.startswith(EXTRA)]
    found = f"problems: {', '.join(problems)}" if problems else "no problems"
    return f"{found}; extras not installed: {', '.join(extras) or 'none'}"
