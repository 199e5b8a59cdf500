"""`bulletuav incentives`: check that reward functions favour the intended behaviour."""

import argparse
from collections.abc import Iterable

from bulletuav.analysis.incentives import Incentive, assign_roles, find_reversals, incentives
from bulletuav.commands.arguments import (
    given_options,
    make_out_folder,
    show_episodes,
)
from bulletuav.commands.output import print_files
from bulletuav.files import replace_file
from bulletuav.tasks import find_task, list_tasks

COLUMNS = (
    "task",
    "difficulty",
    "dynamics",
    "role",
    "policy",
    "safe success",
    "return",
    "gap over lead",
    "holds",
)


def run(arguments: argparse.Namespace) -> None:
    """Compare policies, print the summary and write the tables."""
    options = given_options(arguments)
    out = make_out_folder(arguments.out)
    others = split_names(arguments.others)
    # Each task at each difficulty
    cases = [
        (task, difficulty)
        for task in arguments.tasks or list_tasks()
        for difficulty in split_names(arguments.difficulties) or find_task(task).difficulties
    ]
    flights = sum(
        1
        + len(assign_roles(task, arguments.policy or find_task(task).baseline))
        - (not find_task(task).oracle and not find_task(task).is_game)
        + len(others)
        for task, _ in cases
    )
    found: list[Incentive] = []
    with show_episodes(arguments.episodes * flights) as advance:
        for task, difficulty in cases:
            found += incentives(
                task,
                arguments.policy,
                arguments.episodes,
                arguments.seed,
                arguments.workers,
                advance,
                arguments.trust,
                others,
                **{**options, "difficulty": difficulty},
            )
    files = [out / "incentives.md", out / "all.md"]
    table = incentives_table(select_worst(found))
    replace_file(files[0], table)
    replace_file(files[1], incentives_table(found))
    print(table)
    for one in found:
        if one.fault:
            print(f"{one.task}, {one.difficulty}, {one.policy}: {one.fault}")
    for reversal in find_reversals(found):
        print(reversal)
    print_files(files)


def split_names(text: str | None) -> list[str]:
    """Return the names of a comma-separated list."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def select_worst(found: Iterable[Incentive]) -> list[Incentive]:
    """Select one policy for each task, difficulty and role: that which is nearest to a fault."""
    worst: dict[tuple[str, str, str], Incentive] = {}
    for one in found:
        case = (one.task, one.difficulty, one.role)
        if case not in worst or _rank(one) > _rank(worst[case]):
            worst[case] = one
    return list(worst.values())


def _rank(one: Incentive) -> tuple[bool, float, float]:
    """Return how near a policy is to a fault; larger is nearer."""
    success = one.success.mean if one.role == "blind" else 0.0
    return bool(one.fault), success, -one.gap.low


def incentives_table(found: list[Incentive]) -> str:
    """Return comparisons as a markdown table, with episodes and seeds in the caption."""
    flown = "; ".join(dict.fromkeys(one.conditions.flown for one in found))
    lines = [
        f"Each policy in each row: {flown}\n",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
    ]
    for one in found:
        success, earned = one.success, one.earned
        row = (
            one.task,
            one.difficulty,
            one.conditions.dynamics,
            one.role,
            one.policy,
            f"{success.mean:.2f} [{success.low:.2f}, {success.high:.2f}]",
            f"{earned.mean:.4g} [{earned.low:.4g}, {earned.high:.4g}]",
            "-" if one.role in ("baseline", "oracle") else f"{one.margin:.2f}",
            one.fault or "yes",
        )
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"
