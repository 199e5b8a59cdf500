"""The command line: `bulletuav fly`, `tasks`, `city`, `evaluate`, `compare`, `train`, `benchmark`, `doctor`."""

import argparse
import difflib
import os
import signal
import sys
from collections.abc import Sequence
from types import ModuleType
from typing import NoReturn

from bulletuav.commands import benchmark, city, compare, doctor, evaluate, fly, tasks, train
from bulletuav.version import __version__

COMMANDS: dict[str, ModuleType] = {
    "tasks": tasks,
    "fly": fly,
    "city": city,
    "evaluate": evaluate,
    "compare": compare,
    "train": train,
    "benchmark": benchmark,
    "doctor": doctor,
}


class _Parser(argparse.ArgumentParser):
    """Errors in one line, exit code 2, with the nearest option for a misspelt one."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _parser() -> tuple[_Parser, dict[str, _Parser]]:
    parser = _Parser(
        prog="bulletuav", description="A drone-swarm gym on PyBullet.", allow_abbrev=False
    )
    parser.add_argument("--version", action="version", version=f"bulletuav {__version__}")
    adder = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", parser_class=_Parser
    )
    commands = {}
    for name, command in COMMANDS.items():
        commands[name] = adder.add_parser(
            name,
            **command.ABOUT,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        command.add_arguments(commands[name])
    return parser, commands


def _check_known(rest: list[str], parser: argparse.ArgumentParser) -> None:
    """Complain about the first argument that no option took."""
    if rest:
        known = [option for action in parser._actions for option in action.option_strings]
        near = difflib.get_close_matches(rest[0].split("=")[0], known, n=1)
        hint = (
            f"did you mean {near[0]}?"
            if near
            else "options without an argument of their own go by --set NAME=VALUE"
        )
        parser.error(
            f"unknown argument {rest[0]}: {hint if near or '--set' in known else 'there is none of that name'}"
        )


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point. Bad input ends in one line on standard error and exit code 2."""
    if "" not in sys.path:  # the current folder, last of all, for `--policy module:Name`
        sys.path.append("")
    parser, commands = _parser()
    arguments, rest = parser.parse_known_args(argv)
    command = commands[arguments.command]
    _check_known(rest, command)
    try:
        COMMANDS[arguments.command].run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # `bulletuav tasks mec | head` has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(128 + signal.SIGPIPE)
    except MemoryError as error:
        command.error(
            f"memory ran out ({error or 'no figures told'}): ask for fewer worlds, drones, users or workers"
        )
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        command.error(" ".join(str(error).split()))
    except KeyboardInterrupt:
        sys.exit(130)
