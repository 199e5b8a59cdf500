"""`bulletuav train`: policies that learn, one run or several seeds of several tasks."""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

from rich.console import Console

from bulletuav.commands.arguments import (
    add_options,
    given_options,
    literals,
    out_folder,
    tell_files,
)
from bulletuav.commands.progress import telling
from bulletuav.envs.resolve import resolve
from bulletuav.files import replace_file
from bulletuav.policies.run import ALGORITHMS, CONFIG, POLICY, RunConfig, shipped, shipped_tasks
from bulletuav.report.charts import plot_curves
from bulletuav.tasks import find_task
from bulletuav.training.campaign import Campaign, learning_table
from bulletuav.training.store import CURVE, Row

ABOUT = {
    "help": "train a policy that all drones share, with stable-baselines3",
    "description": (
        "Train a policy that all drones share (extra 'sb3'). The folder of a run holds run.yaml, which reproduces it, "
        "policy.safetensors, checkpoints, the learning curve and TensorBoard's files. The same command goes on where it was "
        "interrupted, to the same weights. Tasks with a policy in the package start from its settings."
    ),
    "epilog": """examples:
  bulletuav train crossing --algo ppo --steps 2e6 --seed 0 --out crossing-run
  bulletuav evaluate crossing --policy crossing-run
  bulletuav train pursuit --algo sac --curriculum easy,medium --dynamics point_mass --model gamma=0.98 --out pursuit-sac
  bulletuav train --config crossing-run/run.yaml --out again
  bulletuav train --all --seeds 0,1,2 --workers 2 --out learning""",
}
GIVEN = ("seed", "steps", "worlds", "evaluations", "episodes")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is learned, by which algorithm, for how long, where to, and the options."""
    parser.add_argument("task", nargs="?", help="one of `bulletuav tasks`")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="the run.yaml of a run, or one like it"
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help=f"train the package's policies: {', '.join(shipped_tasks())}",
    )
    parser.add_argument("--algo", help=f"{', '.join(ALGORITHMS)} (default: ppo)")
    parser.add_argument("--steps", type=count, help="decisions of all drones together, such as 2e6")
    parser.add_argument("--seed", type=int, help="same seed, same weights (default: 0)")
    parser.add_argument(
        "--seeds",
        type=seeds,
        metavar="A,B",
        help="train once with each, and draw their curves together",
    )
    parser.add_argument("--worlds", type=int, help="worlds that fly at once")
    parser.add_argument(
        "--evaluations", type=int, metavar="N", help="checkpoints with an evaluation on the way"
    )
    parser.add_argument("--episodes", type=int, metavar="N", help="of each evaluation")
    parser.add_argument(
        "--curriculum",
        metavar="A,B",
        help="difficulties, easiest first, through which success leads",
    )
    parser.add_argument(
        "--model",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="setting of the algorithm",
    )
    parser.add_argument(
        "--workers", type=int, default=1, help="runs at once, each a process, with --all or --seeds"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in training/)"
    )
    add_options(parser)


def count(text: str) -> int:
    """A whole number, also one written as 2e6. Raises ValueError, which argparse tells, for another one."""
    number = float(text)
    if not number.is_integer():
        raise ValueError
    return int(number)


def seeds(text: str) -> list[int]:
    """Whole numbers with commas between them, each once. Raises ValueError, which argparse tells, for anything else."""
    return list(dict.fromkeys(int(part) for part in text.split(",")))


def run(arguments: argparse.Namespace) -> None:
    """Train, print and draw."""
    if sum([arguments.task is not None, arguments.config is not None, arguments.all]) != 1:
        raise ValueError("train what? Give one of TASK, --config FILE or --all")
    for one, other in (("seed", "seeds"), ("difficulty", "curriculum")):
        if getattr(arguments, one) is not None and getattr(arguments, other):
            raise ValueError(f"--{one} and --{other}: give one of them")
    configs = [
        _config(arguments, task)
        for task in (shipped_tasks() if arguments.all else [arguments.task])
    ]
    if arguments.all or arguments.seeds:
        _several(arguments, configs)
    else:
        _single(arguments, configs[0])


def _config(arguments: argparse.Namespace, task: str | None) -> RunConfig:
    """The settings of the file, the package's or the default ones, changed as the arguments say."""
    if arguments.config is not None:
        base = RunConfig.read(
            arguments.config / CONFIG if arguments.config.is_dir() else arguments.config
        )
    else:
        assert task is not None
        known = find_task(task).name in shipped_tasks()
        base = (
            dataclasses.replace(RunConfig.read(shipped(task) / CONFIG), seed=0)
            if known
            else RunConfig(task)
        )
    changes: dict[str, Any] = {
        name: getattr(arguments, name) for name in GIVEN if getattr(arguments, name) is not None
    }
    given, algo = given_options(arguments), arguments.algo or base.algo
    options = {**base.options, **given}
    if algo != base.algo:
        options = _with_action(base.task, algo, options)
    model = {**(base.model if algo == base.algo else {}), **literals("--model", arguments.model)}
    if arguments.curriculum:
        changes |= {
            "stages": [{"difficulty": name} for name in arguments.curriculum.split(",")],
            "curriculum": {},
        }
    else:  # what is given goes before what stages say
        stages = [
            {name: value for name, value in stage.items() if name not in given}
            for stage in base.stages
        ]
        changes["stages"] = stages if any(stage != stages[0] for stage in stages) else stages[:1]
    return dataclasses.replace(base, algo=algo, options=options, model=model, **changes)


def _with_action(task: str, algo: str, options: dict[str, Any]) -> dict[str, Any]:
    """DQN chooses among discrete actions, by default those of `discrete`."""
    if algo == "dqn" and resolve(find_task(task), options)[0].action not in (
        "discrete",
        "discrete_27",
    ):
        return {**options, "action": "discrete"}
    return options


def _single(arguments: argparse.Namespace, config: RunConfig) -> None:
    from bulletuav.training.trainer import train  # from here on the extra is needed

    out = out_folder(
        arguments.out or Path("training") / f"{config.task}-{config.algo}-{config.seed}"
    )
    with telling(f"training {config.task}", config.steps, "steps") as progress:
        rows = train(config, out, progress)
    _finish(out, [(config, rows)], [out / CONFIG, out / POLICY, out / CURVE])


def _several(arguments: argparse.Namespace, configs: list[RunConfig]) -> None:
    out = out_folder(arguments.out or Path("training"))
    chosen = arguments.seeds or ([0, 1, 2] if arguments.seed is None else [arguments.seed])
    campaign = Campaign(
        [dataclasses.replace(config, seed=seed) for config in configs for seed in chosen],
        out / "runs",
    )
    with telling(f"training {len(campaign.configs)} runs", campaign.total, "steps") as progress:
        runs = campaign.train(arguments.workers, progress)
    _finish(out, runs, [])


def _finish(out: Path, runs: list[tuple[RunConfig, list[Row]]], files: list[Path]) -> None:
    """The table and the picture of the curves."""
    table, picture = out / "learning.md", out / "curves.png"
    replace_file(table, learning_table(runs))
    plot_curves(runs, picture)
    console = Console()
    console.print(table.read_text(), markup=False, soft_wrap=True)
    tell_files(console, [*files, table, picture])
