"""Measure how chasers do against evaders in `pursuit_evasion`, all pairs at every difficulty.

    python benchmarks/captures.py --out docs/results/pursuit_evasion

Of each pair: share of episodes in which all evaders were captured, with Wilson's 95 % interval;
share of evaders captured; and time until capture, s, mean of the evaders, 30 s for those that were
not. Finished pairs are kept below --runs, and the same command goes on where it was interrupted.
Writes NAME.md, and NAME.csv with the hash of each pair's episodes.
"""

import argparse
import csv
import datetime
import itertools
from pathlib import Path

import bulletuav
from bulletuav.analysis.metrics import estimate
from bulletuav.files import replace_file
from bulletuav.tasks import find_task
from bulletuav.version import CONSTANTS

TASK = "pursuit_evasion"
CHASERS = ("lead", "pure_pursuit", "area_minimising", "random")
EVADERS = ("random", "wander", "flee", "flee_weighted", "flee_gap")
SEED = 0
"""Seed of the first episode of each pair"""
COLUMNS = (
    "difficulty",
    "chasers",
    "evaders",
    "all",
    "low",
    "high",
    "captured",
    "seconds",
    "dynamics",
    "episodes",
    "seed",
    "hash",
)


def measure(difficulty: str, chasers: str, evaders: str, arguments: argparse.Namespace) -> tuple:
    """Fly a pair and return a row of the columns."""
    name = "-".join((difficulty, arguments.dynamics, chasers, evaders))
    result = bulletuav.evaluate(
        TASK,
        f"{chasers} vs {evaders}",
        arguments.episodes,
        SEED,
        out=arguments.runs / name,
        dynamics=arguments.dynamics,
        difficulty=difficulty,
    )
    every = estimate("success", [row["captured"] == 1 for row in result.rows])
    means = [result.estimates()[metric].mean for metric in ("captured", "capture_time")]
    of = result.conditions
    conditions = (of.dynamics, of.episodes, of.seed, result.hash)
    return (difficulty, chasers, evaders, every.mean, every.low, every.high, *means, *conditions)


def markdown(rows: list[tuple], arguments: argparse.Namespace) -> str:
    """Write a table for each difficulty, with a line for each policy of chasers."""
    evaders = arguments.evaders.split(",")
    seeds = f"seeds {SEED} to {SEED + arguments.episodes - 1}"
    version = f"bulletuav {bulletuav.__version__}, constants {CONSTANTS}"
    lines = [
        f"# Pursuit and evasion: {', '.join(dict.fromkeys(row[0] for row in rows))}",
        "",
        "Cells are the fraction of episodes in which all evaders were captured, with its 95 % "
        "interval / fraction of evaders captured / seconds until capture (30 if not captured).",
        f"`{TASK}`, `{arguments.dynamics}`, {arguments.episodes} episodes of each pair, {seeds}. "
        f"Flown on {datetime.date.today()} by {version}, with",
        "",
        "```sh",
        f"python benchmarks/captures.py --difficulties {arguments.difficulties} --chasers "
        f"{arguments.chasers} --evaders {arguments.evaders} --episodes {arguments.episodes} "
        f"--dynamics {arguments.dynamics} --name {arguments.name} "
        "--out docs/results/pursuit_evasion",
        "```",
    ]
    for difficulty, group in itertools.groupby(rows, lambda row: row[0]):
        lines += ["", f"## {difficulty}", "", f"| chasers | {' | '.join(evaders)} |"]
        lines.append("|" + "---|" * (1 + len(evaders)))
        for chasers, cells in itertools.groupby(group, lambda row: row[1]):
            told = (
                f"{every:.2f} [{low:.2f}, {high:.2f}] / {share:.2f} / {seconds:.1f}"
                for every, low, high, share, seconds in (cell[3:8] for cell in cells)
            )
            lines.append(f"| `{chasers}` | {' | '.join(told)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure all pairs and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = ",".join(find_task(TASK).difficulties)
    parser.add_argument("--difficulties", default=known, help=f"such as {known}")
    parser.add_argument("--chasers", default=",".join(CHASERS))
    parser.add_argument("--evaders", default=",".join(EVADERS))
    parser.add_argument("--name", default="captures", help="of the files")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--dynamics", default="bullet")
    parser.add_argument("--out", type=Path, default=Path("out/captures"))
    parser.add_argument("--runs", type=Path, default=Path("out/captures/runs"))
    arguments = parser.parse_args()
    asked = (arguments.difficulties, arguments.chasers, arguments.evaders)
    cases = itertools.product(*(one.split(",") for one in asked))
    rows = [measure(*case, arguments) for case in cases]
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_file(arguments.out / f"{arguments.name}.md", markdown(rows, arguments))
    with (arguments.out / f"{arguments.name}.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(
            [[*row[:3], *(f"{one:.6g}" for one in row[3:8]), *row[8:]] for row in rows]
        )


if __name__ == "__main__":
    main()
