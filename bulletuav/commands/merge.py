"""`bulletuav merge`: join the pieces of an evaluation, comparison or dataset."""

import argparse

from bulletuav.commands.output import print_files
from bulletuav.report.results import merge


def run(arguments: argparse.Namespace) -> None:
    """Join the pieces, and print the written files."""
    print_files(merge(arguments.path, arguments.trust))
