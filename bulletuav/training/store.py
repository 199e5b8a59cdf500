"""The folder of a training run: configuration, curve, policy, checkpoints and progress.

No file is pickled, so that reading a folder cannot run code.
"""

import contextlib
import csv
import io
import json
import math
import shutil
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

from bulletuav.analysis.conditions import Conditions
from bulletuav.engine.calls import HAS_BULLET
from bulletuav.envs.options import EnvOptions
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.errors import read_file, reason_of, shown
from bulletuav.files import replace_file, whole_file
from bulletuav.parsing import read_json
from bulletuav.policies.run import (
    CHECKPOINTS,
    COMPILED,
    CONFIG,
    CURVE,
    MODULE_NAME,
    POLICY,
    RunConfig,
    whole_number,
)
from bulletuav.tasks import find_task

EVALUATION_SEED = 1_000_000
"""Seed of the first episode of evaluations during training, apart from other seeds"""
RECENT = 100
"""Number of recent training episodes over which progress is averaged"""
UPDATES = "updates.csv"
"""File of training statistics by update"""
WALL_COLUMNS = ("simulation", "update", "evaluation")
"""Columns of the curve with the wall time by activity"""
STATE = "state.json"
"""File with the progress of the run"""
TRAINING = "training.safetensors"
"""File of a checkpoint with the training state besides the policy"""
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
"""Packages whose versions may affect the weights; PyBullet is optional"""
LEARNING = ("stable_baselines3", "torch")
"""Packages that the algorithms `COMPILED` do not use"""
Row = dict[str, float]
"""A row of the learning curve"""


class FolderError(ValueError):
    """Error of a folder that cannot store the run, independent of the settings of the run."""


class Store:
    """Storage of a run in a folder, with atomically written files.

    Attributes:
        folder: Folder of the files `run.yaml`, `curve.csv`, `policy.safetensors`, `state.json`,
            `updates.csv`, and checkpoints.
        rows: The learning curve, one row for each evaluation, see below.
        updates: Training statistics up to the last checkpoint, about a thousand rows.
        curriculum: State of the curriculum at the last checkpoint.

    Columns of the curve:
        - "steps" of all slots, and "decisions" of active drones among them;
        - "stage" of the curriculum;
        - "seconds" of wall time since the previous row, the sum of "simulation" (including the
          choice of actions), "update" of networks, and "evaluation";
        - means over the training episodes of drones since the previous row: "train/return",
          "train/decisions", "train/success", "train/conflicts", "train/collision";
        - means of `bulletuav.analysis.metrics.METRICS` in the evaluation;
        - in the file also the conditions of the evaluation: "task", "difficulty", "dynamics",
          "episodes" and "seed".
    """

    def __init__(self, folder: Path, config: RunConfig) -> None:
        """Open a folder, and read the progress of the run.

        Args:
            folder: The folder, created if missing.
            config: Settings of the run.

        Raises:
            FolderError: If the folder has another run, is damaged or not writable.
        """
        self.folder = folder
        self.rows: list[Row] = []
        self.updates: list[Row] = []
        self.curriculum: dict[str, Any] = {}
        self._config = config
        absent = set() if HAS_BULLET else {"pybullet"}
        absent |= set(LEARNING) if config.algo in COMPILED else set()
        packages = [name for name in PACKAGES if name not in absent]
        about = "# " + ", ".join(f"{name} {version(name)}" for name in packages)
        try:
            (folder / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
            if (folder / STATE).exists():
                self._load(about)
            else:
                replace_file(folder / CONFIG, f"{about}\n{config.text()}")
        except OSError as error:
            raise _not_writable(folder, error) from None

    def _load(self, about: str) -> None:
        """Read an existing run, and warn if its versions of packages differ from `about`."""
        self._require_same()
        if any((self.folder / CHECKPOINTS).glob("*.zip")):
            raise FolderError(
                f"{self.folder} holds checkpoints of an older version, "
                "which can run code when read: choose another folder"
            )
        try:
            state = read_json(self.folder / STATE)
            # Runs of older versions have no wall time by activity
            self.rows = [
                dict.fromkeys(WALL_COLUMNS, math.nan) | row for row in number_rows(state["rows"])
            ]
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
        # The first line of the configuration lists the versions
        begun = read_file(self.folder / CONFIG).splitlines()[0]
        if begun != about and not self.finished:
            warnings.warn(
                f"{self.folder} was begun with {begun[2:]}: weights may differ now",
                stacklevel=4,
            )

    def _require_same(self) -> None:
        """Raise FolderError unless the folder has the configuration of this run."""
        # Trust only modules that the settings of the run itself name
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
        """True if all steps are done."""
        return bool(self.rows) and self.rows[-1]["steps"] >= self._config.steps

    @property
    def next(self) -> Path:
        """Folder of the next checkpoint."""
        return self._checkpoint(len(self.rows))

    @property
    def last(self) -> Path:
        """Folder of the last checkpoint, which exists if there are rows."""
        return self._checkpoint(len(self.rows) - 1)

    def _checkpoint(self, number: int) -> Path:
        return self.folder / CHECKPOINTS / f"{number:03d}"

    def add(self, row: Row, updates: list[Row], curriculum: dict[str, Any]) -> None:
        """Store a row of the curve, once its checkpoint is complete.

        Args:
            row: The row.
            updates: Statistics of the updates since the previous row.
            curriculum: State of the curriculum.

        Raises:
            OSError: If a file cannot be written.
        """
        checkpoint = self.next
        rows = [*self.rows, row]
        with whole_file(self.folder / POLICY) as part:
            shutil.copyfile(checkpoint / POLICY, part)
        conditions = evaluation_conditions(self._config)._asdict()
        replace_file(self.folder / CURVE, _table([one | conditions for one in rows]))
        # Rows beyond the state are dropped when the run is resumed
        updates = [*self.updates, *updates]
        replace_file(self.folder / UPDATES, _table(updates))
        # The state is written last: an interrupt before it repeats the segment
        replace_file(
            self.folder / STATE,
            json.dumps({"rows": rows, "curriculum": curriculum}),
        )
        self.rows, self.updates = rows, updates
        self.curriculum = curriculum
        # Older checkpoints keep only their policies
        for old in (self.folder / CHECKPOINTS).glob("*"):
            for name in (TRAINING, REPLAY) if old != checkpoint else ():
                (old / name).unlink(missing_ok=True)


def evaluation_conditions(config: RunConfig) -> Conditions:
    """Return the conditions of the evaluations during a training.

    Args:
        config: Settings of the run.
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
    """Return a text with the conditions of the training episodes, whose returns are reported.

    Args:
        config: Settings of the run, whose stages may have several difficulties or dynamics.
    """
    task, stages = find_task(config.task), _stage_options(config)
    difficulty = ", then ".join(dict.fromkeys(stage.difficulty for stage in stages))
    dynamics = ", then ".join(dict.fromkeys(stage.dynamics_name for stage in stages))
    return (
        f"{task.name}, difficulty {difficulty}, dynamics {dynamics}, the last {RECENT} training "
        f"episodes of seed {config.seed}, by the stochastic policy while it learns"
    )


def _stage_options(config: RunConfig) -> list[EnvOptions]:
    """Return the options of the environment in each stage of a run."""
    task = find_task(config.task)
    return [resolve_options(task, {**config.options, **stage}).options for stage in config.stages]


def planned_steps(config: RunConfig) -> int:
    """Return the number of steps of a run: the steps of its settings, rounded up to whole rollouts.

    Args:
        config: Settings of the run. If rollouts end with episodes, their length is not known, and
            its steps are returned.
    """
    settings = config.settings
    length = whole_number(settings.get("n_steps", settings.get("train_freq")))
    if isinstance(length, list | tuple):  # such as [4, "step"]
        length = length[0] if list(length[1:]) == ["step"] else None
    # Invalid lengths are reported by the training
    if not isinstance(length, int) or length < 1:
        return config.steps
    rollout = length * config.worlds * max(stage.num_drones for stage in _stage_options(config))
    return -(-config.steps // rollout) * rollout


def _table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV; missing values are empty."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    table = io.StringIO()
    writer = csv.DictWriter(table, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return table.getvalue()


def number_rows(rows: Any) -> list[Row]:
    """Check that a value is a list of rows of numbers, each with finite "steps".

    Raises:
        TypeError: If the value has another form.
        KeyError: If a row has no "steps".
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
    """Read the rows of a CSV file up to a number of steps; older versions have no file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        rows = [
            {name: float(value) for name, value in row.items() if value}
            for row in csv.DictReader(file)
        ]
    return [row for row in rows if row["steps"] <= steps]


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder for this process; create it if missing.

    Args:
        folder: The folder.

    Raises:
        FolderError: If another process trains in the folder, or it is not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = (folder / "lock").open("a")
    except OSError as error:
        raise _not_writable(folder, error) from None
    with file:
        try:
            _lock_file(file)
        except OSError:
            raise FolderError(
                f"{folder} is in use by another process: wait, or choose another folder"
            ) from None
        yield


def _lock_file(file: IO[str]) -> None:
    """Lock a file until it is closed; raise OSError if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextlib.contextmanager
def open_store(folder: Path, config: RunConfig) -> Iterator[Store]:
    """Open the store of a run, and lock its folder.

    Args:
        folder: The folder, created if missing.
        config: Settings of the run.

    Yields:
        The store.

    Raises:
        FolderError: See `lock_folder` and `Store`.
    """
    with lock_folder(folder):
        yield Store(folder, config)


def _not_writable(folder: Path, error: OSError) -> FolderError:
    """Return the error for a folder that is not writable."""
    return FolderError(f"{folder} cannot be a folder to write to: {error.strerror or error}")
