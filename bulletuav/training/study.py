"""Hyperparameter studies: training runs whose settings are chosen from earlier results."""

import csv
import dataclasses
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bulletuav.analysis.conditions import Conditions
from bulletuav.analysis.metrics import METRICS
from bulletuav.errors import as_int, find_choice, shown, unknown
from bulletuav.files import replace_file
from bulletuav.interrupts import block_interrupts
from bulletuav.policies.run import MODULE_NAME, VERSION, RunConfig, read_settings, write_settings
from bulletuav.policies.space import Space, check_space, parse_space, with_values
from bulletuav.training.campaign import train_in_process, training_processes
from bulletuav.training.store import FolderError, Row, evaluation_conditions, lock_folder

STUDY = "study.yaml"
"""File with the settings of a study"""
TRIALS = "trials.csv"
"""File with the trials in order"""
RUNS = "trials"
"""Folder of the runs of the trials"""
MINIMISED = (
    "collision",
    "conflict",
    "conflicts",
    "near_misses",
    "length",
    "goal_distance",
    "jerk",
    "energy",
    "latency",
)
"""Metrics where lower is better"""
MAX_TRIALS = 10_000
"""Maximum number of trials of a study"""


@dataclass(frozen=True)
class Study:
    """Settings of a study.

    Attributes:
        run: Settings that do not vary. Its seed is also that of the study.
        space: Search space.
        metric: Objective: one of `METRICS`, of the last evaluation of each run.
        trials: Number of runs.
        batch: Number of trials that are suggested at a time, from the same results.
    """

    run: RunConfig
    space: Space
    metric: str = "return"
    trials: int = 20
    batch: int = 4

    def __post_init__(self) -> None:
        """Check all settings.

        Raises:
            ValueError: If a setting is invalid.
        """
        find_choice("metric", self.metric, METRICS)
        as_int("trials", self.trials, 1, MAX_TRIALS)
        as_int("batch", self.batch, 1, MAX_TRIALS)
        check_space(self.run, self.space)

    @classmethod
    def read(cls, path: Path, trust: bool = False) -> "Study":
        """Read the settings from a YAML file.

        Args:
            path: A file as `text` writes it, or a hand-written file with `version`, `run` (as
                `run.yaml`), `space` (see `parse_space`), and other settings.
            trust: If True, modules that the file names as `module:Name` may be imported.

        Raises:
            ValueError: If the file has another format or version, or an invalid setting.
            FileNotFoundError: If the file does not exist.
        """
        values = read_settings(path, f"{STUDY} of a study", trust)
        known = [field.name for field in dataclasses.fields(cls)]
        try:
            # Files may be written by hand, so check names first
            for name in values:
                if name not in known:
                    raise unknown("setting of a study:", name, known)
            for name in ("run", "space"):
                if not isinstance(values.get(name), Mapping):
                    raise ValueError(
                        f"{name} is {shown(values.get(name))}: names with values are needed"
                    )
            run, space = RunConfig.of(values["run"]), parse_space(values["space"])
            return cls(**{**values, "run": run, "space": space})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    @property
    def maximise(self) -> bool:
        """True if higher values of the metric are better."""
        return self.metric not in MINIMISED

    def text(self) -> str:
        """Return the settings as YAML, which `read` parses."""
        run = self.run.plain()
        del run["version"]
        space = {name: one.plain() for name, one in self.space.items()}
        rest = {"metric": self.metric, "trials": self.trials, "batch": self.batch}
        return write_settings({"version": VERSION, "run": run, "space": space, **rest})


class Trial(NamedTuple):
    """A run of a study.

    Attributes:
        number: Index of the trial, from 0.
        values: Values of the varied settings by name.
        result: Metric of the last evaluation; not finite if the trial failed.
        error: Reason of the failure; empty if the trial succeeded.
        folder: Folder of the run.
    """

    number: int
    values: dict[str, Any]
    result: float
    error: str
    folder: Path


def run_study(
    study: Study,
    folder: Path,
    workers: int = 1,
    progress: Callable[[int], None] = lambda trials: None,
    note: Callable[[str], None] = lambda text: None,
) -> list[Trial]:
    """Train the runs of a study, one batch at a time.

    The values of a batch depend only on the seed and on the results of earlier batches. Timing and
    the number of processes therefore do not change the study. A call with the same study resumes an
    interrupted one, and a call with more trials continues it.

    Args:
        study: The study.
        folder: The folder, created if missing.
        workers: Number of processes; each trains one run at a time.
        progress: Called with the number of finished trials.
        note: Called with a text of the best trial so far.

    Returns:
        The trials in order.

    Raises:
        FolderError: If the folder has another study, is locked by another process, or is not
            writable.
        ValueError: If a setting or `workers` is invalid, or all trials failed.
        ImportError: If the extra `tune` or `sb3` is not installed.
    """
    # Imported here, as it needs an extra
    from bulletuav.adapters.optuna import suggest
    from bulletuav.training.trainer import check_algorithm

    for name, one in study.space.items():
        check_algorithm(with_values(study.run, {name: one.first}))
    trials: list[Trial] = []
    with lock_folder(folder), training_processes(workers) as pool:
        _write_settings(study, folder)
        progress(0)
        # A batch depends on the results of earlier batches, whatever their order of completion
        while len(trials) < study.trials:
            tried = [(trial.values, trial.result) for trial in trials]
            count = min(study.batch, study.trials - len(trials))
            seed = (study.run.seed, len(trials))
            batch = suggest(study.space, tried, count, seed, study.maximise)
            futures = [
                _submit(pool, study, values, _run_folder(folder, len(trials) + k))
                for k, values in enumerate(batch)
            ]
            # Collect results in the order of the trials, and write the table after each
            for values, future in zip(batch, futures, strict=True):
                number = len(trials)
                outcome = _outcome(future, study.metric)
                trials.append(Trial(number, values, *outcome, _run_folder(folder, number)))
                replace_file(folder / TRIALS, _table(study, trials))
                note(_describe_best(study, trials))
                progress(len(trials))
    if all(trial.error for trial in trials):
        raise ValueError(f"all trials failed, the first one because: {trials[0].error}")
    return trials


def best_trials(study: Study, trials: Sequence[Trial]) -> list[Trial]:
    """Return the successful trials, best first; ties are in order of the trials."""
    done = [trial for trial in trials if not trial.error]
    return sorted(done, key=lambda trial: trial.result, reverse=study.maximise)


def trial_conditions(study: Study, trial: Trial) -> Conditions:
    """Return the evaluation conditions of a successful trial."""
    return evaluation_conditions(with_values(study.run, trial.values))


def _write_settings(study: Study, folder: Path) -> None:
    """Write the settings, after checking that they match those in the folder except for `trials`.

    Raises:
        FolderError: If the folder has another study.
    """
    path = folder / STUDY
    if path.exists():
        # Trust only modules that the study itself names
        known = Study.read(path, MODULE_NAME.search(study.text()) is not None)
        if dataclasses.replace(known, trials=study.trials).text() != study.text():
            raise FolderError(
                f"{folder} holds another study: see its {STUDY}; choose another folder"
            )
    replace_file(path, study.text())


def _run_folder(folder: Path, number: int) -> Path:
    return folder / RUNS / f"{number:03d}"


def _submit(pool: Executor, study: Study, values: Mapping[str, Any], folder: Path) -> Future[Any]:
    """Start a trial; a trial with an invalid combination of settings fails immediately."""
    try:
        config = with_values(study.run, values)
    except ValueError as error:
        future: Future[Any] = Future()
        future.set_exception(error)
        return future
    with block_interrupts():
        return pool.submit(train_in_process, config, folder)


def _outcome(future: Future[list[Row]], metric: str) -> tuple[float, str]:
    """Wait for a trial, and return its result, not finite if it failed, and the reason."""
    # Other errors, such as a full disk, are not due to the settings, and end the study
    try:
        result = float(future.result()[-1][metric])
    except FolderError:
        raise
    except ValueError as error:
        return math.nan, " ".join(str(error).split())
    return result, "" if math.isfinite(result) else f"its {metric} is {result}"


def _table(study: Study, trials: list[Trial]) -> str:
    """Return the trials as CSV with their conditions; values are in JSON."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["trial", study.metric, *study.space, "error", *Conditions._fields])
    for trial in trials:
        values = [json.dumps(trial.values[name]) for name in study.space]
        result = "" if trial.error else trial.result
        conditions = () if trial.error else trial_conditions(study, trial)
        writer.writerow([trial.number, result, *values, trial.error, *conditions])
    return table.getvalue()


def _describe_best(study: Study, trials: list[Trial]) -> str:
    """Return a text with the best trial so far."""
    best = best_trials(study, trials)
    return f"best {study.metric} {best[0].result:.4g} in trial {best[0].number}" if best else ""
