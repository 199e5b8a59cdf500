"""Arguments of `bulletuav merge`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.shared import add_trust

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
