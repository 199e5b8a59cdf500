"""Options of environments on the command line."""

import argparse
import ast
import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import Console

from bulletuav.commands.progress import telling
from bulletuav.control.actions import ACTIONS
from bulletuav.control.cascade import CONTROLLERS
from bulletuav.dynamics.ladder import LADDER
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve import resolve
from bulletuav.policies import PolicySpec, policy_names
from bulletuav.tasks import find_task
from bulletuav.vehicle.airframe import available_airframes

Advance = Callable[[int], None]
POLICY_HELP = (
    f"{', '.join(policy_names())}, module:Name of a class of your own, the folder of a training "
    f"run, or ppo:model.zip (see --trust)"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Arguments for the options that all tasks have, and --set for the others."""
    parser.add_argument(
        "--drones", type=int, dest="num_drones", metavar="N", help="number of drones"
    )
    parser.add_argument("--airframe", help=f"{', '.join(available_airframes())}, or path of a URDF")
    parser.add_argument("--dynamics", help=f"{', '.join(LADDER)} (default: bullet)")
    parser.add_argument(
        "--action", help=f"{', '.join(ACTIONS)} (default: the task's, or one that the policy gives)"
    )
    parser.add_argument("--controller", help=f"{' or '.join(CONTROLLERS)} (default: lee)")
    parser.add_argument("--difficulty", help="easy, medium, hard or extreme")
    parser.add_argument(
        "--physics-hz", type=int, metavar="HZ", help="physics substeps a second (default: 240)"
    )
    parser.add_argument("--decision-hz", type=int, metavar="HZ", help="decisions a second")
    parser.add_argument(
        "--horizon", type=int, metavar="STEPS", help="decisions until the episode is cut"
    )
    parser.add_argument("--max-speed", type=float, metavar="M/S", help="speed limit")
    parser.add_argument(
        "--city",
        help="suburban, urban, dense, high_rise; alpha,beta,gamma; or a .geojson or .obj file",
    )
    parser.add_argument("--turbulence", help="Dryden gusts: light, moderate or severe")
    parser.add_argument("--preset", help="named set of options, see `bulletuav tasks TASK`")
    parser.add_argument(
        "--wind", type=float, nargs=3, metavar=("EAST", "NORTH", "UP"), help="steady wind in m/s"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other option of `bulletuav tasks TASK`, such as spacing=3 or weights={'goal':10}; repeatable",
    )


def given_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Options as keyword arguments of an environment, from those given on the command line."""
    names = {field.name for field in dataclasses.fields(EnvOptions)} - {"seed"} | {"city"}
    options = {
        name: value
        for name, value in vars(arguments).items()
        if name in names and value is not None
    }
    if "city" in options:
        options["city"] = _value(options["city"])
    return literals("--set", arguments.set, options)


def literals(
    option: str, pairs: Iterable[str], known: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """The `known` values and those of NAME=VALUE pairs. Raises ValueError for another form, or a name that comes twice."""
    values = dict(known)
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ValueError(f"{option} {pair}: NAME=VALUE is needed")
        if name in values:
            raise ValueError(f"{option} {pair}: {name} is given twice")
        values[name] = _value(text)
    return values


def _value(text: str) -> Any:
    """A literal, or several with commas between them."""
    parts = [_literal(part) for part in text.split(",")]
    return _literal(text) if len(parts) == 1 or text[0] in "([{" else tuple(parts)


def flyable_options(task: str, pilot: PolicySpec, options: dict[str, Any]) -> dict[str, Any]:
    """The options, with those that a trained policy needs, and an action that the policy can give where none is asked."""
    options = {**pilot.options, **options}
    if (
        not pilot.actions
        or "action" in options
        or resolve(find_task(task), options)[0].action in pilot.actions
    ):
        return options
    return {**options, "action": pilot.actions[0]}


@contextlib.contextmanager
def episodes_bar(total: int) -> Iterator[Advance]:
    """Tell how far an evaluation is; the function that it yields takes how many more episodes are done."""
    done = 0
    with telling("flying", total, "episodes") as progress:

        def advance(episodes: int) -> None:
            nonlocal done
            done += episodes
            progress(done)

        yield advance


def add_trust(parser: argparse.ArgumentParser) -> None:
    """The argument by which a user vouches for files that can run code."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="read models that stable-baselines3 saved (ppo:model.zip): such a file can run any code on this machine, so "
        "say this only of files whose maker you know",
    )


def add_episodes(parser: argparse.ArgumentParser) -> None:
    """Arguments for how many episodes, from which seed, in how many processes."""
    parser.add_argument(
        "--episodes", type=int, default=100, help="of each policy in each task (default: 100)"
    )
    parser.add_argument("--seed", type=int, default=0, help="episode e has seed + e (default: 0)")
    parser.add_argument(
        "--workers", type=int, default=1, help="processes; the results are the same (default: 1)"
    )
    add_trust(parser)


def tell_files(console: Console, files: Iterable[Path]) -> None:
    """Print where the files are."""
    console.print("\n".join(f"wrote {path}" for path in files), highlight=False, soft_wrap=True)


def out_folder(path: Path) -> Path:
    """The folder, made if it is not there. Raises ValueError where it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {path} cannot be a folder to write to: {error.strerror}") from None
    return path


def _literal(text: str) -> Any:
    """A number, None, a Python literal, or the text itself."""
    try:
        return ast.literal_eval({"true": "True", "false": "False"}.get(text, text))
    except (ValueError, SyntaxError, TypeError):
        return float(text) if text.strip() in ("nan", "inf", "-inf") else text
