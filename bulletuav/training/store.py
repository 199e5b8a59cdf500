"""The folder of a training run: `run.yaml`, `curve.csv`, `policy.safetensors`, checkpoints, and where it stands.

Nothing of it is pickled: no file of it can run code when it is read.
"""

import contextlib
import csv
import io
import json
import shutil
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from bulletuav.files import replace_file, whole_file
from bulletuav.policies.run import CHECKPOINTS, CONFIG, POLICY, RunConfig

CURVE, STATE = "curve.csv", "state.json"
TRAINING, REPLAY = "training.safetensors", "replay.safetensors"
PACKAGES = ("bulletuav", "stable_baselines3", "torch", "numpy", "numba", "pybullet")
Row = dict[str, float]


class Store:
    """What is kept of a run, each file written as a whole or not at all.

    rows        the learning curve, a row for each evaluation: `steps` and, of them, `decisions` that a drone flew; `stage`
                of the curriculum; `seconds` of wall time since the row before, without evaluations; means of the episodes in
                training since then, of a drone: "train/return", "train/decisions", "train/success", "train/conflicts",
                "train/collision"; and the means of `bulletuav.analysis.metrics.METRICS` in the evaluation
    curriculum  its state at the last checkpoint
    """

    def __init__(self, folder: Path, config: RunConfig):
        """Raises ValueError where the folder holds another run, is damaged or cannot be written to."""
        self.folder, self._config = folder, config
        self.rows: list[Row] = []
        self.curriculum: dict[str, Any] = {}
        about = "# " + ", ".join(f"{name} {version(name)}" for name in PACKAGES)
        try:
            (folder / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
            if (folder / STATE).exists():
                self._load(about)
            else:
                replace_file(folder / CONFIG, f"{about}\n{config.text()}")
        except OSError as error:
            raise ValueError(
                f"{folder} cannot be a folder to write to: {error.strerror or error}"
            ) from None

    def _load(self, about: str) -> None:
        known, own = RunConfig.read(self.folder / CONFIG).plain(), self._config.plain()
        for name, value in own.items():
            if known[name] != value:
                raise ValueError(
                    f"{self.folder} holds another run: its {name} is {known[name]!r}, not {value!r}; choose another folder"
                )
        if any((self.folder / CHECKPOINTS).glob("*.zip")):
            raise ValueError(
                f"{self.folder} holds checkpoints of an older version, which can run code when read: choose another folder"
            )
        try:
            state = json.loads((self.folder / STATE).read_text())
            self.rows, self.curriculum = state["rows"], state["curriculum"]
            if not (self.last / POLICY).exists():
                raise FileNotFoundError(f"no {self.last / POLICY}")
        except (json.JSONDecodeError, KeyError, TypeError, FileNotFoundError) as error:
            raise ValueError(
                f"{self.folder} holds a run that is damaged ({error!r}): choose another folder"
            ) from None
        begun = (self.folder / CONFIG).read_text().splitlines()[0]
        if begun != about and not self.finished:
            warnings.warn(
                f"{self.folder} was begun with {begun[2:]}: weights may come out differently now",
                stacklevel=4,
            )

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return bool(self.rows) and self.rows[-1]["steps"] >= self._config.steps

    @property
    def next(self) -> Path:
        """The folder of the next checkpoint."""
        return self._checkpoint(len(self.rows))

    @property
    def last(self) -> Path:
        """The folder of the last checkpoint, of which there is one where there are rows."""
        return self._checkpoint(len(self.rows) - 1)

    def _checkpoint(self, number: int) -> Path:
        return self.folder / CHECKPOINTS / f"{number:03d}"

    def add(self, row: Row, curriculum: dict[str, Any]) -> None:
        """The checkpoint is complete, and with it a row of the curve.

        What tells where the run stands comes last: who is interrupted before it does the chapter again.
        """
        checkpoint, rows = self.next, [*self.rows, row]
        with whole_file(self.folder / POLICY) as part:
            shutil.copyfile(checkpoint / POLICY, part)
        table = io.StringIO()
        writer = csv.DictWriter(table, row.keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        replace_file(self.folder / CURVE, table.getvalue())
        replace_file(self.folder / STATE, json.dumps({"rows": rows, "curriculum": curriculum}))
        self.rows, self.curriculum = rows, curriculum
        for old in (self.folder / CHECKPOINTS).glob("*"):
            for name in (TRAINING, REPLAY) if old != checkpoint else ():
                (old / name).unlink(missing_ok=True)


@contextlib.contextmanager
def opened(folder: Path, config: RunConfig) -> Iterator[Store]:
    """The store of a run that nobody else trains meanwhile. Raises ValueError where somebody does, else as `Store`."""
    from filelock import FileLock, Timeout  # comes with PyTorch

    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / "lock", timeout=0)
        lock.acquire()
    except Timeout:
        raise ValueError(
            f"{folder} is being trained in by another process: wait, or choose another folder"
        ) from None
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be a folder to write to: {error.strerror or error}"
        ) from None
    with lock:
        yield Store(folder, config)
