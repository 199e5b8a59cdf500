"""Train policies of tasks by `fast_ppo`, put the best seeds into the package, and tabulate them.

    python benchmarks/ship.py free_flight obstacles --seeds 0 1 2
    python benchmarks/ship.py free_flight --table

Trains each task with its default settings, as `bulletuav train TASK --algo fast_ppo`. The best seed
has the largest mean safe success in new episodes of the levels `DECIDING`, which no curve and no
table shows: the few episodes of a curve would mistake luck for skill. It is put into the package if
it is better than `stay`, and at least as good as the policy which the package has. The policies of
the tasks are then flown in all levels beside `stay` and the baseline, in episodes which decided
nothing. The scores are written beside the policy, which warns of levels where it is not better than
`stay`, and into the page docs/benchmarks/trained_policies.md.

With `--table`, only flies the policies that are in the package. A repeated call continues, and
trains no finished run again.
"""

import argparse
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.analysis.evaluation import evaluate
from bulletuav.analysis.metrics.estimates import Estimate
from bulletuav.files import replace_file
from bulletuav.policies import find_policy
from bulletuav.policies.neural_network import ACTORS, HIGH, LOW, read_weights, write_weights
from bulletuav.policies.run import (
    CHECKPOINTS,
    CONFIG,
    FAST,
    POLICY,
    SHIPPED,
    RunConfig,
    shipped_tasks,
    write_settings,
)
from bulletuav.policies.scores import SCORES, read_scores, show
from bulletuav.tasks import find_task
from bulletuav.training.schedules import default_run
from bulletuav.training.store import EVALUATION_SEED
from bulletuav.training.trainer import train

LEVELS = ("easy", "medium", "hard", "extreme")
DECIDING = ("easy", "medium")
"""Levels in which episodes decide between seeds"""
KEEPING = ("easy", "medium", "hard")
"""Levels in which a new policy must be as good as that of the package"""
DECIDING_SEED = 2 * EVALUATION_SEED
TABLE_SEED = 7 * EVALUATION_SEED
PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "trained_policies.md"
CPU = "cpu_seconds"
"""Name of the file of a run with the CPU time of its training"""
CHOICE = re.compile(r"^# Best of (.+)$", re.MULTILINE)
"""Comment in the run.yaml of a policy in the package"""
INTRODUCTION = """\
# Policies in the package

`--policy trained` flies these policies. Each one observes only what its row lists. Written by
`python benchmarks/ship.py TASK`, which trains a task by `bulletuav train TASK --algo fast_ppo` with
several seeds, and chooses the best one in other episodes: mean safe success at easy and medium. In
`converge`, `crossing`, `hover` and `mec` the best of three seeds is not better than the policy that
the package had ([numbers](../lab/trained_policies.md#best-of-three-seeds)), which stays.
"""
SETTINGS = (
    "task",
    "algorithm",
    "decisions",
    "trained with",
    "observes",
    "seeds: safe success; training time",
)
SCORES_HEAD = ("task", "difficulty", "`trained`", "`stay`", "baseline", "episodes")


def train_seed(task: str, seed: int, folder: Path) -> Path:
    """Train a task with a seed, and return the folder of the run."""
    run = folder / f"{task}-{seed}"
    started = time.process_time()
    train(replace(default_run(task, FAST), seed=seed), run)
    if not (run / CPU).exists():
        replace_file(run / CPU, f"{time.process_time() - started:.1f}\n")
    return run


def fly(task: str, policy: str | Path, level: str, episodes: int, seed: int) -> Estimate:
    """Estimate the safe success of a policy at a difficulty, in the default dynamics."""
    options = {**evaluation_options(task, policy), "difficulty": level}
    return evaluate(task, policy, episodes, seed, **options).estimates()["safe_success"]


def evaluation_options(task: str, policy: str | Path) -> dict[str, Any]:
    """Return the options of evaluations which a trained policy needs, such as a horizon."""
    if policy != "trained" and not isinstance(policy, Path):
        return {}
    run = SHIPPED / task if policy == "trained" else Path(policy)
    return dict(RunConfig.read(run / CONFIG).evaluation)


def decide(task: str, policy: str | Path, episodes: int, levels: Sequence[str] = DECIDING) -> float:
    """Return the mean safe success of a policy at some levels, in the deciding episodes."""
    flown = [fly(task, policy, level, episodes, DECIDING_SEED).mean for level in levels]
    return sum(flown) / len(flown)


def ship_best(
    task: str, runs: Sequence[Path], episodes: int, levels: Sequence[str] = LEVELS
) -> bool:
    """Put the best run into the package if it is better than `stay` and not worse than the present.

    Args:
        task: Name of the task.
        runs: Folders of finished runs, one for each seed.
        episodes: Number of episodes at each deciding level.
        levels: Levels that the policies can fly; others do not decide.

    Returns:
        True if the package has the best run now.
    """
    deciding = [level for level in DECIDING if level in levels]
    keeping = [level for level in KEEPING if level in levels]
    found = [decide(task, run, episodes, deciding) for run in runs]
    listed = ", ".join(f"{one:.3f}" for one in found)
    best = max(range(len(runs)), key=found.__getitem__)
    stay = decide(task, "stay", episodes, deciding)
    print(f"{task}: safe success {listed}, stay {stay:.3f}")
    if found[best] <= stay:
        print(f"{task}: no run is better than stay")
        return False
    if task in shipped_tasks():
        present, new = (
            decide(task, policy, episodes, keeping) for policy in ("trained", runs[best])
        )
        print(f"{task}: {' '.join(keeping)} {new:.3f}, the policy in the package {present:.3f}")
        if new < present:
            print(f"{task}: the policy in the package is kept")
            return False
    place = SHIPPED / task
    # Those of the policy before
    (place / SCORES).unlink(missing_ok=True)
    for name in (POLICY, f"{CHECKPOINTS}/000/{POLICY}"):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        write_weights(actor_weights(runs[best] / name), place / name)
    seeds = [RunConfig.read(run / CONFIG).seed for run in runs]
    times = ", ".join(f"{float((run / CPU).read_text()):.0f}" for run in runs)
    version, settings = RunConfig.read(runs[best] / CONFIG).text().split("\n", 1)
    choice = f"# Best of seeds {', '.join(map(str, seeds))}: {listed}; CPU-s {times}"
    replace_file(place / CONFIG, f"{version}\n{choice}\n{settings}")
    size = (place / POLICY).stat().st_size / 1e3
    print(f"{task}: seed {seeds[best]} is in the package, {size:.0f} kB")
    return True


def actor_weights(path: Path) -> dict[str, np.ndarray]:
    """Read the weights of a policy which flight needs, a third of all; none of the critic.

    Args:
        path: The policy.safetensors of a run or of a checkpoint.
    """
    actor = ACTORS[FAST]
    kept = (*actor.layers, actor.features, LOW, HIGH)
    return {name: array for name, array in read_weights(path).items() if name.startswith(kept)}


def settings_row(task: str) -> str:
    """Return the row of the table of settings for a policy in the package."""
    path = SHIPPED / task / CONFIG
    config, choice = RunConfig.read(path), CHOICE.search(path.read_text())
    drawn = [
        f"{name} {config.options[name]}"
        for name in ("difficulty", "num_drones", "dynamics", "action")
        if name in config.options
    ]
    observed = config.options.get("observation", find_task(task).observation)
    named = [str(getattr(one, "__name__", one)) for one in observed]
    cells = (
        f"`{task}`",
        f"`{config.algo}`",
        f"{config.steps / 1e6:g} million",
        ", ".join(drawn) or "defaults",
        ", ".join(named),
        choice[1] if choice else f"seed {config.seed}",
    )
    return line(cells)


def measure(task: str, levels: Iterable[str], episodes: int) -> None:
    """Fly the policy of the package, `stay` and the baseline, and write their scores beside it."""
    scores = dict(read_scores(task))
    for level in levels:
        score: dict[str, Any] = {"episodes": episodes}
        for policy in ("trained", "stay", find_task(task).baseline):
            found = fly(task, policy, level, episodes, TABLE_SEED)
            score[policy] = [round(end, 3) for end in (found.mean, found.low, found.high)]
        scores[level] = score
        print(score_row(task, level, score), flush=True)
        kept = {name: scores[name] for name in LEVELS if name in scores}
        replace_file(SHIPPED / task / SCORES, write_settings(kept))


def score_row(task: str, level: str, score: Mapping[str, Any]) -> str:
    """Return the row of the table of scores for a level of a task."""
    baseline = list(score)[-1]
    mark = " \\*" if find_policy(baseline, task).reads_swarm else ""
    trained, stay, other = (show(score[name]) for name in ("trained", "stay", baseline))
    cells = (f"`{task}`", level, trained, stay, f"{other} `{baseline}`{mark}")
    return line((*cells, str(score["episodes"])))


def line(cells: Sequence[str]) -> str:
    """Format a row of a table."""
    return f"| {' | '.join(cells)} |"


def write_page(page: Path) -> None:
    """Write the page: settings and scores of all policies in the package.

    Args:
        page: Path of the page.
    """
    scores = [
        score_row(task, level, score)
        for task in shipped_tasks()
        for level, score in read_scores(task).items()
    ]
    text = "\n".join(
        [
            INTRODUCTION,
            *(line(SETTINGS), "|---" * len(SETTINGS) + "|"),
            *(settings_row(task) for task in shipped_tasks()),
            "",
            "## Safe success",
            "",
            "Fraction of drones which succeed without conflict or collision, with its 95 %",
            "confidence interval, in the default dynamics of the task. Episodes have seeds from",
            f"{TABLE_SEED:,} on. Baselines marked \\* read the true state.",
            "`--policy trained` warns where the interval of `trained` is not above that of `stay`.",
            "",
            *(line(SCORES_HEAD), "|---" * len(SCORES_HEAD) + "|"),
            *scores,
        ]
    )
    replace_file(page, f"{text}\n")


def main() -> None:
    """Train, choose, ship and tabulate the tasks of the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("tasks", nargs="+", metavar="TASK")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--episodes", type=int, default=50, help="of each row (default: 50)")
    parser.add_argument(
        "--levels", nargs="+", choices=LEVELS, default=LEVELS, help="that the policies can fly"
    )
    parser.add_argument("--table", action="store_true", help="train nothing, only fly")
    parser.add_argument(
        "--out", type=Path, default=Path("training/shipped"), help="folder of the runs"
    )
    given = parser.parse_args()
    if not given.table and not set(DECIDING) & set(given.levels):
        parser.error(f"--levels {' '.join(given.levels)}: {' or '.join(DECIDING)} has to decide")
    for task in given.tasks:
        if not given.table:
            runs = [train_seed(task, seed, given.out) for seed in given.seeds]
            ship_best(task, runs, given.episodes, given.levels)
        if task in shipped_tasks():
            measure(task, given.levels, given.episodes)
            write_page(PAGE)


if __name__ == "__main__":
    main()
