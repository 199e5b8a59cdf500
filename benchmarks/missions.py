"""Measure the baselines of the missions in `bullet` at every difficulty.

    python benchmarks/missions.py --out docs/results/missions
    python benchmarks/missions.py --tasks transport --difficulties easy,hard --episodes 10

Safe success is the fraction of drones that succeed without conflict or collision. Brackets are 95 %
intervals of means over episodes. Finished cases are kept below --runs, and the same command
continues where it was interrupted. Writes missions.md.
"""

import argparse
import datetime
import itertools
from pathlib import Path

import bulletuav
from bulletuav.analysis.metrics import Estimate
from bulletuav.files import replace_file
from bulletuav.tasks import find_task
from bulletuav.version import CONSTANTS

TASKS = ("transport", "search", "pad_landing", "interception", "flocking", "patrol")
DIFFICULTIES = ("easy", "medium", "hard", "extreme")
SEED = 9000
"""Seed of the first episode of each case"""
FEW = {
    ("flocking", "extreme"): 10,
    ("pad_landing", "medium"): 20,
    ("pad_landing", "hard"): 10,
    ("pad_landing", "extreme"): 10,
}
"""Maximum episodes of slow cases"""
COLUMNS = (
    "task",
    "difficulty",
    "drones",
    "episodes",
    "baseline",
    "safe success",
    "return",
    "conflict",
    "collision",
    "hash",
)


def measure(task: str, difficulty: str, arguments: argparse.Namespace) -> tuple[str, ...]:
    """Fly a case and return its row of the table."""
    baseline = find_task(task).baseline
    episodes = min(arguments.episodes, FEW.get((task, difficulty), arguments.episodes))
    result = bulletuav.evaluate(
        task,
        baseline,
        episodes,
        SEED,
        out=arguments.runs / f"{task}-{difficulty}-{arguments.dynamics}",
        dynamics=arguments.dynamics,
        difficulty=difficulty,
    )
    of = result.estimates()
    drones = str(result.about["options"]["num_drones"])
    cells = (interval(of[name], digits) for name, digits in (("safe_success", 2), ("return", 1)))
    rates = (f"{of[name].mean:.2f}" for name in ("conflict", "collision"))
    return (
        task,
        difficulty,
        drones,
        str(episodes),
        f"`{baseline}`",
        *cells,
        *rates,
        result.hash[:8],
    )


def interval(one: Estimate, digits: int) -> str:
    """Format a mean with its interval."""
    return f"{one.mean:.{digits}f} [{one.low:.{digits}f}, {one.high:.{digits}f}]"


def markdown(rows: list[tuple[str, ...]], arguments: argparse.Namespace) -> str:
    """Return the page."""
    lines = [
        "# Missions: baselines by difficulty",
        "",
        "Safe success is the fraction of drones that succeed without conflict or collision.",
        "Conflict and collision are fractions of episodes with one. Brackets are 95 % intervals.",
        f"Flown in `{arguments.dynamics}`, from seed {SEED} on, on {datetime.date.today()}",
        f"by bulletuav {bulletuav.__version__}, constants {CONSTANTS}, with",
        "",
        "```sh",
        f"python benchmarks/missions.py --episodes {arguments.episodes} "
        f"--dynamics {arguments.dynamics} --out docs/results/missions",
        "```",
        "",
        f"| {' | '.join(COLUMNS)} |",
        "|---" * len(COLUMNS) + "|",
    ]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def main() -> None:
    """Measure all cases and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--difficulties", default=",".join(DIFFICULTIES))
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--dynamics", default="bullet")
    parser.add_argument("--out", type=Path, default=Path("out/missions"))
    parser.add_argument("--runs", type=Path, default=Path("out/missions/runs"))
    arguments = parser.parse_args()
    cases = itertools.product(arguments.tasks.split(","), arguments.difficulties.split(","))
    rows = [measure(*case, arguments) for case in cases]
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_file(arguments.out / "missions.md", markdown(rows, arguments))


if __name__ == "__main__":
    main()
