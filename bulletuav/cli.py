"""Command line `bulletuav`: find the command, run it, and report errors on one line.

The commands are `tasks`, `fly`, `city`, `evaluate`, `compare`, `dataset`, `merge`, `train`,
`tune`, `verify`, `replay`, `export`, `convert`, `identify`, `reproduce`, `incentives`, `serve`,
`benchmark`, `compile` and `doctor`.
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
from bulletuav.commands.parsers.deferred import DeferredHelp
from bulletuav.version import DOCUMENTATION, __version__

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
    "convert",
    "identify",
    "reproduce",
    "incentives",
    "serve",
    "benchmark",
    "compile",
    "doctor",
)
"""Names of the commands, and of their modules in `bulletuav.commands` and its `parsers`"""
DESCRIPTION = """A drone-swarm gym on PyBullet: flies drones through tasks, draws the flights,
trains policies and compares them."""
EPILOG = """first example:
  bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out

`bulletuav COMMAND --help` explains a command."""

MENU = f"""bulletuav {__version__}, a drone-swarm gym on PyBullet. Next steps:

  bulletuav tasks                                 list the tasks
  bulletuav fly crossing --policy orca            fly once, write files to out/
  bulletuav replay out                            write a 3-D replay of it
  bulletuav train crossing --steps 2e5 --out run  train a policy (extra sb3)
  bulletuav evaluate run                          evaluate the policy
  bulletuav doctor                                print what is missing
  bulletuav --help                                list all commands

Documentation: {DOCUMENTATION}"""
"""Text that `bulletuav` without arguments prints"""


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Formatter that wraps single-line texts and keeps the layout of multi-line texts."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return super()._fill_text(text, width, indent)
        return textwrap.fill(text, width, initial_indent=indent, subsequent_indent=indent)

    def _get_help_string(self, action: argparse.Action) -> str | None:
        help_text = action.help
        return help_text.compose() if isinstance(help_text, DeferredHelp) else help_text


class _Parser(argparse.ArgumentParser):
    """Parser that reports an error as one line on standard error and exits with code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Suggest the closest match for an invalid choice, as argparse of Python 3.14 does."""
        if action.choices is not None and value not in action.choices:
            from bulletuav.errors import unknown  # which imports NumPy

            what = "command" if action.dest == "command" else f"value of {action.option_strings[0]}"
            raise argparse.ArgumentError(None, str(unknown(what, value, action.choices)))

    def _check_help(self, action: argparse.Action) -> None:
        """Do not compose help texts when an argument is added, as Python 3.14 does."""


def _module(name: str) -> ModuleType:
    """Import the module of a command on demand: importing all of them takes seconds."""
    return importlib.import_module(f"bulletuav.commands.{name}")


def _parser(words: Sequence[str]) -> tuple[_Parser, dict[str, _Parser]]:
    """Build the parser of the command line, and the parsers of the commands by name.

    Args:
        words: Arguments after `bulletuav`. If the first one is a command, only the parser of this
            command is built, and otherwise all without their arguments.
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
    is_command = bool(words) and words[0] in COMMANDS
    for name in words[:1] if is_command else COMMANDS:
        declaration = _module(f"parsers.{name}")
        commands[name] = adder.add_parser(
            name,
            **declaration.ABOUT,
            formatter_class=_Formatter,
            allow_abbrev=False,
        )
        if is_command:
            declaration.add_arguments(commands[name])
    return parser, commands


def _complete() -> None:
    """Print the completions that a shell requests, if the extra `completion` is installed."""
    try:
        import argcomplete
    except ImportError:
        from bulletuav.errors import missing_extra

        raise missing_extra("completing words in a shell", "completion") from None
    from bulletuav.catalogue import list_names, list_policies

    parser, commands = _parser(os.environ.get("COMP_LINE", "").split(" ")[1:-1])
    offered = {"task": lambda: list_names("task"), "policy": list_policies}
    for command in commands.values():
        for action in command._actions:
            if action.dest in offered:
                names = offered[action.dest]
                action.completer = lambda names=names, **_: names()  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _check_known(words: Iterable[str], parser: argparse.ArgumentParser) -> None:
    """Report the first option that the command does not have.

    This check runs before argparse, which would report a missing required option instead of the
    misspelt one.
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
            hint = "environment options that are not listed in --help are set by --set NAME=VALUE"
        else:
            hint = "there is no such option"
        parser.error(f"unknown argument {option}: {hint}")


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line.

    Args:
        argv: Arguments after `bulletuav`; `sys.argv[1:]` if None.

    Raises:
        SystemExit: With code 2 after one line on standard error, for invalid input; 130 after one
            line, for an interrupt; 128 + SIGPIPE if the reader of the output has closed the pipe.
    """
    try:
        _run(sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt as interrupt:
        # Commands that keep results raise it again with a text that says which
        sys.stderr.write(f"{str(interrupt) or interrupts.TEXT}\n")
        sys.exit(interrupts.EXIT_STATUS)


def _run(words: Sequence[str]) -> None:
    """Find the command, run it, and report invalid input on one line; see `main`."""
    # File names may contain bytes that a strict stream cannot encode, after all work is done
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")
    if "" not in sys.path:  # the current folder, last, for names such as mine:Policy
        sys.path.append("")
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    if not words:
        sys.stdout.write(f"{MENU}\n")  # without the parsers, which take longer than the rest
        return
    parser, commands = _parser(words)
    if words[0] in commands:
        _check_known(words[1:], commands[words[0]])
    else:
        _check_known(words, parser)
    arguments, rest = parser.parse_known_args(words)
    if arguments.command is None:
        parser.error("no COMMAND is given")
    command = commands[arguments.command]
    if rest:
        command.error(f"unexpected argument {rest[0]}: the command takes no further arguments")
    try:
        with interrupts.raise_interrupts():
            _module(arguments.command).run(arguments)
            # Flush here, so that a closed pipe is noticed now and not when Python exits. Without an
            # open standard output, sys.stdout is None.
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        # The reader has closed the pipe, as in `bulletuav tasks mec | head`. Python's flush at exit
        # goes to devnull, so that it raises no second error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except MemoryError as error:
        figures = error or "size unknown"
        command.error(f"memory ran out ({figures}): ask for fewer worlds, drones, users or workers")
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        # Errors of invalid input; all others are bugs and keep their traceback
        command.error(" ".join(str(error).split()))
