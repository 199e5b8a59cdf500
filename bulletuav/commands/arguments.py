"""Arguments shared by several commands: options of environments, policies and episodes."""

import argparse
import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from bulletuav.analysis.pieces import WorkPiece
from bulletuav.commands.parsers.shared import parse_literal
from bulletuav.commands.progress import show_progress
from bulletuav.envs.options import EnvOptions

Advance = Callable[[int], None]
"""Callback with the number of newly finished episodes"""


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
    parts = [parse_literal(part) for part in text.split(",")]
    if len(parts) == 1 or text[0] in "([{":
        return parse_literal(text)
    return tuple(parts)
