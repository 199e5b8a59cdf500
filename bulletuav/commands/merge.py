"""`bulletuav merge`: the files of an evaluation or a comparison from its pieces."""

import argparse
from pathlib import Path

from bulletuav.commands.arguments import add_trust
from bulletuav.commands.output import print_files
from bulletuav.report.results import merge

ABOUT = {
    "help": "make one evaluation, comparison or dataset of pieces that were flown apart",
    "description": (
        "Join the pieces that `--piece K/N` of evaluate, compare or dataset wrote to a folder. The "
        "files are the same as those of one process that did everything."
    ),
    "epilog": """examples:
  bulletuav evaluate crossing --policy orca --out flown --piece 1/2
  bulletuav evaluate crossing --policy orca --out flown --piece 2/2
  bulletuav merge flown""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the folder, and whether it is trusted."""
    parser.add_argument("path", type=Path, metavar="DIR", help="the folder that pieces wrote to")
    add_trust(parser)


def run(arguments: argparse.Namespace) -> None:
    """Join, and tell what was written."""
    print_files(merge(arguments.path, arguments.trust))
