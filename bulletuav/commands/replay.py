"""`bulletuav replay`: write a 3-D replay of a recorded flight, as a web page or a video."""

import argparse
import itertools
from pathlib import Path

from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.report.film import CAMERAS, Film
from bulletuav.report.replay import read_run, replay_run

PAGES, FILM = (".html", ".htm"), ".mp4"


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
