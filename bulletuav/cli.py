"""Command line `bulletuav`: finds the command, runs it, and turns errors into one line.

Its commands are `tasks`, `fly`, `city`, `evaluate`, `compare`, `dataset`, `merge`, `train`,
`tune`, `verify`, `replay`, `export`, `identify`, `incentives`, `serve`, `benchmark` and `doctor`.
"""

import argparse
import difflib
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import NoReturn

from bulletuav.errors import missing
from bulletuav.policies import policy_names
from bulletuav.tasks import list_tasks
from bulletuav.version import __version__

COMMANDS = (
    "tasks",
    "fly",
    "city",
    "evaluate",
    "compare",
    "dataset",
    "merge",
    "train",
    "tune",
    "verify",
    "replay",
    "export",
    "identify",
    "incentives",
    "serve",
    "benchmark",
    "doctor",
)
"""Names of the commands, and of their modules in `bulletuav.commands`"""


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line on standard error and exit code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _module(name: str) -> ModuleType:
    """Import a command, once it is asked for: all of them take seconds."""
    return importlib.import_module(f"bulletuav.commands.{name}")


def _parser(words: Sequence[str]) -> tuple[_Parser, dict[str, _Parser]]:
    """Build the parser of the command line, and those of its commands by name.

    Args:
        words: Words after `bulletuav`. Where the first names a command, the parser knows no other.
    """
    parser = _Parser(
        prog="bulletuav",
        description="A drone-swarm gym on PyBullet.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"bulletuav {__version__}")
    adder = parser.add_subparsers(
        dest="command",
        required=True,
        metavar="COMMAND",
        parser_class=_Parser,
    )
    commands = {}
    for name in words[:1] if words and words[0] in COMMANDS else COMMANDS:
        command = _module(name)
        commands[name] = adder.add_parser(
            name,
            **command.ABOUT,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        command.add_arguments(commands[name])
    return parser, commands


def _complete() -> None:
    """Tell a shell that asks what words come next, where the extra `completion` is installed."""
    try:
        import argcomplete
    except ImportError:
        raise missing("completing words in a shell", "completion") from None
    parser, commands = _parser(os.environ.get("COMP_LINE", "").split(" ")[1:-1])
    offered = {"task": list_tasks, "policy": policy_names}
    for command in commands.values():
        for action in command._actions:
            if action.dest in offered:
                names = offered[action.dest]
                action.completer = lambda names=names, **_: names()  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _check_known(rest: list[str], parser: argparse.ArgumentParser) -> None:
    """Complain about the first argument that no option took."""
    if not rest:
        return
    known = [option for action in parser._actions for option in action.option_strings]
    near = difflib.get_close_matches(rest[0].split("=")[0], known, n=1)
    if near:
        hint = f"did you mean {near[0]}?"
    elif "--set" in known:
        hint = "options without an argument of their own go by --set NAME=VALUE"
    else:
        hint = "there is none of that name"
    parser.error(f"unknown argument {rest[0]}: {hint}")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line.

    Args:
        argv: Words after `bulletuav`; those of the process when left out.

    Raises:
        SystemExit: With code 2 after one line on standard error, for bad input; 130 after an
            interrupt; 128 + SIGPIPE where the reader of the output has gone.
    """
    if "" not in sys.path:  # the current folder, last of all, for names such as mine:Policy
        sys.path.append("")
    # Unknown arguments are collected, not refused, so that the message can name the nearest.
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    words = sys.argv[1:] if argv is None else argv
    parser, commands = _parser(words)
    arguments, rest = parser.parse_known_args(words)
    command = commands[arguments.command]
    _check_known(rest, command)
    try:
        _module(arguments.command).run(arguments)
        # A closed pipe is to be noticed here, not when Python ends.
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has seen enough, as in `bulletuav tasks mec | head`. What Python flushes
        # at its end goes nowhere, so that it does not complain again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except MemoryError as error:
        figures = error or "no figures told"
        command.error(f"memory ran out ({figures}): ask for fewer worlds, drones, users or workers")
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        # These are the errors of bad input; others are bugs and keep their traceback.
        command.error(" ".join(str(error).split()))
    except KeyboardInterrupt:
        sys.exit(130)
