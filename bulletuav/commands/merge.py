"""`bulletuav merge`: join the pieces of an evaluation, comparison or dataset."""

import argparse
from pathlib import Path

from bulletuav.commands.arguments import add_trust
from bulletuav.commands.output import print_files
from bulletuav.report.results import merge

ABOUT = {
    "help": "join the pieces of an evaluation, comparison or dataset",
    "description": (
        "Join the pieces that `--piece K/N` of evaluate, compare or dataset wrote to a folder. The "
        "resulting files are identical to those of one process."
    ),
    "epilog": """examples:
  bulletuav evaluate crossing --policy orca --out flown --piece 1/2
  bulletuav evaluate crossing --policy orca --out flown --piece 2/2
  bulletuav merge flown""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder, and --trust."""
    parser.add_argument("path", type=Path, metavar="DIR", help="folder of the pieces")
    add_trust(parser)


def run(arguments: argparse.Namespace) -> None:
    """Join the pieces, and print the written files."""
    print_files(merge(arguments.path, arguments.trust))
