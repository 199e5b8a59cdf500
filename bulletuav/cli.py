"""The command line: `bulletuav fly`, `bulletuav tasks`, `bulletuav benchmark`, `bulletuav doctor`."""

import argparse
import ast
import dataclasses
import difflib
import inspect
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from bulletuav.benchmark import FLOORS, ROUNDS, SIZES, measure
from bulletuav.control.actions import ACTIONS
from bulletuav.control.cascade import CONTROLLERS
from bulletuav.doctor import Finding, examine
from bulletuav.envs.aviary import Aviary
from bulletuav.envs.options import Options
from bulletuav.physics.airframe import available_airframes
from bulletuav.physics.ladder import LADDER
from bulletuav.pictures import Animation, plot_tracks
from bulletuav.policies import POLICIES, find_policy
from bulletuav.record import Recording, fly_episode, outcomes, save
from bulletuav.tasks import find_task, list_tasks
from bulletuav.version import __version__

FLY_EXAMPLES = """examples:
  bulletuav fly crossing --drones 8 --policy straight --seed 0 --out out
  bulletuav fly hover --airframe hummingbird --difficulty hard --out out
  bulletuav fly crossing --dynamics rigid_body --wind 3 0 0 --set lane_spacing=20 --out out"""


class _Parser(argparse.ArgumentParser):
    """Errors in one line, exit code 2, with the nearest option for a misspelt one."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def _parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    parser = _Parser(prog="bulletuav", description="A drone-swarm gym on PyBullet.", allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"bulletuav {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    tasks = commands.add_parser(
        "tasks", help="list the tasks, or print one's MDP and options", allow_abbrev=False, description="List the tasks."
    )
    tasks.add_argument("task", nargs="?", help="print this task's MDP and options")
    fly = commands.add_parser(
        "fly",
        help="fly one episode and write trajectories and pictures",
        description="Fly one episode headless; print how each drone fared; write trajectories, a plot and an animation.",
        epilog=FLY_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    _add_fly_arguments(fly)
    benchmark = commands.add_parser(
        "benchmark",
        help="measure this machine: drone-substeps per CPU-second of every dynamics",
        description="Print drone-substeps per CPU-second of every dynamics beside the engine's floor, and reset times.",
        allow_abbrev=False,
    )
    benchmark.add_argument("--drones", type=int, nargs="+", default=list(SIZES), metavar="N", help="swarm sizes")
    benchmark.add_argument("--seconds", type=float, default=0.3, help="CPU time of one measurement (default: 0.3)")
    doctor = commands.add_parser(
        "doctor",
        help="tell versions, what is active and what is missing",
        description="Tell versions, whether the C extension is active, and what is missing with its remedy.",
        allow_abbrev=False,
    )
    return parser, {"tasks": tasks, "fly": fly, "benchmark": benchmark, "doctor": doctor}


def _add_fly_arguments(fly: argparse.ArgumentParser) -> None:
    fly.add_argument("task", help="one of `bulletuav tasks`")
    fly.add_argument("--policy", default="straight", help=f"who flies: {', '.join(POLICIES)} (default: straight)")
    fly.add_argument("--seed", type=int, default=0, help="same seed, same flight (default: 0)")
    fly.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="folder for the files (default: out)")
    fly.add_argument("--drones", type=int, dest="num_drones", metavar="N", help="number of drones")
    fly.add_argument("--airframe", help=f"{', '.join(available_airframes())}, or path of a URDF")
    fly.add_argument("--dynamics", help=f"{', '.join(LADDER)} (default: bullet)")
    fly.add_argument("--action", help=f"{', '.join(ACTIONS)} (default: the task's, or one that the policy gives)")
    fly.add_argument("--controller", help=f"{' or '.join(CONTROLLERS)} (default: lee)")
    fly.add_argument("--difficulty", help="easy, medium, hard or extreme")
    fly.add_argument("--physics-hz", type=int, metavar="HZ", help="physics substeps a second (default: 240)")
    fly.add_argument("--decision-hz", type=int, metavar="HZ", help="decisions a second")
    fly.add_argument("--horizon", type=int, metavar="STEPS", help="decisions until the episode is cut")
    fly.add_argument("--max-speed", type=float, metavar="M/S", help="speed limit")
    fly.add_argument("--turbulence", help="Dryden gusts: light, moderate or severe")
    fly.add_argument("--preset", help="named set of options, see `bulletuav tasks TASK`")
    fly.add_argument("--wind", type=float, nargs=3, metavar=("EAST", "NORTH", "UP"), help="steady wind in m/s")
    fly.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other option of `bulletuav tasks TASK`, such as spacing=3 or weights={'goal':10}; repeatable",
    )
    fly.add_argument("--animation", choices=("gif", "mp4", "none"), default="gif", help="mp4 needs the extra 'video'")


def _check_known(rest: list[str], parser: argparse.ArgumentParser) -> None:
    """Complain about the first argument that no option took."""
    if rest:
        known = [option for action in parser._actions for option in action.option_strings]
        near = difflib.get_close_matches(rest[0].split("=")[0], known, n=1)
        parser.error(f"unknown argument {rest[0]}" + (f": did you mean {near[0]}?" if near else ""))


def _fly_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Keyword arguments of the aviary from those given on the command line."""
    names = {field.name for field in dataclasses.fields(Options)}
    options = {name: value for name, value in vars(arguments).items() if name in names and value is not None}
    for pair in arguments.set:
        name, equals, text = pair.partition("=")
        if not equals:
            raise ValueError(f"--set {pair}: NAME=VALUE is needed")
        if name in options:
            raise ValueError(f"--set {pair}: {name} is given twice")
        parts = [_literal(part) for part in text.split(",")]
        options[name] = _literal(text) if len(parts) == 1 or text[0] in "([{" else tuple(parts)
    policy, task = find_policy(arguments.policy), find_task(arguments.task)
    if "action" not in options and task.defaults["action"] not in policy.actions:
        options["action"] = policy.actions[0]
    return options


def _literal(text: str) -> Any:
    """A number, None, a Python literal, or the text itself."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return float(text) if text.strip() in ("nan", "inf", "-inf") else text


def fly(arguments: argparse.Namespace) -> None:
    """Fly one episode and write its files."""
    aviary = Aviary(arguments.task, 1, **_fly_options(arguments))
    policy = find_policy(arguments.policy)(aviary)
    try:
        arguments.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"--out {arguments.out} cannot be a folder to write to: {error.strerror}") from None
    for old in arguments.out.glob("flight.*"):
        old.unlink()  # of an earlier flight
    with Progress(console=Console(stderr=True)) as progress:
        flight = progress.add_task("flying", total=aviary.options.horizon)
        recording = fly_episode(aviary, policy, arguments.seed, lambda: progress.advance(flight))
        progress.update(flight, total=len(recording.reward))
        files = save(recording, aviary, arguments.policy, arguments.seed, arguments.out)
        files += _draw(recording, aviary, arguments, progress)
    console = Console()
    console.print(_table(recording, arguments.task, aviary))
    console.print("\n".join(f"wrote {path}" for path in files), highlight=False, soft_wrap=True)
    aviary.close()


def _draw(recording: Recording, aviary: Aviary, arguments: argparse.Namespace, progress: Progress) -> list[Path]:
    airframes, d_safe = aviary.options.airframe, aviary.task.config.d_safe
    names = ", ".join(sorted({airframe.name for airframe in airframes}))
    title = f"{arguments.task}: {aviary.num_drones} {names}, {arguments.policy}, seed {arguments.seed}"
    tracks = arguments.out / "tracks.png"
    plot_tracks(recording, d_safe, title, tracks)
    if arguments.animation == "none":
        return [tracks]
    animation = Animation(recording, d_safe, 2 * aviary.task.setting.collision_radius, title)
    path = arguments.out / f"flight.{arguments.animation}"
    drawing = progress.add_task("drawing", total=len(animation))
    animation.save(path, lambda: progress.advance(drawing))
    return [tracks, path]


def _table(recording: Recording, task: str, aviary: Aviary) -> Table:
    table = Table(title=f"{task}, drones: {aviary.num_drones}, d_safe {aviary.task.config.d_safe:g} m")
    for heading in ("drone", "reached", "nearest m", "conflicts", "collisions", "to goal m", "time s"):
        table.add_column(heading, justify="right")
    for row in outcomes(recording):
        table.add_row(
            f"drone_{row.drone}",
            "yes" if row.reached else "no",
            f"{row.min_separation:.2f}" if row.min_separation < float("inf") else "-",
            str(row.conflicts),
            str(row.collisions),
            f"{row.final_distance:.2f}",
            f"{row.time:.2f}",
        )
    return table


def tasks(arguments: argparse.Namespace) -> None:
    """List the tasks, or print one's MDP and options."""
    if arguments.task is None:
        for name in list_tasks():
            print(f"{name:12s} {inspect.getdoc(find_task(name)).splitlines()[0]}")  # type: ignore[union-attr]
        return
    task = find_task(arguments.task)
    print(inspect.getdoc(task))
    print(
        "\nDefaults of the options common to all tasks, where the task has its own: "
        + ", ".join(f"{name}={value!r}" for name, value in task.defaults.items())
    )
    for name, values in task.presets.items():
        print(f"Preset {name}: " + ", ".join(f"{option}={value!r}" for option, value in values.items()))
    print(f"\n{inspect.getdoc(task.Config)}\n")
    for field in dataclasses.fields(task.Config):
        default = field.default if field.default is not dataclasses.MISSING else {}
        print(f"  {field.name:16s} {default!r}")
    print(f"\n{inspect.getdoc(Options)}")


def benchmark(arguments: argparse.Namespace) -> None:
    """Measure and print."""
    sizes = tuple(arguments.drones)
    if min(sizes) < 1 or not arguments.seconds > 0:
        raise ValueError(f"--drones {sizes}, --seconds {arguments.seconds}: numbers above 0 are needed")
    with Progress(console=Console(stderr=True)) as progress:
        measuring = progress.add_task("measuring", total=len(sizes) * (len(LADDER) + len(FLOORS)) * ROUNDS)
        results = measure(sizes, arguments.seconds, lambda: progress.advance(measuring))
    table = Table(title="drone-substeps per CPU-second, one thread, 240 Hz, all forces; below it the reset of the world")
    table.add_column("dynamics", no_wrap=True)
    for size in sizes:
        table.add_column(f"N = {size}", justify="right")
    for name in dict.fromkeys(result.name for result in results):
        row = [result for result in results if result.name == name]
        table.add_row(name, *(f"{r.rate:.3g}" if name in FLOORS else f"{r.rate:.3g}\n{r.reset_ms:.2f} ms" for r in row))
    Console().print(table)
    print(
        "bare step: the engine's step alone; engine calls: with a wrench and a state of every drone, no arithmetic of ours"
    )


def doctor(arguments: argparse.Namespace) -> None:
    """Examine and print."""
    table = Table(show_header=False)
    for _ in Finding._fields:
        table.add_column(overflow="fold")
    for finding in examine():
        table.add_row(*map(escape, finding))
    Console().print(table)


def main(argv: Sequence[str] | None = None) -> None:
    """Entry point. Bad input ends in one line on standard error and exit code 2."""
    parser, commands = _parser()
    arguments, rest = parser.parse_known_args(argv)
    command = commands[arguments.command]
    _check_known(rest, command)
    try:
        {"fly": fly, "tasks": tasks, "benchmark": benchmark, "doctor": doctor}[arguments.command](arguments)
    except (ValueError, OSError, RuntimeError, ImportError) as error:
        command.error(" ".join(str(error).split()))
    except KeyboardInterrupt:
        sys.exit(130)
