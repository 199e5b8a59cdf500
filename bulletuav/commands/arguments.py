"""Arguments shared by several commands: options of environments, policies and episodes."""

import argparse
import ast
import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bulletuav.analysis.pieces import WorkPiece, parse_piece
from bulletuav.commands.progress import show_progress
from bulletuav.control.actions import ACTIONS
from bulletuav.control.cascade import CONTROLLERS
from bulletuav.dynamics import DYNAMICS
from bulletuav.envs.options import EnvOptions
from bulletuav.policies import policy_names
from bulletuav.vehicle.airframes import available_airframes

Advance = Callable[[int], None]
"""Callback with the number of newly finished episodes"""
POLICY_HELP = (
    f"{', '.join(policy_names())}, module:Name of your own class, the folder of a training "
    f"run, or ppo:model.zip (see --trust); in team tasks one for each team, such as 'lead vs flee'"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add arguments for common options of environments, and --set for all others."""
    # Drones and control
    parser.add_argument(
        "--drones", type=int, dest="num_drones", metavar="N", help="number of drones"
    )
    parser.add_argument(
        "--airframe", help=f"{', '.join(available_airframes())}, or the path of a URDF file"
    )
    parser.add_argument(
        "--dynamics",
        help=f"{', '.join(DYNAMICS)} (default: bullet, or rigid_body without PyBullet)",
    )
    parser.add_argument(
        "--action",
        help=f"action space: {', '.join(ACTIONS)} (default: that of the task, or one that the "
        f"dynamics and the policy support)",
    )
    parser.add_argument(
        "--controller", help=f"controller: {' or '.join(CONTROLLERS)} (default: lee)"
    )
    # Difficulty and time
    parser.add_argument("--difficulty", help="easy, medium, hard or extreme")
    parser.add_argument(
        "--physics-hz", type=int, metavar="HZ", help="physics steps per second (default: 240)"
    )
    parser.add_argument(
        "--decision-hz", type=_parse_literal, metavar="HZ", help="decisions per second"
    )
    parser.add_argument(
        "--horizon", type=int, metavar="STEPS", help="maximum decisions of an episode (truncation)"
    )
    parser.add_argument("--max-speed", type=float, metavar="M/S", help="speed limit of the drones")
    parser.add_argument(
        "--city",
        help="suburban, urban, dense, high_rise; alpha,beta,gamma; or a .geojson or .obj file",
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


def _parse_piece(text: str) -> WorkPiece:
    try:
        return parse_piece(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def print_piece(piece: WorkPiece, out: Path) -> None:
    """Print that a piece is done, and the command that joins all pieces."""
    print(f"finished piece {piece.number} of {piece.of}; when all are done: bulletuav merge {out}")


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the environment options that were given on the command line.

    Args:
        arguments: Parsed arguments of a command that uses `add_options`.

    Returns:
        Keyword arguments of the environment.

    Raises:
        ValueError: If a --set is not of the form NAME=VALUE, or an option is given twice.
    """
    # Without the seed: each episode has its own
    names = {field.name for field in dataclasses.fields(EnvOptions)} - {"seed"} | {"city"}
    options = {
        name: value
        for name, value in vars(arguments).items()
        if name in names and value is not None
    }
    # A city is a name, a file, or three comma-separated numbers
    if "city" in options:
        options["city"] = _parse_value(options["city"])
    return parse_pairs("--set", arguments.set, options)


def parse_pairs(
    option: str, pairs: Iterable[str], known: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Parse NAME=VALUE pairs.

    Args:
        option: The argument that the pairs come from, for messages.
        pairs: Texts of the form NAME=VALUE.
        known: Values that are already set.

    Returns:
        The known values and the values of the pairs.

    Raises:
        ValueError: If a text has another form, or a name is given twice.
    """
    values = dict(known)
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ValueError(f"{option} {pair}: NAME=VALUE is needed")
        if name in values:
            raise ValueError(f"{option} {pair}: {name} is given twice")
        values[name] = _parse_value(text)
    return values


@contextlib.contextmanager
def show_episodes(total: int) -> Iterator[Advance]:
    """Show the progress of an evaluation.

    Args:
        total: Number of episodes.

    Yields:
        A callback for the number of newly finished episodes.
    """
    done = 0
    with show_progress("flying", total, "episodes") as report:

        def advance(episodes: int) -> None:
            nonlocal done
            done += episodes
            report(done)

        yield advance


def make_out_folder(path: Path) -> Path:
    """Create the output folder of a command if it does not exist.

    Raises:
        ValueError: If the folder cannot be created. The message contains the reason.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {path} cannot be a folder to write to: {error.strerror}") from None
    return path


def _parse_value(text: str) -> Any:
    """Parse a literal, or comma-separated literals, which become a tuple."""
    # A literal such as (1, 2) or {"goal": 10} contains commas itself
    parts = [_parse_literal(part) for part in text.split(",")]
    if len(parts) == 1 or text[0] in "([{":
        return _parse_literal(text)
    return tuple(parts)


def _parse_literal(text: str) -> Any:
    """Parse a number, a bool, None or another Python literal, or else return the text."""
    try:
        return ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
    except (ValueError, SyntaxError, TypeError):
        # Python has no literals for these three
        return float(text) if text.strip() in ("nan", "inf", "-inf") else text
