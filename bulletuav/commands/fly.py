"""`bulletuav fly`: fly one episode, and write its trajectories and pictures."""

import argparse
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.evaluation import EPISODES
from bulletuav.analysis.recorded import Recording, outcomes, summarize_infos
from bulletuav.analysis.recording import fly_episode, save
from bulletuav.commands.arguments import (
    given_options,
    make_out_folder,
)
from bulletuav.commands.output import print_files, print_table
from bulletuav.commands.progress import show_progress
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.viewer import parse_address
from bulletuav.errors import as_int
from bulletuav.policies import find_policy
from bulletuav.report.pictures import Animation, plot_tracks
from bulletuav.report.replay import REPLAY, replay_run
from bulletuav.tasks import find_task
from bulletuav.tasks.base import Task

EXPLAINED = {
    "nearest (m)": "nearest: minimum distance to another drone",
    "conflicts": "conflicts: total of the episode",
    "collisions": "collisions: total of the episode",
}
"""Explanations of columns of the table, by heading"""


def run(arguments: argparse.Namespace) -> None:
    """Fly one episode, or a mission, and write its files."""
    if arguments.mission is not None:
        from bulletuav.commands import fly_mission  # which imports the servers

        fly_mission.run(arguments, _prepare_folder)
        return
    if arguments.task is None:
        raise ValueError("fly what? Give either a task (see `bulletuav tasks`) or --mission FILE")
    if arguments.speed is not None or arguments.home is not None:
        raise ValueError("--speed and --home apply to missions: give --mission FILE, or omit them")
    arguments.animation = arguments.animation or "gif"
    # Check the input before anything is written
    as_int("seed", arguments.seed, 0)
    arguments.policy = arguments.policy or find_task(arguments.task).baseline
    spec = find_policy(arguments.policy, arguments.task, arguments.trust)
    options = spec.complete(arguments.task, given_options(arguments))
    options |= _live_options(arguments)
    aviary = Aviary(arguments.task, 1, **options)
    policy = spec(aviary)
    _prepare_folder(arguments.out)
    if aviary.viewer is not None:
        from bulletuav.report.live import LiveView  # which imports asyncio

        if isinstance(aviary.viewer, LiveView):
            print(f"{aviary.viewer.invitation}: the flight begins then", flush=True)
            aviary.viewer.wait()

    # All drones may be done before the horizon
    decisions = itertools.count(1)
    with show_progress("flying", aviary.options.horizon, "decisions") as report:
        recording = fly_episode(aviary, policy, arguments.seed, lambda: report(next(decisions)))
    if aviary.viewer is not None:
        aviary.viewer.close()

    files = save(recording, aviary, arguments.policy, arguments.seed, arguments.out)
    files += _draw(recording, aviary, arguments)
    if arguments.html:
        files.append(replay_run(arguments.out))
    print_table(_table(recording, aviary, arguments.seed))
    print_files(files)
    aviary.close()


def _live_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options of a live view, if requested."""
    if arguments.live and arguments.foxglove:
        raise ValueError("--live and --foxglove cannot be combined: give one of them")
    address = arguments.live or arguments.foxglove
    if address is None:
        return {}
    parse_address(address)
    return {"render_mode": "web" if arguments.live else "foxglove", "render_address": address}


def _prepare_folder(out: Path) -> None:
    """Create the folder and delete old pictures; raise ValueError for evaluation folders."""
    if (out / EPISODES).exists():
        raise ValueError(f"--out {out} holds an evaluation: choose another folder")
    for old in (*make_out_folder(out).glob("flight.*"), out / REPLAY):
        old.unlink(missing_ok=True)


def _draw(recording: Recording, aviary: Aviary, arguments: argparse.Namespace) -> list[Path]:
    """Draw the tracks and, unless disabled, an animation."""
    # Airframes, for the titles
    airframes = ", ".join(sorted({airframe.name for airframe in aviary.options.airframe}))
    drones = f"{aviary.num_drones} {airframes}"
    title = f"{arguments.task}: {drones}, {arguments.policy}, seed {arguments.seed}"
    d_safe = aviary.task.config.d_safe
    tracks = arguments.out / "tracks.png"
    plot_tracks(recording, d_safe, title, tracks, shown_infos(aviary.task))
    if arguments.animation == "none":
        return [tracks]

    # Drawing takes minutes for long flights
    drone_size = 2 * aviary.task.context.collision_radius
    animation = Animation(recording, d_safe, drone_size, title)
    path = arguments.out / f"flight.{arguments.animation}"
    pictures = itertools.count(1)
    with show_progress("drawing", len(animation), "pictures") as report:
        animation.save(path, lambda: report(next(pictures)))
    return [tracks, path]


def shown_infos(task: Task[Any]) -> Mapping[str, str]:
    """Return the labels of the infos that a task shows, by name of the info."""
    hidden = () if task.has_goals else ("goal_distance",)
    return {name: label for name, label in task.shows.items() if name not in hidden}


def _table(recording: Recording, aviary: Aviary, seed: int) -> Table:
    """Return a table of the outcome of each drone."""
    task = aviary.task
    options = aviary.options
    flown = Conditions(task.name, options.difficulty, options.dynamics_name, 1, seed)
    shows = shown_infos(task)
    explained = [text for heading, text in EXPLAINED.items() if heading in shows.values()]
    table = Table(
        title=f"{flown}, drones: {aviary.num_drones}, action {options.action}, "
        f"d_safe {task.config.d_safe:g} m",
        caption="; ".join(["values at the last decision of each drone", *explained]),
    )
    for heading in ("drone", *shows.values(), "time (s)"):
        table.add_column(heading, justify="right")
    rows = zip(outcomes(recording), summarize_infos(recording, shows), strict=True)
    for outcome, numbers in rows:
        cells = map(_cell, numbers.values())
        table.add_row(f"drone_{outcome.drone}", *cells, f"{outcome.time:.2f}")
    return table


def _cell(value: float) -> str:
    """Format a bool, a count, or a quantity."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    # A single drone has no nearest neighbour
    return f"{value:.2f}" if math.isfinite(value) else "-"
