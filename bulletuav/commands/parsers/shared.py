"""Arguments shared by several commands."""

import argparse
import ast
from typing import TYPE_CHECKING, Any

from bulletuav.commands.parsers.deferred import DeferredHelp

if TYPE_CHECKING:
    from bulletuav.analysis.pieces import WorkPiece


@DeferredHelp
def policy_help() -> str:
    """List the policies."""
    from bulletuav.policies import policy_names

    return (
        f"{', '.join(policy_names())}, module:Name of your own class, the folder of a training "
        f"run, or ppo:model.zip (see --trust); in team tasks one for each team, such as "
        f"'lead vs flee'"
    )


@DeferredHelp
def task_policy_help() -> str:
    """List the policies, with the default of a task."""
    return f"{policy_help.compose()} (default: the baseline of the task)"


@DeferredHelp
def _airframes() -> str:
    from bulletuav.vehicle.airframes import available_airframes

    return f"{', '.join(available_airframes())}, or the path of a URDF file"


@DeferredHelp
def _dynamics() -> str:
    from bulletuav.dynamics import DYNAMICS

    return f"{', '.join(DYNAMICS)} (default: bullet, or rigid_body without PyBullet)"


@DeferredHelp
def _actions() -> str:
    from bulletuav.control.actions import ACTIONS

    return (
        f"action space: {', '.join(ACTIONS)} (default: that of the task, or one that the "
        f"dynamics and the policy support)"
    )


@DeferredHelp
def _controllers() -> str:
    from bulletuav.control.cascade import CONTROLLERS

    return f"controller: {' or '.join(CONTROLLERS)} (default: lee)"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add arguments for common options of environments, and --set for all others."""
    # Drones and control
    parser.add_argument(
        "--drones",
        type=_parse_drones,
        dest="num_drones",
        metavar="N",
        help="number of drones; or 4,12, from which each episode draws its number",
    )
    parser.add_argument("--airframe", help=_airframes)
    parser.add_argument("--dynamics", help=_dynamics)
    parser.add_argument("--action", help=_actions)
    parser.add_argument("--controller", help=_controllers)
    # Difficulty and time
    parser.add_argument("--difficulty", help="easy, medium, hard or extreme")
    parser.add_argument(
        "--physics-hz", type=int, metavar="HZ", help="physics steps per second (default: 240)"
    )
    parser.add_argument(
        "--decision-hz", type=parse_literal, metavar="HZ", help="decisions per second"
    )
    parser.add_argument(
        "--horizon", type=int, metavar="STEPS", help="maximum decisions of an episode (truncation)"
    )
    parser.add_argument("--max-speed", type=float, metavar="M/S", help="speed limit of the drones")
    parser.add_argument(
        "--city",
        help="suburban, urban, dense, high_rise; hills, forest, wooded_hills; alpha,beta,gamma; "
        "or a .geojson, .json, .obj file",
    )
    # Wind, presets and other options
    parser.add_argument("--turbulence", help="Dryden gusts: light, moderate or severe")
    parser.add_argument("--preset", help="named set of options, see `bulletuav tasks TASK --all`")
    parser.add_argument(
        "--wind",
        type=float,
        nargs=3,
        metavar=("EAST", "NORTH", "UP"),
        help="steady wind in m/s",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=(
            "any other option of `bulletuav tasks TASK --all`, such as spacing=3 or "
            "weights={'goal':10}; can be repeated"
        ),
    )


def add_trust(parser: argparse.ArgumentParser) -> None:
    """Add --trust, which permits files that can run code."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help=(
            "load models that stable-baselines3 saved (ppo:model.zip), and import modules that a "
            "run.yaml names. Such files can run any code on this machine: use this option only "
            "for files from a source that you trust"
        ),
    )


def add_episodes(parser: argparse.ArgumentParser) -> None:
    """Add the arguments --episodes, --seed, --workers and --trust."""
    parser.add_argument(
        "--episodes",
        type=int,
        default=100,
        help="number of episodes of each policy in each task (default: 100)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="episode e has the seed SEED + e (default: 0)"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="number of processes; it does not change the results (default: 1)",
    )
    add_trust(parser)


def add_sharing(parser: argparse.ArgumentParser) -> None:
    """Add --piece and --ray, which distribute episodes to several machines."""
    parser.add_argument(
        "--piece",
        type=_parse_piece,
        metavar="K/N",
        help="run part K of N, such as one job of a job array; `bulletuav merge` joins the parts",
    )
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="run on a Ray cluster, such as auto or 10.0.0.1:6379 (extra ray); local starts one",
    )


def _parse_drones(text: str) -> int | tuple[int, int]:
    parts = text.split(",")
    if not all(part.strip().isdecimal() for part in parts) or len(parts) > 2:
        raise argparse.ArgumentTypeError(f"{text}: a number, or a range such as 4,12, is needed")
    low, *high = (int(part) for part in parts)
    return (low, high[0]) if high else low


def _parse_piece(text: str) -> "WorkPiece":
    from bulletuav.analysis.pieces import parse_piece  # which imports NumPy

    try:
        return parse_piece(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def parse_literal(text: str) -> Any:
    """Parse a number, a bool, None or another Python literal, or else return the text."""
    try:
        return ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
    except (ValueError, SyntaxError, TypeError):
        # Python has no literals for these three
        return float(text) if text.strip() in ("nan", "inf", "-inf") else text
