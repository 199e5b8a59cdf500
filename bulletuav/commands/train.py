"""`bulletuav train`: train policies, in one run or with several seeds and tasks."""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from bulletuav.analysis.evaluation import evaluate
from bulletuav.commands.arguments import (
    given_options,
    make_out_folder,
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
    COMPILED,
    CONFIG,
    CURVE,
    INTERFACE,
    POLICY,
    SCENE,
    RunConfig,
    shipped_tasks,
)
from bulletuav.report.charts import plot_curves
from bulletuav.tasks import find_task
from bulletuav.training.campaign import Campaign, describe_wall_time, learning_table
from bulletuav.training.schedules import default_run, shipped_run
from bulletuav.training.store import (
    UPDATES,
    Row,
    evaluation_conditions,
    planned_steps,
    training_conditions,
)
from bulletuav.training.trainer import train

Result = TypeVar("Result")
"""Result of a function"""
RUN_ARGUMENTS = ("seed", "steps", "worlds", "evaluations", "episodes")
"""Arguments that are fields of `RunConfig` under the same name"""


def run(arguments: argparse.Namespace) -> None:
    """Train, print the results and plot the learning curves."""
    # Report contradictions before any file is read
    if sum([arguments.task is not None, arguments.config is not None, arguments.all]) != 1:
        raise ValueError("train what? Give one of TASK, --config FILE or --all")
    for one, other in (("seed", "seeds"), ("difficulty", "curriculum")):
        if getattr(arguments, one) is not None and getattr(arguments, other):
            raise ValueError(f"--{one} and --{other}: give one of them")
    if arguments.all:
        bases = [shipped_run(task) for task in shipped_tasks()]
    else:
        bases = [base_config(arguments, arguments.task)]
    configs = [run_config(arguments, base) for base in bases]
    if arguments.all or arguments.seeds:
        _train_several(arguments, configs)
    else:
        _train_one(arguments, configs[0])


def run_config(arguments: argparse.Namespace, base: RunConfig) -> RunConfig:
    """Return the settings of a run: the base settings, overridden by the command line.

    Given options apply to training and to evaluations, so that `evaluate` with the same options
    returns the same score.

    Args:
        arguments: Parsed arguments of a command that uses `add_run`.
        base: The base settings.

    Raises:
        ValueError: If a setting is invalid, or cannot be parsed.
    """
    given = given_options(arguments)
    algo = arguments.algo or base.algo
    options = {**base.options, **given}
    model = parse_pairs("--model", arguments.model)
    if algo == base.algo:
        model = {**base.model, **model}
    else:
        # Settings of another algorithm do not apply
        options = _with_action(base.task, algo, options)

    changes: dict[str, Any] = {
        name: getattr(arguments, name)
        for name in RUN_ARGUMENTS
        if getattr(arguments, name) is not None
    }
    # Evaluations use options of `INTERFACE` and `SCENE` automatically, and the benchmark's reward;
    # policies apply masks themselves
    inherited = (*INTERFACE, *SCENE, "reward", "action_masks")
    held = {name: value for name, value in given.items() if name not in inherited}
    kept = {name: value for name, value in base.evaluation.items() if name not in given}
    changes["evaluation"] = {**kept, **held}
    # A curriculum of difficulties replaces the stages of the settings
    if arguments.curriculum:
        changes["stages"] = [{"difficulty": name} for name in arguments.curriculum.split(",")]
        changes["curriculum"] = {}
    else:
        changes["stages"] = _stages_without(base, given)
    return dataclasses.replace(base, algo=algo, options=options, model=model, **changes)


def base_config(arguments: argparse.Namespace, task: str | None) -> RunConfig:
    """Return the base settings: from a file, or the defaults of a task.

    Args:
        arguments: Parsed arguments of a command with `--config`.
        task: The task, if no file is given.

    Raises:
        ValueError: If the file has no valid settings, or the task is unknown.
    """
    if arguments.config is not None:
        is_folder = arguments.config.is_dir()
        file = arguments.config / CONFIG if is_folder else arguments.config
        return RunConfig.read(file, arguments.trust)
    assert task is not None
    run = default_run(task, arguments.algo if arguments.algo in COMPILED else "ppo")
    # The dynamics of the defaults may not support the given action
    is_kept = "action" not in given_options(arguments)
    options = {name: one for name, one in run.options.items() if is_kept or name != "dynamics"}
    return dataclasses.replace(run, options=options)


def _stages_without(base: RunConfig, given: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Remove given options, which take precedence, from the stages; merge equal stages."""
    stages = [
        {name: value for name, value in stage.items() if name not in given} for stage in base.stages
    ]
    return stages if any(stage != stages[0] for stage in stages) else stages[:1]


def _with_action(task: str, algo: str, options: dict[str, Any]) -> dict[str, Any]:
    """Set the action `discrete` for DQN, unless the action is already discrete."""
    if algo != "dqn":
        return options
    common = resolve_options(find_task(task), options).options
    if common.action in CHOICES:
        return options
    return {**options, "action": "discrete"}


def _train_one(arguments: argparse.Namespace, config: RunConfig) -> None:
    """Train one run in its folder."""
    # By default each run has its own folder
    default = Path("training") / f"{config.task}-{config.algo}-{config.seed}"
    out = make_out_folder(arguments.out or default)
    print_conditions(f"in training: {training_conditions(config)}")
    _print_rounded([config])
    with show_progress(f"training {config.task}", config.steps, "steps") as report:
        tracker = arguments.tracker
        rows = with_resume_hint(out, lambda: train(config, out, report, report.note, tracker))
    _finish(
        arguments,
        out,
        [(config, rows)],
        [out],
        [out / CONFIG, out / POLICY, out / CURVE, out / UPDATES],
    )


def _train_several(arguments: argparse.Namespace, configs: list[RunConfig]) -> None:
    """Train each configuration with each seed, in folders below `runs`."""
    out = make_out_folder(arguments.out or Path("training"))
    chosen = arguments.seeds or ([0, 1, 2] if arguments.seed is None else [arguments.seed])
    runs = [dataclasses.replace(config, seed=seed) for config in configs for seed in chosen]
    campaign = Campaign(runs, out / "runs", arguments.tracker)
    for conditions in dict.fromkeys(map(evaluation_conditions, runs)):
        print_conditions(f"evaluations in training: {conditions}")
    _print_rounded(configs)
    with show_progress(f"training {len(runs)} runs", campaign.total, "steps") as report:
        workers = arguments.workers
        learned = with_resume_hint(out, lambda: campaign.train(workers, report, report.note))
    _finish(arguments, out, learned, [campaign.run_folder(config) for config in runs], [])


def with_resume_hint(out: Path, work: Callable[[], Result]) -> Result:
    """Call a function; after an interrupt, report how to resume.

    Args:
        out: The output folder.
        work: The function.

    Returns:
        The result of the function.

    Raises:
        KeyboardInterrupt: With a message about how to resume.
    """
    try:
        return work()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"{TEXT}: the same command resumes from the last checkpoint in {out}, with the same "
            f"final weights"
        ) from None


def print_conditions(text: str) -> None:
    """Print the conditions of the progress reports on standard error."""
    print(text, file=sys.stderr)


def _print_rounded(configs: Sequence[RunConfig]) -> None:
    """Print the steps of runs that do more than their settings ask for, on standard error."""
    for config in configs:
        planned = planned_steps(config)
        if planned != config.steps:
            print_conditions(
                f"{config.task}, {config.algo}: {config.steps:,} steps are rounded up to whole "
                f"rollouts, {planned:,} decisions of all drones"
            )


def _finish(
    arguments: argparse.Namespace,
    out: Path,
    runs: list[tuple[RunConfig, list[Row]]],
    folders: list[Path],
    files: list[Path],
) -> None:
    """Evaluate the final policies, print and write their table, and plot the curves."""
    table = out / "learning.md"
    picture = out / "curves.png"
    plot_curves(runs, picture)
    # As `bulletuav evaluate` does for the folder of a run
    total = sum(config.episodes for config, _ in runs)
    with show_episodes(total) as advance:
        scores = [
            evaluate(
                config.task,
                str(folder),
                config.episodes,
                workers=arguments.workers,
                progress=advance,
                trust=True,  # modules that these settings name are already imported
                **config.evaluated,
            )
            for (config, _), folder in zip(runs, folders, strict=True)
        ]
    replace_file(table, learning_table(runs, scores))
    print(table.read_text(encoding="utf-8"))
    for config, rows in runs:
        named = f"{config.task}, {config.algo}, action {config.action}, seed {config.seed}"
        print(f"{named}: {describe_wall_time(rows)}")
    for score in scores:
        print_score(score, f", options of {Path(score.about['policy']) / CONFIG}")
    print_files([*files, table, picture])
