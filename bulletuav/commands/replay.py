"""`bulletuav replay`: a page, or a film, that shows a recorded flight in three dimensions."""

import argparse
import itertools
from pathlib import Path

from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.report.film import CAMERAS, Film
from bulletuav.report.replay import REPLAY, read_run, replay_run

ABOUT = {
    "help": "write a page or a film that replays a flight in three dimensions",
    "description": (
        "Make one HTML file of what `bulletuav fly` recorded. Any browser with WebGL 2 shows it, "
        "without a network: the flight to play and turn about, with plots of each drone. Or make "
        "a film (.mp4), which needs the extra 'video'."
    ),
    "epilog": """examples:
  bulletuav fly crossing --out flight && bulletuav replay flight
  bulletuav replay flight --out crossing.html
  bulletuav replay flight --out crossing.mp4
  bulletuav replay flight --out crossing.mp4 --camera follow --drone 3""",
}
PAGES, FILM = (".html", ".htm"), ".mp4"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flight, where to write, and the camera of films."""
    parser.add_argument("run", type=Path, metavar="RUN", help="folder that `bulletuav fly` wrote")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help=f"the page (.html) or film (.mp4) (default: {REPLAY} in the folder)",
    )
    parser.add_argument(
        "--camera",
        help=f"film: one of {', '.join(CAMERAS)}, which turn about all, fly behind a drone, and "
        f"stand (default: {CAMERAS[0]})",
    )
    parser.add_argument("--drone", type=int, help="film: number of the drone that follow is behind")


def run(arguments: argparse.Namespace) -> None:
    """Write the page or the film."""
    out = arguments.out
    if out is not None and out.suffix == FILM:
        path = _film(arguments)
    elif arguments.camera is not None or arguments.drone is not None:
        raise ValueError("--camera and --drone are for films (--out FILE.mp4): pages have all")
    elif out is not None and out.suffix not in PAGES:
        raise ValueError(f"--out is {out}: its name has to end in .html or {FILM}")
    else:
        path = replay_run(arguments.run, out)
    print_files([path])


def _film(arguments: argparse.Namespace) -> Path:
    """Write the film."""
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
