"""Arguments of `bulletuav tune`."""

import argparse
from pathlib import Path

from bulletuav.commands.parsers.deferred import DeferredHelp
from bulletuav.commands.parsers.train import add_run

ABOUT = {
    "help": "search hyperparameters of training runs, with Optuna",
    "description": (
        "Train runs with settings from a search space, each a run of `bulletuav train`, and print "
        "the best (extras 'tune' and 'sb3'). The trials depend only on the seed, not on the "
        "number of processes. The same command resumes an interrupted study; "
        "with more --trials it continues."
    ),
    "epilog": """examples:
  bulletuav tune crossing --dynamics point_mass --steps 3e5 --trials 24 --workers 2 \\
      --search model.learning_rate=1e-4:3e-3:log --search model.n_epochs=2:10 \\
      --search options.num_neighbours=2,4,6 --out study
  bulletuav tune --study study/study.yaml --out again
  bulletuav train --config study/trials/000/run.yaml --steps 4e6 --out long""",
}


@DeferredHelp
def _study() -> str:
    from bulletuav.training.study import STUDY

    return f"{STUDY} of a study"


@DeferredHelp
def _metrics() -> str:
    from bulletuav.analysis.metrics import METRICS

    return f"objective, of the last evaluation: {', '.join(METRICS)} (default: return)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add search space, number of trials, and settings of the runs."""
    # Source of the settings that do not vary
    parser.add_argument("task", nargs="?", help="one of `bulletuav tasks`")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="run.yaml with the fixed settings"
    )
    parser.add_argument("--study", type=Path, metavar="FILE", help=_study)
    parser.add_argument(
        "--search",
        action="append",
        default=[],
        metavar="NAME=RANGE",
        help=(
            "setting to search, by its name in run.yaml, such as model.gamma=0.9:0.999, "
            "model.learning_rate=1e-4:1e-2:log, options.num_neighbours=2,4; can be repeated"
        ),
    )
    parser.add_argument(
        "--metric",
        help=_metrics,
    )
    parser.add_argument("--trials", type=int, metavar="N", help="number of runs (default: 20)")
    parser.add_argument(
        "--batch",
        type=int,
        metavar="N",
        help="trials that are suggested at a time; it affects the suggestions (default: 4)",
    )
    parser.add_argument(
        "--workers",
        type=int,
        default=1,
        help="number of processes; it does not change the results (default: 1)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the files (default: one in tuning/)"
    )
    add_run(parser)
