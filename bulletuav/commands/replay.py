"""`bulletuav replay`: write a 3-D replay of a recorded flight, as a web page or a video."""

import argparse
import itertools
from pathlib import Path

from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.report.film import CAMERAS, Film
from bulletuav.report.replay import REPLAY, read_run, replay_run

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
PAGES, FILM = (".html", ".htm"), ".mp4"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight, the output file, and the camera of videos."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of `bulletuav fly`")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=f"web page (.html) or video (.mp4) (default: {REPLAY} in the folder)",
    )
    parser.add_argument(
        "--camera",
        help=f"video: one of {', '.join(CAMERAS)}: circle all drones, follow one drone, or "
        f"stand still (default: {CAMERAS[0]})",
    )
    parser.add_argument("--drone", type=int, help="video: index of the drone to follow")


def run(arguments: argparse.Namespace) -> None:
    """Write the web page or the video."""
    out = arguments.out
    if out is not None and out.suffix == FILM:
        path = _film(arguments)
    elif arguments.camera is not None or arguments.drone is not None:
        raise ValueError(
            "--camera and --drone are for videos (--out FILE.mp4): web pages have all views"
        )
    elif out is not None and out.suffix not in PAGES:
        raise ValueError(f"--out is {out}: its name has to end in .html or {FILM}")
    else:
        path = replay_run(arguments.run, out)
    print_files([path])


def _film(arguments: argparse.Namespace) -> Path:
    """Write the video, and return its path."""
    recording, title = read_run(arguments.run)
    path: Path = arguments.out
    film = Film(
        recording,
        title,
        arguments.camera or CAMERAS[0],
        arguments.drone or 0,
        source=str(arguments.run),
    )
    pictures = itertools.count(1)
    with show_progress("drawing", len(film), "pictures") as report:
        film.save(path, lambda: report(next(pictures)))
    film.close()
    return path
