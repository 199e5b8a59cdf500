"""Measure pages of replays: their size, and how fast a browser shows them.

    python benchmarks/replay.py --out docs/results/replay

A flight of 100 drones for 60 s through a city of 400 buildings is flown, recorded and written as a
page, and opened in a headless Chromium that draws with the processor alone. Reported are the size
of the page, the time until it can be used, and of pictures while it plays: the time of scripts (the
median, 95 of 100, and the longest), and the draw calls. Writes replay.md.
"""

import argparse
import os
import platform
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bulletuav
from bulletuav.analysis.recording import fly_episode
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.report.replay import write_replay

sys.path.append(str(Path(__file__).parents[1] / "tests"))
import chromium

SIDE = 885.0
"""Side of the city, m, at which it has 400 buildings"""
VIEWS = {
    "whole, 1280 x 760 pixels": ("#theme=light", (1280, 760)),
    "follow, 1280 x 760 pixels": ("#theme=dark&time=20&follow", (1280, 760)),
    "whole, 160 x 120 pixels": ("#theme=light", (160, 120)),
}
"""Where each begins, and its size. In the small one scripts have the processor for themselves"""
GOALS = {"size": 5.0, "ready": 3.0, "script": 8.0, "calls": 200.0}


def fly(path: Path, drones: int | None) -> dict[str, float]:
    """Fly the city, or a flock of a number of drones, and write the page; return what is in it."""
    if drones is None:
        options = {"num_drones": 100, "area": SIDE, "at_goal": "respawn", "boundary": "open"}
        aviary, policy = bulletuav.Aviary("lidar_navigation", **options), "planner"
    else:
        flock: dict[str, Any] = {"num_drones": drones, "difficulty": "easy", "horizon": 600}
        aviary, policy = bulletuav.Aviary("flocking", dynamics="point_mass", **flock), "reynolds"
    recording = fly_episode(aviary, find_policy(policy)(aviary), 0)
    began = time.perf_counter()
    write_replay(recording, f"{aviary.num_drones} drones", path)
    return {
        "drones": aviary.num_drones,
        "buildings": len(recording.building),
        "duration": float(recording.time[-1]),
        "writing": time.perf_counter() - began,
        "size": path.stat().st_size / 1e6,
    }


def show(path: Path, where: str, size: tuple[int, int], seconds: float) -> dict[str, float]:
    """Open the page, play it, and tell how it went."""
    with chromium.Page(*size) as page:
        page.open(path, where)
        ready = page.tell("replay.stats.ready") / 1000
        page.tell("replay.stats.script.length = 0")
        before = page.tell("replay.stats.pictures")
        page.press(" ", "Space", 32)
        time.sleep(seconds)
        shown = page.tell("replay.stats.pictures") - before
        script = sorted(page.tell("replay.stats.script"))
        calls = page.tell("replay.stats.calls")
        if page.messages:
            raise SystemExit(f"the browser complains: {page.messages}")
    return {
        "ready": ready,
        "median": statistics.median(script),
        "most": script[int(0.95 * len(script))],
        "longest": script[-1],
        "calls": calls,
        "rate": shown / seconds,
    }


def table(flown: dict[str, float], shown: dict[str, dict[str, float]]) -> str:
    """Write what was measured."""
    lines = [
        f"{flown['drones']:g} drones, {flown['duration']:g} s, {flown['buildings']:g} buildings: "
        f"a page of {flown['size']:.2f} MB (goal of 100 drones: {GOALS['size']:g}), written in "
        f"{flown['writing']:.1f} s. Chromium draws with the processor alone (SwiftShader), "
        f"{os.cpu_count()} cores, {platform.machine()}, at a load average of "
        f"{os.getloadavg()[0]:.1f}. In large pictures it takes the processor from scripts.",
        "",
        "| view | can be used after (s) | script a picture: median, 95 %, most (ms) | draw calls "
        "| pictures a second |",
        "|---|---|---|---|---|",
    ]
    for name, one in shown.items():
        lines.append(
            f"| {name} | {one['ready']:.2f} | {one['median']:.1f}, {one['most']:.1f}, "
            f"{one['longest']:.1f} | {one['calls']:g} | {one['rate']:.1f} |"
        )
    lines.append(
        f"| goal | {GOALS['ready']:g} | {GOALS['script']:g} | {GOALS['calls']:g} | |",
    )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("docs/results/replay"))
    parser.add_argument("--seconds", type=float, default=10.0, help="how long each view plays")
    parser.add_argument("--drones", type=int, help="fly a flock of so many drones instead")
    arguments = parser.parse_args()
    if chromium.found() is None:
        raise SystemExit("there is no Chromium: on Debian `apt-get install chromium`")
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "replay.html"
        flown = fly(path, arguments.drones)
        shown = {name: show(path, *view, arguments.seconds) for name, view in VIEWS.items()}
    text = table(flown, shown)
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_file(arguments.out / "replay.md", text)
    print(text)


if __name__ == "__main__":
    main()
