"""Arguments of `bulletuav fly`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp
from bulletuav.commands.parsers.shared import add_options, add_trust, task_policy_help

ABOUT = {
    "help": "fly one episode and write trajectories and pictures",
    "description": (
        "Fly one episode without a window. Print the outcome of each drone. Write trajectories, "
        "a plot and an animation. With --mission FILE, fly a mission of QGroundControl or "
        "Mission Planner."
    ),
    "epilog": """examples:
  bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out
  bulletuav fly crossing --html --animation none --out out
  bulletuav fly crossing --live --out out
  bulletuav fly hover --airframe hummingbird --difficulty hard --out out
  bulletuav fly lidar_navigation --city urban --out out
  bulletuav fly crossing --dynamics rigid_body --wind 3 0 0 --set lane_spacing=20 --out out""",
}


@DeferredHelp
def _replay() -> str:
    from bulletuav.report.replay import REPLAY

    return f"also write {REPLAY}, a 3-D replay for browsers"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add task, policy, seed, output files and environment options."""
    parser.add_argument("task", nargs="?", help="one of `bulletuav tasks`")
    parser.add_argument(
        "--mission",
        type=Path,
        metavar="FILE",
        help="fly a QGroundControl .plan or a .waypoints file instead of a task, with one drone",
    )
    parser.add_argument(
        "--speed",
        type=float,
        metavar="M/S",
        help="speed of the mission's legs (default: that of the file, or 5)",
    )
    parser.add_argument(
        "--home",
        type=float,
        nargs=3,
        metavar=("LATITUDE", "LONGITUDE", "ALTITUDE"),
        help="start of the mission, degrees and m (default: that of the file)",
    )
    parser.add_argument("--policy", help=task_policy_help)
    parser.add_argument(
        "--seed",
        type=int,
        default=0,
        help="random seed; equal seeds give equal flights (default: 0)",
    )
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
        help="format of the animation; mp4 needs the extra 'video' (default: gif)",
    )
    parser.add_argument("--html", action="store_true", help=_replay)
    from bulletuav.envs.viewer import DEFAULT_ADDRESS  # which imports NumPy

    for name, where in (("live", "in browsers"), ("foxglove", "in Foxglove")):
        parser.add_argument(
            f"--{name}",
            nargs="?",
            const=DEFAULT_ADDRESS,
            metavar="HOST:PORT",
            help=f"show the flight {where} while it runs (default: {DEFAULT_ADDRESS})",
        )
    add_trust(parser)
    add_options(parser)
