"""Arguments that several commands share: options of environments, policies and episodes."""

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
"""Function that takes how many more episodes are done"""
POLICY_HELP = (
    f"{', '.join(policy_names())}, module:Name of a class of your own, the folder of a training "
    f"run, or ppo:model.zip (see --trust); for teams one each, such as 'lead vs flee'"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add arguments for the options that all tasks have, and --set for the others."""
    # Who flies and how
    parser.add_argument(
        "--drones", type=int, dest="num_drones", metavar="N", help="number of drones"
    )
    parser.add_argument(
        "--airframe", help=f"{', '.join(available_airframes())}, or the path of a URDF"
    )
    parser.add_argument("--dynamics", help=f"{', '.join(DYNAMICS)} (default: bullet)")
    parser.add_argument(
        "--action",
        help=f"{', '.join(ACTIONS)} (default: the task's, or one that the dynamics and "
        f"the policy take)",
    )
    parser.add_argument("--controller", help=f"{' or '.join(CONTROLLERS)} (default: lee)")
    # How hard and how long
    parser.add_argument("--difficulty", help="easy, medium, hard or extreme")
    parser.add_argument(
        "--physics-hz", type=int, metavar="HZ", help="physics substeps a second (default: 240)"
    )
    parser.add_argument(
        "--decision-hz", type=_parse_literal, metavar="HZ", help="decisions a second"
    )
    parser.add_argument(
        "--horizon", type=int, metavar="STEPS", help="decisions until the episode is cut"
    )
    parser.add_argument("--max-speed", type=float, metavar="M/S", help="speed limit")
    parser.add_argument(
        "--city",
        help="suburban, urban, dense, high_rise; alpha,beta,gamma; or a .geojson or .obj file",
    )
    # The air, and a name for many options
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
    """Add the argument by which a user vouches for files that can run code."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help=(
            "read models that stable-baselines3 saved (ppo:model.zip), and import modules that a "
            "run.yaml names. Such a file can run any code on this machine: use it only for files "
            "whose maker you know"
        ),
    )


def add_episodes(parser: argparse.ArgumentParser) -> None:
    """Add arguments for how many episodes to fly, from which seed, in how many processes."""
    parser.add_argument(
        "--episodes",
        type=int,
        default=100,
        help="episodes of each policy in each task (default: 100)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="episode e has the seed SEED + e (default: 0)"
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="processes; their number does not change the results (default: 1)",
    )
    add_trust(parser)


def add_sharing(parser: argparse.ArgumentParser) -> None:
    """Add arguments by which several machines share the episodes."""
    parser.add_argument(
        "--piece",
        type=_parse_piece,
        metavar="K/N",
        help="fly the K-th of N parts, such as one job of an array; `bulletuav merge` joins them",
    )
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="fly on a Ray cluster, such as auto or 10.0.0.1:6379 (extra ray); local begins one",
    )


def _parse_piece(text: str) -> WorkPiece:
    """Read K/N."""
    try:
        return parse_piece(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def print_piece(piece: WorkPiece, out: Path) -> None:
    """Print that a piece was flown, and the command that joins all pieces."""
    print(f"flew piece {piece.number} of {piece.of}; when all are there: bulletuav merge {out}")


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Collect the options of an environment that were given on the command line.

    Args:
        arguments: Parsed arguments of a command with those of `add_options`.

    Returns:
        Keyword arguments of an environment.

    Raises:
        ValueError: A --set is not of the form NAME=VALUE, or an option is given twice.
    """
    # The seed is not an option of the environment here: every episode has its own.
    names = {field.name for field in dataclasses.fields(EnvOptions)} - {"seed"} | {"city"}
    options = {
        name: value
        for name, value in vars(arguments).items()
        if name in names and value is not None
    }
    # A city can be a name, a file, or three numbers with commas between them.
    if "city" in options:
        options["city"] = _parse_value(options["city"])
    return parse_pairs("--set", arguments.set, options)


def parse_pairs(
    option: str,
    pairs: Iterable[str],
    known: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """Parse NAME=VALUE pairs.

    Args:
        option: The argument that they come from, to be named in errors.
        pairs: Texts of the form NAME=VALUE.
        known: Values that are set already.

    Returns:
        The known values and those of the pairs.

    Raises:
        ValueError: A text has another form, or a name comes twice.
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
    """Show how far an evaluation is.

    Args:
        total: Episodes to fly.

    Yields:
        A function to call with how many more episodes are done.
    """
    done = 0
    with show_progress("flying", total, "episodes") as report:

        def advance(episodes: int) -> None:
            nonlocal done
            done += episodes
            report(done)

        yield advance


def out_folder(path: Path) -> Path:
    """Make the folder for the files of a command, if it is not there.

    Raises:
        ValueError: It cannot be made; the message tells why.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {path} cannot be a folder to write to: {error.strerror}") from None
    return path


def _parse_value(text: str) -> Any:
    """Parse a literal, or several with commas between them, which become a tuple."""
    # A literal such as (1, 2) or {"goal": 10} has commas of its own.
    parts = [_parse_literal(part) for part in text.split(",")]
    if len(parts) == 1 or text[0] in "([{":
        return _parse_literal(text)
    return tuple(parts)


def _parse_literal(text: str) -> Any:
    """Parse a number, a truth value, None or another Python literal, or else keep the text."""
    try:
        return ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
    except (ValueError, SyntaxError, TypeError):
        # Python has no literals for these three.
        return float(text) if text.strip() in ("nan", "inf", "-inf") else text
