"""`bulletuav replay`: a page that shows a recorded flight in three dimensions."""

import argparse
from pathlib import Path

from rich.console import Console

from bulletuav.commands.arguments import print_files
from bulletuav.report.replay import REPLAY, replay_run

ABOUT = {
    "help": "write a page that replays a flight in three dimensions",
    "description": (
        "Make one HTML file of what `bulletuav fly` recorded. Any browser with WebGL 2 shows it, "
        "without a network: the flight to play and turn about, with plots of each drone."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav replay flight
  bulletuav replay flight --out crossing.html""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight, and where to write."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `bulletuav fly` wrote")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f"the page (default: {REPLAY} in the folder)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the page."""
    print_files(Console(), [replay_run(arguments.run, arguments.out)])
