"""Arguments of `bulletuav convert`."""

import argparse
from pathlib import Path

ABOUT = {
    "help": "convert a drone's URDF of another simulator into an airframe",
    "description": (
        "Convert the URDF of a drone of gym-pybullet-drones, PyFlyt (with the YAML file next to "
        "it) or RotorS (after xacro) into an airframe: one link with the constants of the rotors. "
        "The report lists each value with its origin, and all that is not used."
    ),
    "epilog": """examples:
  bulletuav convert --example quadrotor.urdf
  bulletuav convert quadrotor.urdf --out mine.urdf
  bulletuav fly hover --airframe mine.urdf""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file, and the output file."""
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="URDF to convert")
    parser.add_argument("--out", type=Path, metavar="NAME.urdf", help="file to write")
    parser.add_argument(
        "--example",
        type=Path,
        metavar="FILE",
        help="write an example of a URDF with links and <properties>, and convert nothing",
    )
