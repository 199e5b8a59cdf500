"""A study: training runs whose settings vary, chosen by what earlier ones came to."""

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
from bulletuav.errors import as_int, choose, shown, unknown
from bulletuav.files import replace_file
from bulletuav.interrupts import kept_from_children
from bulletuav.policies.run import MODULE_NAME, VERSION, RunConfig, read_settings, write_settings
from bulletuav.policies.space import Space, check_space, parse_space, with_values
from bulletuav.training.campaign import processes, train_in_process
from bulletuav.training.store import FolderError, Row, evaluation_conditions, locked

STUDY = "study.yaml"
"""File with the settings of a study, in its folder"""
TRIALS = "trials.csv"
"""File with the trials, in their order"""
RUNS = "trials"
"""Folder of the trials' runs"""
FALLING = (
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
"""Metrics of which less is better"""
MOST_TRIALS = 10_000
"""Most trials of a study"""


@dataclass(frozen=True)
class Study:
    """The settings that decide a study.

    Attributes:
        run: What does not vary. Its seed is that of the study, too.
        space: What varies.
        metric: What the last evaluation of each run is judged by, one of `METRICS`.
        trials: How many runs are trained.
        batch: Runs that are chosen at once, knowing nothing of each other.
    """

    run: RunConfig
    space: Space
    metric: str = "return"
    trials: int = 20
    batch: int = 4

    def __post_init__(self) -> None:
        """Check all settings.

        Raises:
            ValueError: One is impossible.
        """
        choose("metric", self.metric, METRICS)
        as_int("trials", self.trials, 1, MOST_TRIALS)
        as_int("batch", self.batch, 1, MOST_TRIALS)
        check_space(self.run, self.space)

    @classmethod
    def read(cls, path: Path, trust: bool = False) -> "Study":
        """Read the settings from a YAML file.

        Args:
            path: A file as `text` writes it, or one by hand: `version`, `run` (as `run.yaml`),
                `space` (see `parse_space`), and any other.
            trust: Whether modules that it names as `module:Name` may be imported.

        Raises:
            ValueError: The file is of another kind or version, or holds an impossible setting.
            FileNotFoundError: There is no such file.
        """
        values = read_settings(path, f"{STUDY} of a study", trust)
        known = [field.name for field in dataclasses.fields(cls)]
        try:
            # Files may be written by hand, so names are checked first
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
        """Whether more of the metric is better."""
        return self.metric not in FALLING

    def text(self) -> str:
        """Write the settings as YAML, which `read` takes back."""
        run = self.run.plain()
        del run["version"]
        space = {name: one.plain() for name, one in self.space.items()}
        rest = {"metric": self.metric, "trials": self.trials, "batch": self.batch}
        return write_settings({"version": VERSION, "run": run, "space": space, **rest})


class Trial(NamedTuple):
    """A run of a study.

    Attributes:
        number: Its number, from 0.
        values: What varies, by name.
        result: The metric of its last evaluation; NaN where it failed.
        error: Why it failed.
        folder: Where its run is.
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
    told: Callable[[str], None] = lambda text: None,
) -> list[Trial]:
    """Train the runs of a study, a batch at a time.

    What a batch tries follows from the seed and from the batches before. So neither timing nor the
    number of processes changes anything. A call with the same study goes on where one was
    interrupted, and one with more trials goes on with these.

    Args:
        study: The study.
        folder: The folder, made if it is not there.
        workers: Processes, of which each trains one run at a time.
        progress: Told the trials done so far.
        told: Told in words what was best so far.

    Returns:
        The trials in their order.

    Raises:
        FolderError: The folder holds another study, or another process works in it.
        ValueError: All trials failed.
        ImportError: The extra `tune` or `sb3` is missing.
    """
    # Imported here, as only from here on the extras are needed.
    from bulletuav.adapters.optuna import suggest
    from bulletuav.training.models import check_settings

    for name, one in study.space.items():
        check_settings(with_values(study.run, {name: one.first}))
    trials: list[Trial] = []
    with locked(folder), processes(workers) as pool:
        _begin(study, folder)
        progress(0)
        # A batch is chosen from the results of those before, whoever was faster
        while len(trials) < study.trials:
            tried = [(trial.values, trial.result) for trial in trials]
            count = min(study.batch, study.trials - len(trials))
            seed = (study.run.seed, len(trials))
            batch = suggest(study.space, tried, count, seed, study.maximise)
            futures = [
                _submit(pool, study, values, _place(folder, len(trials) + k))
                for k, values in enumerate(batch)
            ]
            # In the order of the trials, and written after each
            for values, future in zip(batch, futures, strict=True):
                number = len(trials)
                outcome = _outcome(future, study.metric)
                trials.append(Trial(number, values, *outcome, _place(folder, number)))
                replace_file(folder / TRIALS, _table(study, trials))
                told(_words(study, trials))
                progress(len(trials))
    if all(trial.error for trial in trials):
        raise ValueError(f"all trials failed, the first one because: {trials[0].error}")
    return trials


def best_trials(study: Study, trials: Sequence[Trial]) -> list[Trial]:
    """Sort the trials that did not fail, best first; of equals the earlier comes first."""
    done = [trial for trial in trials if not trial.error]
    return sorted(done, key=lambda trial: trial.result, reverse=study.maximise)


def trial_conditions(study: Study, trial: Trial) -> Conditions:
    """Return the conditions of the result of a trial that did not fail."""
    return evaluation_conditions(with_values(study.run, trial.values))


def _begin(study: Study, folder: Path) -> None:
    """Write the settings, or check that they are those of the folder."""
    path = folder / STUDY
    if path.exists():
        # Modules that the study itself names are the user's own.
        known = Study.read(path, MODULE_NAME.search(study.text()) is not None)
        if dataclasses.replace(known, trials=study.trials).text() != study.text():
            raise ValueError(
                f"{folder} holds another study: see its {STUDY}; choose another folder"
            )
    replace_file(path, study.text())


def _place(folder: Path, number: int) -> Path:
    """Return the folder of a trial's run."""
    return folder / RUNS / f"{number:03d}"


def _submit(pool: Executor, study: Study, values: Mapping[str, Any], place: Path) -> Future[Any]:
    """Begin a trial; one whose settings are impossible together has failed at once."""
    try:
        config = with_values(study.run, values)
    except ValueError as error:
        future: Future[Any] = Future()
        future.set_exception(error)
        return future
    with kept_from_children():
        return pool.submit(train_in_process, config, place)


def _outcome(future: Future[list[Row]], metric: str) -> tuple[float, str]:
    """Wait for a trial; gives its result, or NaN and why it failed."""
    # Other errors, such as a full disk, are none of the trial's settings, and end the study.
    try:
        result = float(future.result()[-1][metric])
    except FolderError:
        raise
    except ValueError as error:
        return math.nan, " ".join(str(error).split())
    return result, "" if math.isfinite(result) else f"its {metric} is {result}"


def _table(study: Study, trials: list[Trial]) -> str:
    """Write the trials as CSV with the conditions of their results; values are in JSON."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["trial", study.metric, *study.space, "error", *Conditions._fields])
    for trial in trials:
        values = [json.dumps(trial.values[name]) for name in study.space]
        result = "" if trial.error else trial.result
        conditions = () if trial.error else trial_conditions(study, trial)
        writer.writerow([trial.number, result, *values, trial.error, *conditions])
    return table.getvalue()


def _words(study: Study, trials: list[Trial]) -> str:
    """Say what was best so far."""
    best = best_trials(study, trials)
    return f"best {study.metric} {best[0].result:.4g} in trial {best[0].number}" if best else ""
