"""`bulletuav fly`: one episode, its files and pictures."""

import argparse
import itertools
from pathlib import Path

from rich.console import Console
from rich.table import Table

from bulletuav.analysis.evaluation import EPISODES
from bulletuav.analysis.recording import Recording, fly_episode, outcomes, save
from bulletuav.commands.arguments import (
    POLICY_HELP,
    add_options,
    add_trust,
    flyable_options,
    given_options,
    out_folder,
    tell_files,
)
from bulletuav.commands.progress import telling
from bulletuav.envs.aviary import Aviary
from bulletuav.errors import as_int
from bulletuav.policies import find_policy
from bulletuav.report.pictures import Animation, plot_tracks
from bulletuav.tasks import find_task

ABOUT = {
    "help": "fly one episode and write trajectories and pictures",
    "description": "Fly one episode headless; print how each drone fared; write trajectories, a plot and an animation.",
    "epilog": """examples:
  bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out
  bulletuav fly hover --airframe hummingbird --difficulty hard --out out
  bulletuav fly lidar_navigation --city urban --out out
  bulletuav fly crossing --dynamics rigid_body --wind 3 0 0 --set lane_spacing=20 --out out""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The task, who flies, from which seed, where to, and the options."""
    parser.add_argument("task", help="one of `bulletuav tasks`")
    parser.add_argument("--policy", help=f"who flies: {POLICY_HELP} (default: the task's)")
    parser.add_argument("--seed", type=int, default=0, help="same seed, same flight (default: 0)")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out"),
        metavar="DIR",
        help="folder for the files (default: out)",
    )
    parser.add_argument(
        "--animation",
        choices=("gif", "mp4", "none"),
        default="gif",
        help="mp4 needs the extra 'video'",
    )
    add_trust(parser)
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """Fly one episode and write its files."""
    as_int("seed", arguments.seed, 0)
    arguments.policy = arguments.policy or find_task(arguments.task).baseline
    pilot = find_policy(arguments.policy, arguments.task, arguments.trust)
    aviary = Aviary(
        arguments.task, 1, **flyable_options(arguments.task, pilot, given_options(arguments))
    )
    policy = pilot(aviary)
    if (arguments.out / EPISODES).exists():
        raise ValueError(f"--out {arguments.out} holds an evaluation: choose another folder")
    for old in out_folder(arguments.out).glob("flight.*"):
        old.unlink()  # of an earlier flight
    flown, most = itertools.count(1), aviary.options.horizon
    with telling("flying", most, "decisions") as progress:
        recording = fly_episode(aviary, policy, arguments.seed, lambda: progress(next(flown)))
    files = save(recording, aviary, arguments.policy, arguments.seed, arguments.out)
    files += _draw(recording, aviary, arguments)
    console = Console()
    console.print(_table(recording, arguments.task, aviary))
    tell_files(console, files)
    aviary.close()


def _draw(recording: Recording, aviary: Aviary, arguments: argparse.Namespace) -> list[Path]:
    airframes, d_safe = aviary.options.airframe, aviary.task.config.d_safe
    names = ", ".join(sorted({airframe.name for airframe in airframes}))
    title = (
        f"{arguments.task}: {aviary.num_drones} {names}, {arguments.policy}, seed {arguments.seed}"
    )
    tracks = arguments.out / "tracks.png"
    plot_tracks(recording, d_safe, title, tracks)
    if arguments.animation == "none":
        return [tracks]
    animation = Animation(recording, d_safe, 2 * aviary.task.context.collision_radius, title)
    path = arguments.out / f"flight.{arguments.animation}"
    drawn = itertools.count(1)
    with telling("drawing", len(animation), "pictures") as progress:
        animation.save(path, lambda: progress(next(drawn)))
    return [tracks, path]


def _table(recording: Recording, task: str, aviary: Aviary) -> Table:
    table = Table(
        title=f"{task}, drones: {aviary.num_drones}, d_safe {aviary.task.config.d_safe:g} m"
    )
    for heading in (
        "drone",
        "reached",
        "nearest m",
        "conflicts",
        "collisions",
        "to goal m",
        "time s",
    ):
        table.add_column(heading, justify="right")
    for row in outcomes(recording):
        table.add_row(
            f"drone_{row.drone}",
            "yes" if row.reached else "no",
            f"{row.min_separation:.2f}" if row.min_separation < float("inf") else "-",
            str(row.conflicts),
            str(row.collisions),
            f"{row.final_distance:.2f}",
            f"{row.time:.2f}",
        )
    return table
