"""`bulletuav train`: train a policy, in one run or with several seeds and tasks."""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from bulletuav.analysis.evaluation import evaluate
from bulletuav.commands.arguments import (
    add_options,
    add_trust,
    given_options,
    out_folder,
    parse_pairs,
    show_episodes,
)
from bulletuav.commands.evaluate import print_score
from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.control.actions import CHOICES
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.files import replace_file
from bulletuav.interrupts import TEXT
from bulletuav.policies.run import (
    ALGORITHMS,
    CONFIG,
    INTERFACE,
    POLICY,
    SCENE,
    RunConfig,
    shipped,
    shipped_tasks,
)
from bulletuav.report.charts import plot_curves
from bulletuav.tasks import find_task
from bulletuav.training.campaign import Campaign, learning_table, wall_time
from bulletuav.training.store import (
    CURVE,
    UPDATES,
    Row,
    evaluation_conditions,
    training_conditions,
)

ABOUT = {
    "help": "train a policy that all drones share, with stable-baselines3",
    "description": (
        "Train a policy that all drones share (extra 'sb3'). The folder of a run holds run.yaml, "
        "which reproduces it, policy.safetensors, checkpoints, the learning curve and "
        "TensorBoard's files. The same command continues where it was interrupted, to the same "
        "weights. Tasks with a policy in the package start from its settings."
    ),
    "epilog": """examples:
  bulletuav train crossing --algo ppo --steps 2e6 --seed 0 --out crossing-run
  bulletuav evaluate crossing-run
  bulletuav train pursuit --algo sac --curriculum easy,medium --dynamics point_mass \\
      --model gamma=0.98 --out pursuit-sac
  bulletuav train --config crossing-run/run.yaml --out again
  bulletuav train --all --seeds 0,1,2 --workers 2 --out learning""",
}
Result = TypeVar("Result")
"""What some work gives"""
GIVEN = ("seed", "steps", "worlds", "evaluations", "episodes")
"""Arguments that are fields of `RunConfig` under the same name"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what to learn, by which algorithm, for how long, where to write, and the options."""
    # What to train: a task, a file, or all that the package ships
    parser.add_argument("task", nargs="?", help="one of `bulletuav tasks`")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the run.yaml of a run, or one like it"
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help=f"train the package's policies: {', '.join(shipped_tasks())}",
    )
    # How, how often, and where to write
    add_run(parser)
    parser.add_argument(
        "--seeds",
        type=seeds,
        metavar="A,B",
        help="train once with each seed, and draw their curves together",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="with --all or --seeds: runs at once, each in a process (default: 1)",
    )
    parser.add_argument(
        "--mlflow",
        action="store_true",
        help="tell MLflow, too, where MLFLOW_TRACKING_URI says (extra 'mlflow')",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in training/)"
    )


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the settings of a run, and the options of its environment."""
    # The learner
    parser.add_argument("--algo", help=f"{', '.join(ALGORITHMS)} (default: ppo)")
    parser.add_argument("--steps", type=count, help="decisions of all drones together, such as 2e6")
    parser.add_argument("--seed", type=int, help="same seed, same weights (default: 0)")
    parser.add_argument("--worlds", type=int, help="worlds that fly at once")
    # How its progress is judged
    parser.add_argument(
        "--evaluations",
        type=int,
        metavar="N",
        help="evaluations during the training, each with a checkpoint",
    )
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each evaluation")
    parser.add_argument(
        "--curriculum",
        metavar="A,B",
        help="difficulties, easiest first: one stage for each, the next after success",
    )
    parser.add_argument(
        "--model",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="setting of the algorithm, such as gamma=0.98; can be repeated",
    )
    add_trust(parser)
    add_options(parser)


def count(text: str) -> int:
    """Parse a whole number, which may be written as 2e6.

    Raises:
        ValueError: It is not one; argparse makes the message.
    """
    number = float(text)
    if not number.is_integer():
        raise ValueError
    return int(number)


def seeds(text: str) -> list[int]:
    """Parse whole numbers with commas between them, and keep each once.

    Raises:
        ValueError: There is anything else; argparse makes the message.
    """
    return list(dict.fromkeys(int(part) for part in text.split(",")))


def run(arguments: argparse.Namespace) -> None:
    """Train, print and draw."""
    # Say what is contradictory before anything is read.
    if sum([arguments.task is not None, arguments.config is not None, arguments.all]) != 1:
        raise ValueError("train what? Give one of TASK, --config FILE or --all")
    for one, other in (("seed", "seeds"), ("difficulty", "curriculum")):
        if getattr(arguments, one) is not None and getattr(arguments, other):
            raise ValueError(f"--{one} and --{other}: give one of them")
    if arguments.all:
        bases = [_shipped_config(task) for task in shipped_tasks()]
    else:
        bases = [base_config(arguments, arguments.task)]
    configs = [run_config(arguments, base) for base in bases]
    if arguments.all or arguments.seeds:
        _train_several(arguments, configs)
    else:
        _train_one(arguments, configs[0])


def run_config(arguments: argparse.Namespace, base: RunConfig) -> RunConfig:
    """Change the settings that a run starts from by what was given on the command line.

    Options that were given hold in training and in evaluations, so that `evaluate` with the same
    options finds the same score.

    Args:
        arguments: Parsed arguments of a command with those of `add_run`.
        base: The settings that it starts from.

    Raises:
        ValueError: A setting is impossible, or of a form that cannot be read.
    """
    given = given_options(arguments)
    algo = arguments.algo or base.algo
    options = {**base.options, **given}
    model = parse_pairs("--model", arguments.model)
    if algo == base.algo:
        model = {**base.model, **model}
    else:
        # Settings of one algorithm are not those of another.
        options = _with_action(base.task, algo, options)

    changes: dict[str, Any] = {
        name: getattr(arguments, name) for name in GIVEN if getattr(arguments, name) is not None
    }
    # Evaluations take over the others by themselves
    held = {name: value for name, value in given.items() if name not in (*INTERFACE, *SCENE)}
    kept = {name: value for name, value in base.evaluation.items() if name not in given}
    changes["evaluation"] = {**kept, **held}
    # A curriculum of difficulties replaces the stages of the settings.
    if arguments.curriculum:
        changes["stages"] = [{"difficulty": name} for name in arguments.curriculum.split(",")]
        changes["curriculum"] = {}
    else:
        changes["stages"] = _stages_without(base, given)
    return dataclasses.replace(base, algo=algo, options=options, model=model, **changes)


def base_config(arguments: argparse.Namespace, task: str | None) -> RunConfig:
    """Read the settings of the file or of the package, or take the defaults.

    The package's settings say how a task is learned. Its difficulty, the other options of `SCENE`
    and those of evaluations are the task's own unless they are given, as in `evaluate`.

    Args:
        arguments: Parsed arguments of a command with `--config`.
        task: The task, where no file is given.

    Raises:
        ValueError: The file holds no settings, or there is no such task.
    """
    if arguments.config is not None:
        is_folder = arguments.config.is_dir()
        file = arguments.config / CONFIG if is_folder else arguments.config
        return RunConfig.read(file, arguments.trust)
    assert task is not None
    if find_task(task).name not in shipped_tasks():
        return RunConfig(task)
    known = _shipped_config(task)
    options = {name: value for name, value in known.options.items() if name not in SCENE}
    return dataclasses.replace(known, options=options, evaluation={})


def _shipped_config(task: str) -> RunConfig:
    """Read the settings with which the package's policy of a task was trained, with seed 0."""
    return dataclasses.replace(RunConfig.read(shipped(task) / CONFIG), seed=0)


def _stages_without(base: RunConfig, given: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Drop from the stages what was given, which goes before it; equal stages become one."""
    stages = [
        {name: value for name, value in stage.items() if name not in given} for stage in base.stages
    ]
    return stages if any(stage != stages[0] for stage in stages) else stages[:1]


def _with_action(
    task: str,
    algo: str,
    options: dict[str, Any],
) -> dict[str, Any]:
    """Give DQN, which chooses among discrete actions, those of `discrete` unless it has others."""
    if algo != "dqn":
        return options
    common = resolve_options(find_task(task), options).options
    if common.action in CHOICES:
        return options
    return {**options, "action": "discrete"}


def _train_one(arguments: argparse.Namespace, config: RunConfig) -> None:
    """Train one run in its folder."""
    # Imported here, as only from here on the extra is needed.
    from bulletuav.training.trainer import train

    # Each run has a folder of its own, so that several do not meet.
    default = Path("training") / f"{config.task}-{config.algo}-{config.seed}"
    out = out_folder(arguments.out or default)
    print_conditions(f"in training: {training_conditions(config)}")
    with show_progress(f"training {config.task}", config.steps, "steps") as report:
        mlflow = arguments.mlflow
        rows = or_tell(out, lambda: train(config, out, report, report.note, mlflow))
    _finish(
        arguments,
        out,
        [(config, rows)],
        [out],
        [out / CONFIG, out / POLICY, out / CURVE, out / UPDATES],
    )


def _train_several(arguments: argparse.Namespace, configs: list[RunConfig]) -> None:
    """Train each configuration with each seed, in folders below `runs`."""
    out = out_folder(arguments.out or Path("training"))
    chosen = arguments.seeds or ([0, 1, 2] if arguments.seed is None else [arguments.seed])
    runs = [dataclasses.replace(config, seed=seed) for config in configs for seed in chosen]
    campaign = Campaign(runs, out / "runs", arguments.mlflow)
    for conditions in dict.fromkeys(map(evaluation_conditions, runs)):
        print_conditions(f"evaluations in training: {conditions}")
    with show_progress(f"training {len(runs)} runs", campaign.total, "steps") as report:
        workers = arguments.workers
        learned = or_tell(out, lambda: campaign.train(workers, report, report.note))
    _finish(arguments, out, learned, [campaign.place(config) for config in runs], [])


def or_tell(out: Path, work: Callable[[], Result]) -> Result:
    """Do the work; where it is interrupted, say how to go on.

    Args:
        out: The folder of the work.
        work: What to do.

    Returns:
        What it gives.

    Raises:
        KeyboardInterrupt: With a line about what is kept.
    """
    try:
        return work()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{TEXT}: the same command goes on from the last checkpoint in {out}, to the same "
            f"weights"
        ) from None


def print_conditions(text: str) -> None:
    """Print what progress is told of, once, where progress goes."""
    print(text, file=sys.stderr)


def _finish(
    arguments: argparse.Namespace,
    out: Path,
    runs: list[tuple[RunConfig, list[Row]]],
    folders: list[Path],
    files: list[Path],
) -> None:
    """Evaluate the final policies, print and write their table, and draw the learning curves."""
    table = out / "learning.md"
    picture = out / "curves.png"
    plot_curves(runs, picture)
    # As `bulletuav evaluate` flies the folder of a run
    total = sum(config.episodes for config, _ in runs)
    with show_episodes(total) as advance:
        scores = [
            evaluate(
                config.task,
                str(folder),
                config.episodes,
                workers=arguments.workers,
                progress=advance,
                trust=True,  # modules that these settings name are imported already
                **config.evaluated,
            )
            for (config, _), folder in zip(runs, folders, strict=True)
        ]
    replace_file(table, learning_table(runs, scores))
    print(table.read_text(encoding="utf-8"))
    for config, rows in runs:
        named = f"{config.task}, {config.algo}, action {config.action}, seed {config.seed}"
        print(f"{named}: {wall_time(rows)}")
    for score in scores:
        print_score(score, f", options of {Path(score.about['policy']) / CONFIG}")
    print_files([*files, table, picture])
