"""Arguments of `bulletuav reproduce`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp

ABOUT = {
    "help": "compute a published table again, next to the published numbers",
    "description": (
        "Compute a published table again. Print each number next to the published one, with a "
        "95 % interval and a verdict: within, better, explained or outside. Write the numbers and "
        "a picture. Without a name, list the tables."
    ),
    "epilog": """examples:
  bulletuav reproduce
  bulletuav reproduce erlang
  bulletuav reproduce quadswarm --size 0.02 --out tables""",
}

DEFAULT_OUT = Path("reproduced")
"""Folder of the files if none is given"""


@DeferredHelp
def _names() -> str:
    from bulletuav.reproduction import list_reproductions

    return f"name of the table: {', '.join(list_reproductions())}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add name, data, size, processes and output folder."""
    parser.add_argument("table", nargs="?", help=_names)
    parser.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        help="folder of the data of others, for tables that need it",
    )
    parser.add_argument(
        "--size",
        type=float,
        metavar="FRACTION",
        help="fraction of the episodes, windows or decisions (default: 1); a hundredth shows that "
        "it works",
    )
    parser.add_argument("--workers", type=int, metavar="N", help="number of processes (default: 1)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help=f"folder for the files (default: {DEFAULT_OUT})",
    )
