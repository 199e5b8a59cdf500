"""`bulletuav tune`: search hyperparameters of a training run."""

import argparse
from pathlib import Path
from typing import Any

from bulletuav.commands.arguments import make_out_folder, parse_pairs
from bulletuav.commands.output import print_files
from bulletuav.commands.progress import show_progress
from bulletuav.commands.train import (
    base_config,
    print_conditions,
    run_config,
    with_resume_hint,
)
from bulletuav.errors import shown
from bulletuav.files import replace_file
from bulletuav.policies.run import CONFIG
from bulletuav.policies.space import Space, parse_space
from bulletuav.report.study import plot_study, study_table
from bulletuav.training.store import evaluation_conditions
from bulletuav.training.study import STUDY, TRIALS, Study, best_trials, run_study

STUDY_ARGUMENTS = ("metric", "trials", "batch")
"""Arguments that are settings of a study under the same name"""
KEYS = ("low", "high", "step")
"""Values between colons, in this order"""
FORM = "LOW:HIGH, LOW:HIGH:log, LOW:HIGH:STEP or A,B,C is needed"
"""Required form of the argument of --search"""


def run(arguments: argparse.Namespace) -> None:
    """Run the study, print the results and plot them."""
    # An interrupted study continues with the missing trials
    study = _study(arguments)
    out = make_out_folder(arguments.out or Path("tuning") / study.run.task)
    print_conditions(f"evaluations of the trials: {evaluation_conditions(study.run)}")
    with show_progress(f"tuning {study.run.task}", study.trials, "trials") as report:
        trials = with_resume_hint(
            out, lambda: run_study(study, out, arguments.workers, report, report.note)
        )
    # Results, as a table and a picture
    table, picture = out / "study.md", out / "study.png"
    text = study_table(study, trials)
    replace_file(table, text)
    plot_study(study, trials, picture)
    print(text)
    # Command that continues with the best settings
    best = best_trials(study, trials)[0].folder / CONFIG
    print(f"train the best one for longer: bulletuav train --config {best} --steps ... --out ...")
    print_files([out / STUDY, out / TRIALS, table, picture])


def _study(arguments: argparse.Namespace) -> Study:
    """Return the study of a study file, a run.yaml or a task, with given options."""
    sources = [arguments.task, arguments.config, arguments.study]
    if sum(source is not None for source in sources) != 1:
        raise ValueError("tune what? Give one of TASK, --config FILE or --study FILE")
    # Given options override the file
    settings: dict[str, Any] = {
        name: getattr(arguments, name)
        for name in STUDY_ARGUMENTS
        if getattr(arguments, name) is not None
    }
    space: Space = {}
    if arguments.study is not None:
        known = Study.read(arguments.study, arguments.trust)
        base, space = known.run, known.space
        settings = {name: getattr(known, name) for name in STUDY_ARGUMENTS} | settings
    else:
        base = base_config(arguments, arguments.task)
    # Without --search, a study file keeps its search space
    if arguments.search or not space:
        space = space | parse_space(_searched(arguments.search))
    return Study(run_config(arguments, base), space, **settings)


def _searched(pairs: list[str]) -> dict[str, Any]:
    """Parse --search to the form of a study file."""
    return {name: _range(name, value) for name, value in parse_pairs("--search", pairs).items()}


def _range(name: str, value: Any) -> dict[str, Any]:
    """Convert a value with colons or commas to a range or choices."""
    if isinstance(value, list | tuple):
        return {"choices": list(value)}
    parts = str(value).split(":")
    if len(parts) not in (2, 3):
        raise ValueError(f"--search {name}={shown(value)}: {FORM}")
    named = [f"{key}={part}" for key, part in zip(KEYS, parts, strict=False)]
    numbers = parse_pairs("--search", named)
    if numbers.get("step") == "log":
        return {"low": numbers["low"], "high": numbers["high"], "log": True}
    return numbers
