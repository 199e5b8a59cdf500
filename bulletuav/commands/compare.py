"""`bulletuav compare`: evaluate several policies in several tasks, and write a leaderboard."""

import argparse
import itertools
from pathlib import Path
from typing import Any, NamedTuple

from bulletuav.analysis.evaluation import BATCH, Evaluation
from bulletuav.commands.arguments import (
    given_options,
    make_out_folder,
    print_piece,
    show_episodes,
)
from bulletuav.commands.evaluate import evaluate_case, run_name, shared_episodes
from bulletuav.commands.output import print_files
from bulletuav.commands.parsers.compare import parse_names
from bulletuav.errors import unknown
from bulletuav.policies import find_policy
from bulletuav.report.leaderboard import format_leaderboard
from bulletuav.report.results import write_cases, write_comparison


class _Case(NamedTuple):
    """One policy in one task with one set of options."""

    task: str
    policy: str
    options: dict[str, Any]


def run(arguments: argparse.Namespace) -> None:
    """Evaluate all cases, print the leaderboard and write the files."""
    options = given_options(arguments)
    # --dynamics may be a list here, so it is not an option that all cases share
    dynamics = parse_names(str(options.pop("dynamics"))) if "dynamics" in options else None
    if arguments.difficulties and "difficulty" in options:
        raise ValueError("--difficulty and --difficulties: give one of them")
    if arguments.against not in (None, *arguments.policies):
        raise unknown("policy in --against,", arguments.against, arguments.policies)
    out = make_out_folder(arguments.out)
    cases = _cases(arguments, options, dynamics)
    folders = [out / "runs" / run_name(*case) for case in cases]
    if arguments.piece is not None:
        write_cases(folders, arguments.against, out)
        _evaluate(arguments, cases, folders)
        print_piece(arguments.piece, out)
        return
    results = _evaluate(arguments, cases, folders)
    for result, folder in zip(results, folders, strict=True):
        result.save(folder)
    files = write_comparison(results, arguments.against, out)
    print(format_leaderboard(results, arguments.against))
    print_files(files)


def _cases(
    arguments: argparse.Namespace, options: dict[str, Any], dynamics: list[str] | None
) -> list[_Case]:
    """Return the cases: each policy in each task, difficulty and dynamics, with options."""
    combinations = itertools.product(
        arguments.tasks,
        _each("difficulty", arguments.difficulties),
        arguments.policies,
        _each("dynamics", dynamics),
    )
    cases = []
    for task, difficulty, policy, one_dynamics in combinations:
        asked = {**options, **difficulty, **one_dynamics}
        cases.append(_Case(task, policy, _case_options(task, policy, asked, arguments.trust)))
    return cases


def _each(option: str, values: list[str] | None) -> list[dict[str, str]]:
    """Return one dict of options for each value, or one empty dict without values."""
    return [{option: value} if value else {} for value in values or [""]]


def _case_options(task: str, name: str, options: dict[str, Any], trust: bool) -> dict[str, Any]:
    """Complete the options for a policy; trained policies keep their own action."""
    policy = find_policy(name, task, trust)
    if policy.models and policy.actions:
        # The given action is for the other policies
        options = {option: value for option, value in options.items() if option != "action"}
    return policy.complete(task, options)


def _evaluate(
    arguments: argparse.Namespace, cases: list[_Case], folders: list[Path]
) -> list[Evaluation]:
    """Evaluate the cases, or a piece of each, in order, each in its own folder."""
    results = []
    batches = -(-arguments.episodes // BATCH)
    with show_episodes(shared_episodes(arguments, len(cases))) as advance:
        for k, (case, folder) in enumerate(zip(cases, folders, strict=True)):
            first = k * batches
            results.append(
                evaluate_case(arguments, *case, out=folder, progress=advance, first=first)
            )
    return results
