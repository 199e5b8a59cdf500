"""Sphinx extension: 3-D replays on pages, flown by the build from seeds.

A page places a replay by the line `<!-- replay: NAME -->`: "front", or the name of a task. The
environment variable SKIP_REPLAYS shows an empty frame instead, for a quick look at other pages.
"""

import os
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "benchmarks"))

import gallery  # noqa: E402

import bulletuav  # noqa: E402
from bulletuav.report import replay  # noqa: E402

PLACE = re.compile(r"<!-- replay: (\w+) -->")
FOLDER = "replays"
FRONT = "front"
OPTIONS = "#play&loop&plots=off"
"""Fragment of the address, which sets how the embedded replay begins"""
MAX_SIZE = 1_000_000
"""Maximum size of a replay, bytes"""


def embed(app: Any, docname: str, source: list[str]) -> None:
    """Replace the place of a replay by a frame that loads it when it comes into view."""
    up = "../" * docname.count("/")

    def framed(match: re.Match[str]) -> str:
        name = match[1]
        title = "3-D replay of a flight" + (f" in the task {name}" if name != FRONT else "")
        address = f"{up}{FOLDER}/{name}.html"
        return (
            f'<iframe class="replay" src="{address}{OPTIONS}" title="{title}" loading="lazy" '
            f'allowfullscreen></iframe>\n\n<p class="replay-hint">Drag to turn, wheel or pinch to '
            f'zoom, Space to pause; <a href="{address}">open it on a page of its own</a>.</p>\n'
        )

    source[0] = PLACE.sub(framed, source[0])


def write_replays(app: Any, error: Exception | None) -> None:
    """Fly and write the replays of the front page and of all tasks."""
    if error is not None or os.environ.get("SKIP_REPLAYS"):
        return
    folder = Path(app.outdir, FOLDER)
    folder.mkdir(exist_ok=True)
    for name in (FRONT, *bulletuav.list_tasks()):
        page = make_page(name)
        if len(page.encode()) > MAX_SIZE:
            raise ValueError(f"the replay {name} has more than {MAX_SIZE} bytes: fly less of it")
        (folder / f"{name}.html").write_text(page, encoding="utf-8")


def make_page(name: str) -> str:
    """Fly a task as in its picture, or the flight of the front page, and return the replay."""
    recording, title = gallery.fly_front() if name == FRONT else gallery.fly(name)
    return replay.render_page(title, replay.make_payload(recording, title))


def setup(app: Any) -> dict[str, bool]:
    """Connect the extension."""
    app.connect("source-read", embed)
    app.connect("build-finished", write_replays)
    return {"parallel_read_safe": False}
