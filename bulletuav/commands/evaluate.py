"""`bulletuav evaluate`: evaluate one policy in one task over many episodes."""

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
    Advance,
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

COLUMNS: tuple[tuple[str, JustifyMethod], ...] = (
    ("metric", "left"),
    ("mean", "right"),
    ("95 % interval", "right"),
    ("description", "left"),
)
SCORES = ("success", "conflict", "collision", "completed", "return")
"""Metrics in the one-line score"""
EPISODES = 100
"""Default number of episodes"""
MIN_SECONDS = 10.0
"""Minimum wall time for a speed, s; the start of the processes dominates shorter times"""


def run(arguments: argparse.Namespace) -> None:
    """Evaluate, print the score and write the files."""
    # Check arguments before any episode is flown
    defaults = _set_run(arguments)
    task, policy, options, out = completed_case(arguments, "evaluation", defaults or {})
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
    # A piece has only a part of the episodes, so there is no table yet
    if arguments.piece is not None:
        print_piece(arguments.piece, out)
        return
    files = write_evaluation(result, out)
    which = "other options" if given_options(arguments) else "options"
    print_score(result, f", {which} of {config_file(Path(policy))}" if defaults is not None else "")
    print_table(_table(result))
    print(_describe_speed(result))
    print_files(files)


def _set_run(arguments: argparse.Namespace) -> dict[str, Any] | None:
    """Replace the folder of a run in the arguments by its task and policy.

    Args:
        arguments: Parsed arguments; the number of episodes is also set, unless it is given.

    Returns:
        The options of evaluations of the run; None if a task was given.

    Raises:
        ValueError: If a policy is given in addition to a run.
    """
    folder = arguments.task
    if folder in list_tasks() or not Path(folder).is_dir():
        arguments.episodes = EPISODES if arguments.episodes is None else arguments.episodes
        return None
    if arguments.policy is not None:
        raise ValueError(
            f"--policy {arguments.policy} with the run {folder}, which has its own policy: "
            f"give a task to evaluate another policy"
        )
    config = read_run_config(Path(folder), arguments.trust)
    arguments.task, arguments.policy = config.task, folder
    arguments.episodes = config.episodes if arguments.episodes is None else arguments.episodes
    return config.evaluated


def completed_case(
    arguments: argparse.Namespace, home: str, defaults: Mapping[str, Any] = MappingProxyType({})
) -> tuple[str, str, dict[str, Any], Path]:
    """Complete the arguments of a command by the defaults of the task and the policy.

    Args:
        arguments: Parsed arguments of a command with a task, `--policy`, `--out` and `--trust`.
        home: Parent of the output folder if no folder is given.
        defaults: Default options of the environment.

    Returns:
        Task, policy, options of the environment, and output folder.
    """
    task = arguments.task
    policy = arguments.policy or find_task(task).baseline
    spec = find_policy(policy, task, arguments.trust)
    options = spec.complete(task, {**defaults, **given_options(arguments)})
    return task, policy, options, arguments.out or Path(home) / run_name(task, policy, options)


def run_name(task: str, policy: str, options: dict[str, Any]) -> str:
    """Return a folder name from task, difficulty, dynamics and policy."""
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
    """Call `evaluate` with the episodes, seed, workers and trust of a command.

    Args:
        arguments: Parsed arguments of a command that uses `add_episodes`.
        task: Name of the task.
        policy: The policy, as users name it.
        options: Options of the environment.
        out: Folder of the episodes; existing episodes are not flown again.
        progress: Called with the number of newly finished episodes.
        metrics: Metrics in addition to the standard ones.
        first: Number of batches of earlier cases, for the distribution of pieces.

    Returns:
        The evaluation, or its piece.

    Raises:
        KeyboardInterrupt: With a message about the kept results.
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
            # Batches of all cases are numbered consecutively
            piece=None if arguments.piece is None else arguments.piece._replace(first=first),
            ray=arguments.ray,
            **options,
        )
    except KeyboardInterrupt:
        # Report that finished batches are kept
        raise KeyboardInterrupt(
            f"{TEXT}: finished batches of episodes are kept in {out}; the same command resumes"
        ) from None


def print_score(result: Evaluation, origin: str = "") -> None:
    """Print the score of a policy in one line, with its conditions.

    Args:
        result: The evaluation.
        origin: Origin of its options, appended to its conditions.
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
    """Return the number of episodes of all cases that this call flies."""
    batches = -(-arguments.episodes // BATCH)
    counts = [min(BATCH, arguments.episodes - k * BATCH) for k in range(batches)] * cases
    return sum(counts if arguments.piece is None else arguments.piece.select(counts))


def _table(result: Evaluation) -> Table:
    """Return a table of the metrics that have a value in any episode."""
    table = Table()
    for heading, side in COLUMNS:
        table.add_column(heading, justify=side)
    for name, estimate in result.estimates().items():
        if estimate.episodes:
            mean, meaning = f"{estimate.mean:.4g}", result.metrics[name]
            table.add_row(name, mean, _interval(estimate), meaning)
    return table


def _interval(estimate: Estimate) -> str:
    return f"{estimate.low:.4g} to {estimate.high:.4g}"


def _describe_speed(result: Evaluation) -> str:
    """Return a text with the speed of the simulation relative to real time."""
    if not result.flight:
        return "all episodes were already in the folder"
    text = f"{result.flight:.0f} s of simulated flight in {result.seconds:.1f} s of wall time"
    if result.seconds < MIN_SECONDS:
        return text
    return f"{text}: {result.flight / result.seconds:.1f} x real time"
