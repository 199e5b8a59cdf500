"""Arguments of `bulletuav replay`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp

ABOUT = {
    "help": "write a 3-D replay of a recorded flight, as a web page or a video",
    "description": (
        "Write a recording of `bulletuav fly` as one HTML file. Any browser with WebGL 2 shows it "
        "offline: a 3-D view with playback controls, and plots of each drone. Or write "
        "a video (.mp4), which needs the extra 'video'."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav replay flight
  bulletuav replay flight --out crossing.html
  bulletuav replay flight --out crossing.mp4
  bulletuav replay flight --out crossing.mp4 --camera follow --drone 3""",
}


@DeferredHelp
def _file() -> str:
    from bulletuav.report.replay import REPLAY

    return f"web page (.html) or video (.mp4) (default: {REPLAY} in the folder)"


@DeferredHelp
def _cameras() -> str:
    from bulletuav.report.film import CAMERAS

    return (
        f"video: one of {', '.join(CAMERAS)}: circle all drones, follow one drone, or "
        f"stand still (default: {CAMERAS[0]})"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight, the output file, and the camera of videos."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of `bulletuav fly`")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=_file,
    )
    parser.add_argument(
        "--camera",
        help=_cameras,
    )
    parser.add_argument("--drone", type=int, help="video: index of the drone to follow")
