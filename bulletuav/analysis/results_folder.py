"""The folder of an evaluation, from which an interrupted one goes on."""

import contextlib
import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bulletuav.analysis.episodes import Row
from bulletuav.analysis.metrics import METRICS
from bulletuav.analysis.pieces import piece_folders
from bulletuav.errors import reason_of, shown
from bulletuav.files import replace_file
from bulletuav.parsing import read_json

RUN = "run.json"
"""File that tells what was flown"""
EPISODES = "episodes.csv"
"""File of the metrics of each episode"""
COLUMNS = ("episode", "seed", *METRICS)
"""First columns of that file; metrics of users and infos of the task follow"""


class ResultsFolder:
    """Rows of finished episodes, and the folder where they are kept.

    Attributes:
        rows: The rows by the number of the episode.
    """

    def __init__(self, folder: Path | None, about: dict[str, Any]) -> None:
        """Open a folder and read what is there, also what pieces of the run have flown.

        Args:
            folder: Where to keep the rows; None for memory alone.
            about: What is flown, for `run.json`.

        Raises:
            ValueError: The folder holds another run, is damaged or cannot be written to.
        """
        self.rows: dict[int, Row] = {}
        self._folder = folder
        if folder is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # A folder without a run may hold anything.
            for one in (folder, *piece_folders(folder).values()):
                if (one / RUN).exists():
                    self._load(one, about)
            replace_file(folder / RUN, json.dumps(about, indent=2) + "\n")
            self.add([])
        except OSError as error:
            raise ValueError(
                f"{folder} cannot be a folder to write to: {error.strerror or error}"
            ) from None

    def _load(self, folder: Path, about: dict[str, Any]) -> None:
        """Read the rows of a run that was begun, if it is the same."""
        with _damaged(folder / RUN):
            known = read_json(folder / RUN)
            # What is compared next has to be there.
            {**known, **known["options"]}
        check_same_run(known, about, folder)
        self.rows |= read_rows(folder)

    def add(self, rows: list[Row]) -> None:
        """Keep the rows of a batch, on disk too, in the order of the episodes.

        Raises:
            OSError: The file cannot be written.
        """
        self.rows |= {int(row["episode"]): row for row in rows}
        if self._folder is None:
            return
        ordered = [self.rows[episode] for episode in sorted(self.rows)]
        # Each row begins with the same columns; infos that some lack come last.
        columns = list(dict.fromkeys([*COLUMNS, *(name for row in ordered for name in row)]))
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, restval="nan", lineterminator="\n")
        writer.writeheader()
        writer.writerows(ordered)
        replace_file(self._folder / EPISODES, text.getvalue())


def read_rows(folder: Path) -> dict[int, Row]:
    """Read the rows of a folder, by the number of the episode.

    Raises:
        ValueError: They cannot be read.
    """
    rows: dict[int, Row] = {}
    with (
        _damaged(folder / EPISODES),
        (folder / EPISODES).open(newline="", encoding="utf-8") as file,
    ):
        table = csv.DictReader(file)
        columns = tuple(table.fieldnames or ())
        if columns[: len(COLUMNS)] != COLUMNS:
            raise ValueError(f"its columns are {shown(table.fieldnames)}")
        for row in table:
            numbers: Row = {name: float(row[name]) for name in columns}
            whole = {name: int(row[name]) for name in ("episode", "seed")}
            rows[whole["episode"]] = numbers | whole
    return rows


@contextlib.contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Name the file that cannot be read as what it should be."""
    # Text that is no UTF-8 or no JSON raises ValueErrors.
    try:
        yield
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise ValueError(
            f"{path.parent} holds a run that is damaged ({path.name}: {reason_of(error)}): "
            "delete it or choose another folder"
        ) from None


def check_same_run(known: dict[str, Any], about: dict[str, Any], folder: Path) -> None:
    """Raise ValueError unless both tell of the same run, maybe of more or fewer episodes."""
    known, about = (
        {**one["options"], **one, "options": 0, "episodes": 0, "call": 0} for one in (known, about)
    )
    for name in about:
        if known.get(name) != about[name]:
            raise ValueError(
                f"{folder} holds another run: its {name} is {shown(known.get(name))}, "
                f"not {shown(about[name])}; choose another folder"
            )
