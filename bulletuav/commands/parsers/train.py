"""Arguments of `bulletuav train`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp
from bulletuav.commands.parsers.shared import add_options, add_trust

ABOUT = {
    "help": "train a policy that all drones share, with stable-baselines3",
    "description": (
        "Train a policy that all drones share (extra 'sb3'). The folder of a run has run.yaml, "
        "which reproduces it, policy.safetensors, checkpoints, the learning curve and "
        "TensorBoard logs. The same command resumes an interrupted run, with the same final "
        "weights. Defaults depend on the task: schedules for flights to goals and for tasks with "
        "users, or the settings of the policy of the package."
    ),
    "epilog": """examples:
  bulletuav train crossing --algo ppo --steps 2e6 --seed 0 --out crossing-run
  bulletuav evaluate crossing-run
  bulletuav train pursuit --algo sac --curriculum easy,medium --dynamics point_mass \\
      --model gamma=0.98 --out pursuit-sac
  bulletuav train --config crossing-run/run.yaml --out again
  bulletuav train --all --seeds 0,1,2 --workers 2 --out learning""",
}


@DeferredHelp
def _policies() -> str:
    from bulletuav.policies.run import shipped_tasks

    return f"train the policies of the package: {', '.join(shipped_tasks())}"


@DeferredHelp
def _algorithms() -> str:
    from bulletuav.policies.run import ALGORITHMS

    return f"algorithm: {', '.join(ALGORITHMS)} (default: ppo)"


@DeferredHelp
def _trackers() -> str:
    from bulletuav.training.trackers import TRACKERS

    return f"also log to an experiment tracker: {' or '.join(TRACKERS)} (extra of that name)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add task, algorithm, duration, seeds, output folder and environment options."""
    # A task, a file of settings, or all tasks with a policy in the package
    parser.add_argument("task", nargs="?", help="one of `bulletuav tasks`")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="settings: run.yaml of a run, or a similar file"
    )
    parser.add_argument(
        "--all",
        action="store_true",
        help=_policies,
    )
    # Settings, seeds and output
    add_run(parser)
    parser.add_argument(
        "--seeds",
        type=parse_seeds,
        metavar="A,B",
        help="train once with each seed, and plot all learning curves",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="with --all or --seeds: number of parallel runs (default: 1)",
    )
    parser.add_argument(
        "--tracker",
        metavar="NAME",
        help=_trackers,
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in training/)"
    )


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the settings of a training run, and the options of its environment."""
    # Algorithm
    parser.add_argument("--algo", help=_algorithms)
    parser.add_argument(
        "--steps",
        type=parse_count,
        help="total decisions of all drones, such as 2e6; rounded up to whole rollouts",
    )
    parser.add_argument(
        "--seed", type=int, help="random seed; equal seeds give equal weights (default: 0)"
    )
    parser.add_argument("--worlds", type=int, help="number of parallel worlds")
    # Evaluation and curriculum
    parser.add_argument(
        "--evaluations",
        type=int,
        metavar="N",
        help="number of evaluations during training, each with a checkpoint",
    )
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each evaluation")
    parser.add_argument(
        "--curriculum",
        metavar="A,B",
        help="difficulties from easy to hard: a stage for each, the next one after success",
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


def parse_count(text: str) -> int:
    """Parse an integer, which may be written as 2e6.

    Raises:
        argparse.ArgumentTypeError: If the text is not an integer.
    """
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not number.is_integer():
        raise argparse.ArgumentTypeError(f"invalid count value: {text!r}")
    return int(number)


def parse_seeds(text: str) -> list[int]:
    """Parse comma-separated integers, without duplicates.

    Raises:
        argparse.ArgumentTypeError: If a part is not an integer.
    """
    try:
        return list(dict.fromkeys(int(part) for part in text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"invalid seeds value: {text!r}") from None
