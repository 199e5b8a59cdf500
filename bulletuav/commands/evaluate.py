"""`bulletuav evaluate`: many episodes of one policy in one task."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import JustifyMethod
from rich.table import Table

from bulletuav.analysis.evaluation import BATCH, Evaluation, evaluate
from bulletuav.analysis.metrics import Estimate
from bulletuav.commands.arguments import (
    POLICY_HELP,
    Advance,
    add_episodes,
    add_options,
    add_sharing,
    given_options,
    print_piece,
    show_episodes,
)
from bulletuav.commands.output import print_files, print_table
from bulletuav.interrupts import TEXT
from bulletuav.policies import find_policy
from bulletuav.policies.find import config_file, read_run_config
from bulletuav.report.results import write_evaluation
from bulletuav.tasks import find_task, list_tasks

ABOUT = {
    "help": "fly many episodes and print metrics with confidence intervals",
    "description": (
        "Fly many episodes in batches and processes. Print metrics with 95 % confidence "
        "intervals. Write these, the metrics of every episode, and a picture. The same command "
        "continues where it was interrupted. The folder of a run in place of the task flies its "
        "policy with the options of its run.yaml; options that are given override these."
    ),
    "epilog": """examples:
  bulletuav evaluate converge --policy orca --episodes 100 --workers 2 --out converge-orca
  bulletuav evaluate crossing --difficulty hard --out crossing-hard
  bulletuav evaluate hover --dynamics rigid_body --wind 3 0 0""",
}
COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("metric", "left"),
    ("mean", "right"),
    ("95 % interval", "right"),
    ("what it is", "left"),
)
SCORES = ("success", "conflict", "collision", "completed", "return")
"""Metrics in the line of a score"""
EPISODES = 100
"""Number of episodes where neither the command nor a run sets it"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the task, the policy, how many episodes, where to write, and the options."""
    parser.add_argument(
        "task", help="one of `bulletuav tasks`, or the folder of a run of `bulletuav train`"
    )
    parser.add_argument("--policy", help=f"who flies: {POLICY_HELP} (default: the task's)")
    add_episodes(parser)
    # Runs have a number of episodes of their own
    parser.set_defaults(episodes=None)
    add_sharing(parser)
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
    # Bad arguments end the command before anything is flown
    usual = _set_run(arguments)
    task, policy, options, out = completed_case(arguments, "evaluation", usual or {})
    with show_episodes(shared_episodes(arguments)) as advance:
        result = evaluate_case(
            arguments,
            task,
            policy,
            options,
            out=out,
            progress=advance,
            metrics=arguments.metric,
        )
    # A piece is a share of the episodes: no table before all are there
    if arguments.piece is not None:
        print_piece(arguments.piece, out)
        return
    files = write_evaluation(result, out)
    which = "other options" if given_options(arguments) else "options"
    print_score(result, f", {which} of {config_file(Path(policy))}" if usual is not None else "")
    print_table(_table(result))
    print(_pace(result))
    print_files(files)


def _set_run(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Replace the folder of a run among the arguments by its task and policy.

    Args:
        arguments: Parsed arguments; the number of episodes is set, too, unless it is given.

    Returns:
        The options of the run's evaluations; None where a task was given.

    Raises:
        ValueError: A policy is given beside a run.
    """
    folder = arguments.task
    if folder in list_tasks() or not Path(folder).is_dir():
        arguments.episodes = EPISODES if arguments.episodes is None else arguments.episodes
        return None
    if arguments.policy is not None:
        raise ValueError(
            f"--policy {arguments.policy} beside the run {folder}, which has a policy: "
            f"give a task for another one"
        )
    config = read_run_config(Path(folder), arguments.trust)
    arguments.task, arguments.policy = config.task, folder
    arguments.episodes = config.episodes if arguments.episodes is None else arguments.episodes
    return config.evaluated


def completed_case(
    arguments: argparse.Namespace, home: str, usual: Mapping[str, Any] = MappingProxyType({})
) -> tuple[str, str, dict[str, Any], Path]:
    """Complete what a command left out, by the task and by the policy.

    Args:
        arguments: Parsed arguments of a command with a task, `--policy`, `--out` and `--trust`.
        home: Where its folder is, when none is given.
        usual: Options where none are given.

    Returns:
        Task, policy, options of the environment, and the folder for the files.
    """
    task = arguments.task
    policy = arguments.policy or find_task(task).baseline
    spec = find_policy(policy, task, arguments.trust)
    options = spec.complete(task, {**usual, **given_options(arguments)})
    return task, policy, options, arguments.out or Path(home) / run_name(task, policy, options)


def run_name(
    task: str,
    policy: str,
    options: dict[str, Any],
) -> str:
    """Make a folder's name for a run from its task, difficulty, dynamics and policy."""
    dynamics = [options["dynamics"]] if "dynamics" in options else []
    name = "-".join([task, options.get("difficulty", "default"), *dynamics, policy])
    return "".join(letter if letter.isalnum() or letter in "_.-" else "_" for letter in name)


def evaluate_case(
    arguments: argparse.Namespace,
    task: str,
    policy: str,
    options: dict[str, Any],
    *,
    out: Path,
    progress: Advance,
    metrics: Sequence[str] = (),
    first: int = 0,
) -> Evaluation:
    """Call `evaluate` with a command's episodes, seed, workers and trust.

    Args:
        arguments: Parsed arguments of a command with those of `add_episodes`.
        task: Name of the task.
        policy: Who flies, as users name it.
        options: Options of the environment.
        out: Folder for the episodes; those that are there already are not flown again.
        progress: Called with the number of episodes that were done since its last call.
        metrics: Metrics beside the standard ones.
        first: How many batches of other cases come before, where pieces are flown.

    Returns:
        The evaluation, or that of a piece.

    Raises:
        KeyboardInterrupt: With a line about what is kept.
    """
    try:
        return evaluate(
            task,
            policy,
            episodes=arguments.episodes,
            seed=arguments.seed,
            workers=arguments.workers,
            out=out,
            progress=progress,
            trust=arguments.trust,
            metrics=metrics,
            # Cases of a comparison are dealt out one after the other, from `first` on
            piece=None if arguments.piece is None else arguments.piece._replace(first=first),
            ray=arguments.ray,
            **options,
        )
    except KeyboardInterrupt:
        # Hours may be lost or not: say which
        raise KeyboardInterrupt(
            f"{TEXT}: finished batches of episodes are kept in {out}; the same command goes on"
        ) from None


def print_score(result: Evaluation, origin: str = "") -> None:
    """Print the score of a policy in one line, with its conditions.

    Args:
        result: The evaluation.
        origin: Where its options are from, after its conditions.
    """
    about = result.about
    reads = ", which reads the true state" if about["reads_swarm"] else ""
    found = result.estimates()
    scores = ", ".join(
        f"{name} {found[name].mean:.4g} [{_interval(found[name])}]"
        for name in SCORES
        if found[name].episodes
    )
    action = about["options"]["action"]
    print(
        f"score of {about['policy']}{reads}: {result.conditions}, action {action}{origin}: {scores}"
    )


def shared_episodes(arguments: argparse.Namespace, cases: int = 1) -> int:
    """Count the episodes, of all cases, that this call is to fly."""
    batches = -(-arguments.episodes // BATCH)
    counts = [min(BATCH, arguments.episodes - k * BATCH) for k in range(batches)] * cases
    return sum(counts if arguments.piece is None else arguments.piece.select(counts))


def _table(result: Evaluation) -> Table:
    """Lay out the metrics that have a value in some episode."""
    table = Table()
    for heading, side in COLUMNS:
        table.add_column(heading, justify=side)
    for name, estimate in result.estimates().items():
        if estimate.episodes:
            mean, meaning = f"{estimate.mean:.4g}", result.metrics[name]
            table.add_row(name, mean, _interval(estimate), meaning)
    return table


def _interval(estimate: Estimate) -> str:
    """Write a confidence interval."""
    return f"{estimate.low:.4g} to {estimate.high:.4g}"


def _pace(result: Evaluation) -> str:
    """Tell how fast the episodes were flown, compared with real time."""
    if not result.flight:
        return "all of these episodes were there already"
    pace = result.flight / result.seconds
    return (
        f"{result.flight:.0f} s of flight in {result.seconds:.1f} s of wall time: "
        f"{pace:.1f} times real time"
    )
