"""`bulletuav incentives`: does a task pay for what it wants?"""

import argparse
from pathlib import Path

from bulletuav.analysis.incentives import Incentive, incentives, list_degenerate_policies
from bulletuav.commands.arguments import (
    add_episodes,
    add_options,
    given_options,
    out_folder,
    show_episodes,
)
from bulletuav.commands.output import print_files
from bulletuav.files import replace_file
from bulletuav.tasks import find_task, list_tasks

ABOUT = {
    "help": "compare what tasks pay their baselines and policies that shirk",
    "description": (
        "Fly each task with its baseline and with policies that shirk: stay, climb, dive, leave, "
        "crash, circle the goal, clump, fly straight. The baseline is to out-earn each by more "
        "than a tenth of its lead over staying (lower end of the 95 % interval). Print the best "
        "paid shirker of each task, and write the whole table."
    ),
    "epilog": """examples:
  bulletuav incentives crossing --episodes 20 --out incentives
  bulletuav incentives crossing mec --difficulties easy,hard --dynamics single_integrator""",
}
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the tasks, their difficulties, how many episodes, where to write, and the options."""
    parser.add_argument("tasks", nargs="*", help="of `bulletuav tasks` (default: all)")
    parser.add_argument("--policy", help="the baseline (default: the task's)")
    parser.add_argument(
        "--difficulties", metavar="A,B", help="easy, medium, hard, extreme (default: all)"
    )
    add_episodes(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("incentives"),
        metavar="DIR",
        help="folder for the tables (default: incentives)",
    )
    add_options(parser)


def run(arguments: argparse.Namespace) -> None:
    """Compare, print and write."""
    options = given_options(arguments)
    out = out_folder(arguments.out)
    # Each task at each difficulty, against each shirker that it has
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

    # Of each case the best paid shirker is enough to look at; the file has all.
    worst: dict[tuple[str, str], Incentive] = {}
    for one in found:
        case = (one.task, one.difficulty)
        if case not in worst or one.return_difference.low < worst[case].return_difference.low:
            worst[case] = one
    files = [out / "incentives.md", out / "all.md"]
    table = markdown(list(worst.values()))
    replace_file(files[0], table)
    replace_file(files[1], markdown(found))
    print(table)
    print_files(files)


def _difficulties(task: str, asked: str | None) -> list[str]:
    """List the difficulties of a task, or those that were asked for."""
    if asked:
        return [name.strip() for name in asked.split(",") if name.strip()]
    return list(find_task(task).difficulties)


def markdown(found: list[Incentive]) -> str:
    """Write comparisons as a table in markdown; its caption names episodes and seeds."""
    flown = "; ".join(dict.fromkeys(one.conditions.flown for one in found))
    lines = [
        f"Each policy of each row: {flown}\n",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
    ]
    for one in found:
        # What a shirker loses, as a share of what flying earns at all
        share = one.return_difference.low / one.lead if one.lead > 0 else float("nan")
        earned = one.baseline_return
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
