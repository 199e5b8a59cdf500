"""`bulletuav incentives`: check that reward functions favour the intended behaviour."""

import argparse

from bulletuav.analysis.incentives import Incentive, incentives, list_degenerate_policies
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
    "baseline",
    "return",
    "success",
    "shirker",
    "its return",
    "gap over lead",
    "holds",
)


def run(arguments: argparse.Namespace) -> None:
    """Compare returns, print the summary and write the tables."""
    options = given_options(arguments)
    out = make_out_folder(arguments.out)
    # Each task at each difficulty
    cases = [
        (task, difficulty)
        for task in arguments.tasks or list_tasks()
        for difficulty in _difficulties(task, arguments.difficulties)
    ]
    flights = sum(
        1 + len(list_degenerate_policies(task, arguments.policy or find_task(task).baseline))
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
                **{**options, "difficulty": difficulty},
            )

    # Print the shirker with the smallest gap for each case; the file has all
    worst: dict[tuple[str, str], Incentive] = {}
    for one in found:
        case = (one.task, one.difficulty)
        if case not in worst or one.return_difference.low < worst[case].return_difference.low:
            worst[case] = one
    files = [out / "incentives.md", out / "all.md"]
    table = incentives_table(list(worst.values()))
    replace_file(files[0], table)
    replace_file(files[1], incentives_table(found))
    print(table)
    print_files(files)


def _difficulties(task: str, asked: str | None) -> list[str]:
    """Return the requested difficulties, or else all of the task."""
    if asked:
        return [name.strip() for name in asked.split(",") if name.strip()]
    return list(find_task(task).difficulties)


def incentives_table(found: list[Incentive]) -> str:
    """Return comparisons as a markdown table, with episodes and seeds in the caption."""
    flown = "; ".join(dict.fromkeys(one.conditions.flown for one in found))
    lines = [
        f"Each policy in each row: {flown}\n",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
    ]
    for one in found:
        earned = one.baseline_return
        # Gap to the shirker as a fraction of the lead of the baseline over staying
        share = one.return_difference.low / one.lead if one.lead > 0 else float("nan")
        row = (
            one.task,
            one.difficulty,
            one.conditions.dynamics,
            one.baseline,
            f"{earned.mean:.4g} [{earned.low:.4g}, {earned.high:.4g}]",
            f"{one.success.mean:.2f}",
            one.degenerate_policy,
            f"{one.degenerate_return.mean:.4g}",
            f"{share:.2f}",
            "yes" if one.holds else "no",
        )
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"
