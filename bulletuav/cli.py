"""Command line `bulletuav`: finds the command, runs it, and turns errors into one line.

Its commands are `tasks`, `fly`, `city`, `evaluate`, `compare`, `dataset`, `merge`, `train`,
`tune`, `verify`, `replay`, `export`, `identify`, `incentives`, `serve`, `benchmark` and `doctor`.
"""

import argparse
import difflib
import importlib
import io
import itertools
import os
import signal
import sys
import textwrap
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any, NoReturn

from bulletuav import interrupts
from bulletuav.errors import missing, unknown
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
DESCRIPTION = """A drone-swarm gym on PyBullet: flies drones through tasks, draws the flights,
trains policies and compares them."""
EPILOG = """first example:
  bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out

`bulletuav COMMAND --help` explains a command."""


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Formatter that wraps texts of one line; those of several lines are laid out already."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return super()._fill_text(text, width, indent)
        return textwrap.fill(text, width, initial_indent=indent, subsequent_indent=indent)


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line on standard error and exit code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Offer the nearest choice for a word that is none, as argparse of Python 3.14 can."""
        if action.choices is not None and value not in action.choices:
            what = "command" if action.dest == "command" else f"value of {action.option_strings[0]}"
            raise argparse.ArgumentError(None, str(unknown(what, value, action.choices)))


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
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=_Formatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"bulletuav {__version__}")
    adder = parser.add_subparsers(
        dest="command",
        title="commands",
        metavar="COMMAND",
        parser_class=_Parser,
    )
    commands = {}
    for name in words[:1] if words and words[0] in COMMANDS else COMMANDS:
        command = _module(name)
        commands[name] = adder.add_parser(
            name,
            **command.ABOUT,
            formatter_class=_Formatter,
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


def _check_known(words: Iterable[str], parser: argparse.ArgumentParser) -> None:
    """Complain about the first option that the command does not have.

    Before argparse does: it would miss a required option instead of naming the one misspelt.
    """
    known = [option for action in parser._actions for option in action.option_strings]
    options = (word.partition("=")[0] for word in words if word.startswith("--"))
    for option in itertools.takewhile(lambda option: option != "--", options):
        if option in known:
            continue
        near = difflib.get_close_matches(option, known, n=1)
        if near:
            hint = f"did you mean {near[0]}?"
        elif "--set" in known:
            hint = "options without an argument of their own go by --set NAME=VALUE"
        else:
            hint = "there is none of that name"
        parser.error(f"unknown argument {option}: {hint}")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line.

    Args:
        argv: Words after `bulletuav`; those of the process when left out.

    Raises:
        SystemExit: With code 2 after one line on standard error, for bad input; 130 after one line
            for an interrupt; 128 + SIGPIPE where the reader of the output has gone.
    """
    try:
        _run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt as interrupt:
        # Commands that keep something raise it again, with a text that says what
        sys.stderr.write(f"{str(interrupt) or interrupts.TEXT}\n")
        sys.exit(interrupts.STATUS)


def _run(words: Sequence[str]) -> None:
    """Find the command, run it, and turn errors of bad input into one line; see `main`."""
    # Names of files may have bytes that a strict stream refuses, when all work is done
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")
    if "" not in sys.path:  # the current folder, last of all, for names such as mine:Policy
        sys.path.append("")
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    parser, commands = _parser(words)
    if not words:
        parser.print_help()
        return
    if words[0] in commands:
        _check_known(words[1:], commands[words[0]])
    else:
        _check_known(words, parser)
    arguments, rest = parser.parse_known_args(words)
    if arguments.command is None:
        parser.error("no COMMAND is given")
    command = commands[arguments.command]
    if rest:
        command.error(f"unknown argument {rest[0]}: there is no place for it")
    try:
        with interrupts.raising():
            _module(arguments.command).run(arguments)
            # A closed pipe is to be noticed here, not when Python ends. Without an open standard
            # output there is no stream.
            if sys.stdout is not None:
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
