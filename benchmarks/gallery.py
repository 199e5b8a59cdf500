"""Draw each task: a flight of it in three dimensions.

    python benchmarks/gallery.py --out docs/results/gallery

Each task is flown by its own baseline, with seed 0. Writes TASK.png for each.
"""

import argparse
import itertools
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from PIL import Image

import bulletuav
from bulletuav.analysis.recorded import Recording
from bulletuav.analysis.recording import fly_episode
from bulletuav.commands.progress import show_progress
from bulletuav.files import whole_file
from bulletuav.policies import find_policy
from bulletuav.report.film import Film
from bulletuav.tasks import find_task

SIZE = (560, 380)
COLOURS = 64
"""Of each picture, which makes files small"""
CITY = {"area": 300.0, "num_layouts": 1}
OPTIONS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(("coverage", "default", "lidar_navigation", "los", "mec"), CITY),
    **dict.fromkeys(("mec_advanced", "mobile_users", "navigation"), CITY),
    "crossing": {"num_drones": 8},
    "converge": {"num_drones": 8},
    "transport": {"dynamics": "rigid_body", "num_drones": 4},
    "search": {"num_drones": 3, "num_victims": 3, "city": "wooded_hills", "num_layouts": 1},
}
"""Options of tasks beside `COMMON`"""
COMMON = {"dynamics": "point_mass"}
FRONT_TASK = "lidar_navigation"
FRONT = {"num_drones": 8, "area": 300.0, "num_layouts": 1}
"""Options of the flight through a city on the front page of the documentation"""


def fly(task: str, more: Mapping[str, Any] = MappingProxyType({})) -> tuple[Recording, str]:
    """Fly a task by its baseline, and return the flight and its title."""
    policy = find_policy(find_task(task).baseline, task)
    options = policy.complete(task, {**COMMON, **OPTIONS.get(task, {}), **more})
    aviary = bulletuav.Aviary(task, **options)
    recording = fly_episode(aviary, policy(aviary), 0)
    aviary.close()
    return recording, f"{task}, {policy.name}"


def fly_front() -> tuple[Recording, str]:
    """Fly the flight of the front page, and return it and its title."""
    recording, _ = fly(FRONT_TASK, FRONT)
    return recording, "Eight drones fly through a city"


def draw(task: str, path: Path) -> None:
    """Fly a task, and draw the flight."""
    recording, title = fly(task)
    film = Film(recording, title, "still", size=SIZE)
    picture = film.picture(float(recording.time[-2]), reach=float("inf"))
    with whole_file(path) as part:
        Image.fromarray(picture).quantize(COLOURS).save(part, "PNG", optimize=True)
    film.close()


def main() -> None:
    """Draw all tasks, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the files")
    parser.add_argument("--tasks", nargs="+", default=bulletuav.list_tasks(), help="default: all")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    done = itertools.count(1)
    with show_progress("flying", len(arguments.tasks), "tasks") as report:
        for task in arguments.tasks:
            draw(task, arguments.out / f"{task}.png")
            report(next(done))


if __name__ == "__main__":
    main()
