"""`bulletuav export`: a recorded flight as a file for viewers of others."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recording import REMEDY
from bulletuav.commands.arguments import print_files
from bulletuav.errors import choose
from bulletuav.report.figures import drone_colours
from bulletuav.report.replay import read_run

ABOUT = {
    "help": "write a flight as MCAP with ROS 2 messages, or for Rerun",
    "description": (
        "Write what `bulletuav fly` recorded as one file for programs of others: MCAP with "
        "messages of ROS 2 (extra mcap), or .rrd of the viewer Rerun (extra rerun)."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav export flight --to mcap
  bulletuav export flight --to rerun --out crossing.rrd""",
}


def _write_mcap(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.mcap import write_mcap  # which needs an extra

    write_mcap(recording.everything(), path)


def _write_rrd(recording: Recording, path: Path) -> None:
    from bulletuav.adapters.rerun import write_rrd  # which needs an extra

    colours = drone_colours(recording.alive.shape[-1])
    # Seals hold for whoever made them: what is in a sealed scene can still be odd.
    try:
        write_rrd(recording.everything(), colours, path)
    except (KeyError, TypeError, IndexError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f"the scene of the recording is damaged ({error!r}): {REMEDY}") from None


FORMATS: dict[str, tuple[str, Callable[[Recording, Path], None]]] = {
    "mcap": ("flight.mcap", _write_mcap),
    "rerun": ("flight.rrd", _write_rrd),
}
"""Name of the file beside the recording, and what writes it, by format"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight, the format, and where to write."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `bulletuav fly` wrote")
    parser.add_argument(
        "--to", required=True, metavar="FORMAT", help=f"format: {' or '.join(FORMATS)}"
    )
    names = " or ".join(name for name, _ in FORMATS.values())
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help=f"the file (default: {names} in the folder)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Write the file."""
    name, write = choose("format", arguments.to, FORMATS)
    recording, _ = read_run(arguments.run)
    folder = arguments.run if arguments.run.is_dir() else arguments.run.parent
    path = arguments.out or folder / name
    write(recording, path)
    print_files(Console(), [path])
