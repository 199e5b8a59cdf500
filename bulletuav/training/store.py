"""The folder of a training run: configuration, curve, policy, checkpoints, and how far it is.

Nothing of it is pickled: no file of it can run code when it is read.
"""

import contextlib
import csv
import io
import json
import math
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bulletuav.analysis.conditions import Conditions
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.errors import read_file, reason_of, shown
from bulletuav.files import replace_file, whole_file
from bulletuav.parsing import read_json
from bulletuav.policies.run import CHECKPOINTS, CONFIG, MODULE_NAME, POLICY, RunConfig
from bulletuav.tasks import find_task

EVALUATION_SEED = 1_000_000
"""Seed of the first episode of evaluations on the way: no seed of training or of tables"""
RECENT = 100
"""Number of training episodes over which progress is averaged"""
CURVE = "curve.csv"
"""File of the learning curve"""
UPDATES = "updates.csv"
"""File of what training told of itself, by updates"""
WALL = ("simulation", "update", "evaluation")
"""Columns of the curve with the parts of its wall time"""
STATE = "state.json"
"""File that tells how far the run is"""
TRAINING = "training.safetensors"
"""File of a checkpoint with what training needs beside the policy"""
REPLAY = "replay.safetensors"
"""File of a checkpoint with the replay buffer"""
PACKAGES = (
    "bulletuav",
    "stable_baselines3",
    "torch",
    "numpy",
    "numba",
    "pybullet",
)
"""Packages on whose versions the weights may depend"""
Row = dict[str, float]
"""A row of the learning curve"""


class FolderError(ValueError):
    """Error for a folder in which a run cannot be kept, whatever its settings."""


class Store:
    """What is kept of a run, each file written as a whole or not at all.

    Attributes:
        folder: Where the files are: `run.yaml`, `curve.csv`, `policy.safetensors`, `state.json`,
            `updates.csv`, and checkpoints.
        rows: The learning curve, a row for each evaluation, see below.
        updates: What training told of itself, about a thousand rows, until the last checkpoint.
        curriculum: State of the curriculum at the last checkpoint.

    Columns of the curve:
        - "steps" and, of them, "decisions" that a drone flew;
        - "stage" of the curriculum;
        - "seconds" of wall time since the row before, which are those of "simulation" (with the
          choice of actions), of the "update" of networks, and of "evaluation";
        - means of the episodes in training since then, of a drone: "train/return",
          "train/decisions", "train/success", "train/conflicts", "train/collision";
        - means of `bulletuav.analysis.metrics.METRICS` in the evaluation;
        - in the file also the conditions of the evaluation: "task", "difficulty", "dynamics",
          "episodes" and "seed".
    """

    def __init__(self, folder: Path, config: RunConfig) -> None:
        """Open a folder and read how far the run is.

        Args:
            folder: The folder, made if it is not there.
            config: The run.

        Raises:
            FolderError: The folder holds another run, is damaged or cannot be written to.
        """
        self.folder = folder
        self.rows: list[Row] = []
        self.updates: list[Row] = []
        self.curriculum: dict[str, Any] = {}
        self._config = config
        about = "# " + ", ".join(f"{name} {version(name)}" for name in PACKAGES)
        try:
            (folder / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
            if (folder / STATE).exists():
                self._load(about)
            else:
                replace_file(folder / CONFIG, f"{about}\n{config.text()}")
        except OSError as error:
            raise _not_writable(folder, error) from None

    def _load(self, about: str) -> None:
        """Read a run that was begun; warn of other versions than those that `about` tells."""
        self._require_same()
        if any((self.folder / CHECKPOINTS).glob("*.zip")):
            raise FolderError(
                f"{self.folder} holds checkpoints of an older version, "
                "which can run code when read: choose another folder"
            )
        try:
            state = read_json(self.folder / STATE)
            # Runs of older versions do not tell where the time went.
            self.rows = [dict.fromkeys(WALL, math.nan) | row for row in number_rows(state["rows"])]
            self.curriculum = state["curriculum"]
            if not isinstance(self.curriculum, dict):
                raise TypeError(f"its curriculum is {shown(self.curriculum)}")
            self.updates = _read_rows(self.folder / UPDATES, int(self.rows[-1]["steps"]))
            if not (self.last / POLICY).exists():
                raise FileNotFoundError(f"no {self.last / POLICY}")
        except (ValueError, LookupError, TypeError, OSError, csv.Error) as error:
            raise FolderError(
                f"{self.folder} holds a run that is damaged ({reason_of(error)}): "
                f"choose another folder"
            ) from None
        # The first line of the configuration tells the versions.
        begun = read_file(self.folder / CONFIG).splitlines()[0]
        if begun != about and not self.finished:
            warnings.warn(
                f"{self.folder} was begun with {begun[2:]}: weights may come out differently now",
                stacklevel=4,
            )

    def _require_same(self) -> None:
        """Raise ValueError unless the folder's configuration is that of the run."""
        # Modules that the run itself names are the user's own; a folder may not name others.
        names = MODULE_NAME.search(self._config.text()) is not None
        known = RunConfig.read(self.folder / CONFIG, trust=names).plain()
        for name, value in self._config.plain().items():
            if known[name] != value:
                raise FolderError(
                    f"{self.folder} holds another run: its {name} is {shown(known[name])}, "
                    f"not {shown(value)}; choose another folder"
                )

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return bool(self.rows) and self.rows[-1]["steps"] >= self._config.steps

    @property
    def next(self) -> Path:
        """Folder of the next checkpoint."""
        return self._checkpoint(len(self.rows))

    @property
    def last(self) -> Path:
        """Folder of the last checkpoint, of which there is one where there are rows."""
        return self._checkpoint(len(self.rows) - 1)

    def _checkpoint(self, number: int) -> Path:
        """Return the folder of a checkpoint."""
        return self.folder / CHECKPOINTS / f"{number:03d}"

    def add(
        self,
        row: Row,
        updates: list[Row],
        curriculum: dict[str, Any],
    ) -> None:
        """Keep a row of the curve, once its checkpoint is complete.

        Args:
            row: The row.
            updates: Rows of the updates since the one before.
            curriculum: State of the curriculum.

        Raises:
            OSError: A file cannot be written.
        """
        checkpoint = self.next
        rows = [*self.rows, row]
        with whole_file(self.folder / POLICY) as part:
            shutil.copyfile(checkpoint / POLICY, part)
        conditions = evaluation_conditions(self._config)._asdict()
        replace_file(self.folder / CURVE, _table([one | conditions for one in rows]))
        # One that is ahead of the state is cut to it when the run goes on.
        updates = [*self.updates, *updates]
        replace_file(self.folder / UPDATES, _table(updates))
        # How far the run is comes last: who is interrupted before it does the chapter again.
        replace_file(
            self.folder / STATE,
            json.dumps({"rows": rows, "curriculum": curriculum}),
        )
        self.rows, self.updates = rows, updates
        self.curriculum = curriculum
        # Of older checkpoints the policies alone are kept.
        for old in (self.folder / CHECKPOINTS).glob("*"):
            for name in (TRAINING, REPLAY) if old != checkpoint else ():
                (old / name).unlink(missing_ok=True)


def evaluation_conditions(config: RunConfig) -> Conditions:
    """Return the conditions of the evaluations during a training.

    Args:
        config: The settings of the run.
    """
    task = find_task(config.task)
    options = resolve_options(task, config.evaluated).options
    return Conditions(
        task=task.name,
        difficulty=options.difficulty,
        dynamics=options.dynamics_name,
        episodes=config.episodes,
        seed=EVALUATION_SEED,
    )


def training_conditions(config: RunConfig) -> str:
    """Write what the episodes of a training fly, by whose returns progress is shown.

    Args:
        config: The settings of the run; several stages have several difficulties or dynamics.
    """
    task = find_task(config.task)
    stages = [resolve_options(task, {**config.options, **stage}).options for stage in config.stages]
    difficulty = ", then ".join(dict.fromkeys(stage.difficulty for stage in stages))
    dynamics = ", then ".join(dict.fromkeys(stage.dynamics_name for stage in stages))
    return (
        f"{task.name}, difficulty {difficulty}, dynamics {dynamics}, the last {RECENT} training "
        f"episodes of seed {config.seed}, by the stochastic policy while it learns"
    )


def _table(rows: Sequence[Mapping[str, object]]) -> str:
    """Write rows as CSV; what one of them lacks is left empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = io.StringIO()
    writer = csv.DictWriter(table, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return table.getvalue()


def number_rows(rows: Any) -> list[Row]:
    """Check that a value of a file is rows of numbers, each with its "steps".

    Raises:
        TypeError: It is something else.
        KeyError: A row has no steps.
    """
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise TypeError(f"its rows are {shown(rows)}")
    for row in rows:
        for name, value in row.items():
            if not isinstance(value, int | float):
                raise TypeError(f"{name} of a row is {shown(value)}")
        if not math.isfinite(row["steps"]):
            raise TypeError(f"steps of a row is {row['steps']}")
    return rows


def _read_rows(path: Path, steps: int) -> list[Row]:
    """Read the rows of `_table` until a number of steps; older versions wrote none."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        rows = [
            {name: float(value) for name, value in row.items() if value}
            for row in csv.DictReader(file)
        ]
    return [row for row in rows if row["steps"] <= steps]


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep a folder to this process; it is made if it is not there.

    Args:
        folder: The folder.

    Raises:
        FolderError: Another process trains in the folder, or it cannot be written to.
    """
    # This package comes with PyTorch.
    from filelock import FileLock, Timeout

    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / "lock", timeout=0)
        lock.acquire()
    except Timeout:
        raise FolderError(
            f"{folder} is being trained in by another process: wait, or choose another folder"
        ) from None
    except OSError as error:
        raise _not_writable(folder, error) from None
    with lock:
        yield


@contextlib.contextmanager
def opened(folder: Path, config: RunConfig) -> Iterator[Store]:
    """Open the store of a run, while nobody else trains in its folder.

    Args:
        folder: The folder, made if it is not there.
        config: The run.

    Yields:
        The store.

    Raises:
        FolderError: See `locked` and `Store`.
    """
    with locked(folder):
        yield Store(folder, config)


def _not_writable(folder: Path, error: OSError) -> FolderError:
    """Make the error for a folder that cannot be written to."""
    return FolderError(f"{folder} cannot be a folder to write to: {error.strerror or error}")
