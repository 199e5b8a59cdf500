"""`bulletuav compare`: a leaderboard of policies over tasks."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from bulletuav.commands.arguments import (
    POLICY_HELP,
    add_episodes,
    add_options,
    episodes_bar,
    flyable_options,
    given_options,
    out_folder,
    tell_files,
)
from bulletuav.commands.evaluate import evaluated, run_name
from bulletuav.errors import unknown
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.report.charts import plot_leaderboard
from bulletuav.report.leaderboard import markdown, write_csv

ABOUT = {
    "help": "evaluate several policies in several tasks and write a leaderboard",
    "description": (
        "Evaluate every policy in every task, difficulty and (--dynamics A,B) dynamics; write a leaderboard as markdown, "
        "csv and picture. The same command goes on where it was interrupted. Of --action, trained policies keep their own."
    ),
    "epilog": """example:
  bulletuav compare --policies straight,potential,orca --tasks crossing,pursuit,converge --workers 2 --out leaderboard
  bulletuav compare --policies random,kmeans --tasks los,mec --dynamics single_integrator,bullet --out service""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Who flies what, how often, where to, and the options."""
    parser.add_argument(
        "--tasks", required=True, type=_names, metavar="A,B", help="of `bulletuav tasks`"
    )
    parser.add_argument("--policies", required=True, type=_names, metavar="A,B", help=POLICY_HELP)
    parser.add_argument(
        "--difficulties",
        type=_names,
        metavar="A,B",
        help="easy, medium, hard, extreme (default: the task's)",
    )
    parser.add_argument(
        "--against",
        metavar="POLICY",
        help="tell how much more the others have than this one of them",
    )
    add_episodes(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("leaderboard"),
        metavar="DIR",
        help="folder for the files (default: leaderboard)",
    )
    add_options(parser)


def _names(text: str) -> list[str]:
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise argparse.ArgumentTypeError(f"{text!r} names nothing")
    return names


def _each(option: str, values: list[str] | None) -> list[dict[str, str]]:
    """Options that set one to each of the values; none where there are none."""
    return [{option: value} if value else {} for value in values or [""]]


def _flyable(task: str, policy: str, options: dict[str, Any], trust: bool) -> dict[str, Any]:
    """The options for a policy; of actions, one that was trained keeps its own, which the others may not be able to give."""
    pilot = find_policy(policy, task, trust)
    chosen = {
        name: value
        for name, value in options.items()
        if name != "action" or not (pilot.model and pilot.actions)
    }
    return flyable_options(task, pilot, chosen)


def run(arguments: argparse.Namespace) -> None:
    """Evaluate all, print and write."""
    options = given_options(arguments)
    dynamics = _names(str(options.pop("dynamics"))) if "dynamics" in options else None
    if arguments.difficulties and "difficulty" in options:
        raise ValueError("--difficulty and --difficulties: give one of them")
    if arguments.against not in (None, *arguments.policies):
        raise unknown("policy in --against,", arguments.against, arguments.policies)
    out, results = out_folder(arguments.out), []
    cases = [
        (task, policy, {**options, **difficulty, **one})
        for task in arguments.tasks
        for difficulty in _each("difficulty", arguments.difficulties)
        for policy in arguments.policies
        for one in _each("dynamics", dynamics)
    ]
    cases = [
        (task, policy, _flyable(task, policy, options, arguments.trust))
        for task, policy, options in cases
    ]
    with episodes_bar(arguments.episodes * len(cases)) as progress:
        for task, policy, options in cases:
            folder = out / "runs" / run_name(task, policy, options)
            results.append(evaluated(arguments, task, policy, options, folder, progress))
            results[-1].save(folder)
    files = [out / "leaderboard.md", out / "leaderboard.csv", out / "leaderboard.png"]
    table = markdown(results, arguments.against)
    replace_file(files[0], table)
    write_csv(results, files[1])
    plot_leaderboard(results, files[2])
    console = Console()
    console.print(table, markup=False, soft_wrap=True)
    tell_files(console, files)
