"""`bulletuav evaluate`: many episodes of one policy in one task."""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bulletuav.analysis.evaluation import Evaluation, evaluate
from bulletuav.analysis.metrics import Estimate
from bulletuav.commands.arguments import (
    POLICY_HELP,
    Advance,
    add_episodes,
    add_options,
    episodes_bar,
    flyable_options,
    given_options,
    tell_files,
)
from bulletuav.policies import find_policy
from bulletuav.report.charts import plot_evaluation
from bulletuav.tasks import find_task

ABOUT = {
    "help": "fly many episodes and print metrics with confidence intervals",
    "description": (
        "Fly many episodes in batches and processes; print metrics with 95 % confidence intervals; write them, those of "
        "every episode, and a picture. The same command goes on where it was interrupted."
    ),
    "epilog": """examples:
  bulletuav evaluate converge --policy orca --episodes 100 --workers 2 --out converge-orca
  bulletuav evaluate crossing --policy ppo:model.zip --trust --difficulty hard --out crossing-ppo
  bulletuav evaluate hover --metric mine:my_metric""",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The task, who flies, how many episodes, where to, and the options."""
    parser.add_argument("task", help="one of `bulletuav tasks`")
    parser.add_argument("--policy", help=f"who flies: {POLICY_HELP} (default: the task's)")
    add_episodes(parser)
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help="measure this as well: a registered metric, or module:Name, also of a file mine.py in "
        "the current folder; repeatable",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in evaluation/)"
    )
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """Evaluate, print and write."""
    arguments.policy = arguments.policy or find_task(arguments.task).baseline
    pilot = find_policy(arguments.policy, arguments.task, arguments.trust)
    options = flyable_options(arguments.task, pilot, given_options(arguments))
    out = arguments.out or Path("evaluation") / run_name(arguments.task, arguments.policy, options)
    with episodes_bar(arguments.episodes) as progress:
        result = evaluated(
            arguments,
            arguments.task,
            arguments.policy,
            options,
            out,
            progress,
            metrics=arguments.metric,
        )
    picture = out / "summary.png"
    plot_evaluation(result, picture)
    files = [out / "run.json", out / "episodes.csv", result.save(out), picture]
    console = Console()
    console.print(_table(result))
    if result.flight:
        pace = result.flight / result.seconds
        console.print(
            f"{result.flight:.0f} s of flight in {result.seconds:.1f} s of wall time: {pace:.1f} times real time"
        )
    else:
        console.print("all of these episodes were there already")
    tell_files(console, files)


def run_name(task: str, policy: str, options: dict[str, Any]) -> str:
    """A folder's name for a run."""
    dynamics = [options["dynamics"]] if "dynamics" in options else []
    name = "-".join([task, options.get("difficulty", "default"), *dynamics, policy])
    return "".join(letter if letter.isalnum() or letter in "_.-" else "_" for letter in name)


def evaluated(
    arguments: argparse.Namespace,
    task: str,
    policy: str,
    options: dict[str, Any],
    out: Path,
    progress: Advance,
    metrics: Sequence[str] = (),
) -> Evaluation:
    """Evaluate with the command's arguments; an interrupt tells what is kept."""
    if any(":" in metric for metric in metrics):
        # The script of an installed package does not look for modules in the current folder.
        sys.path.append(os.getcwd())
    try:
        return evaluate(
            task,
            policy,
            arguments.episodes,
            arguments.seed,
            arguments.workers,
            out,
            progress,
            trust=arguments.trust,
            metrics=metrics,
            **options,
        )
    except KeyboardInterrupt:
        Console(stderr=True).print(
            f"interrupted: finished batches of episodes are kept in {out}; the same command goes on"
        )
        raise


def _table(result: Evaluation) -> Table:
    about = result.about
    reads = ", which reads the true state" if about["reads_swarm"] else ""
    table = Table(
        title=f"{about['task']}, policy {about['policy']}{reads}, {len(result.rows)} episodes"
    )
    for heading, side in (
        ("metric", "left"),
        ("mean", "right"),
        ("95 % interval", "right"),
        ("what it is", "left"),
    ):
        table.add_column(heading, justify=side)  # type: ignore[arg-type]
    for name, one in result.estimates().items():
        if one.episodes:
            meaning = escape(result.metrics[name])
            table.add_row(escape(name), f"{one.mean:.4g}", _interval(one), meaning)
    return table


def _interval(one: Estimate) -> str:
    return f"{one.low:.4g} to {one.high:.4g}"
