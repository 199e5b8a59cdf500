"""Folder of an evaluation, which an interrupted evaluation resumes from."""

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
"""File with the description of the run"""
EPISODES = "episodes.csv"
"""File with the metrics of each episode"""
COLUMNS = ("episode", "seed", *METRICS)
"""First columns of that file; custom metrics and infos of the task follow"""


class ResultsFolder:
    """Rows of finished episodes, and the folder where they are stored.

    Attributes:
        rows: The rows by the number of the episode.
    """

    def __init__(self, folder: Path | None, about: dict[str, Any]) -> None:
        """Open a folder and read its rows, including those of the run's pieces.

        Args:
            folder: Folder of the rows; None to keep them in memory only.
            about: Description of the run, for `run.json`.

        Raises:
            ValueError: If the folder holds another run, is damaged or cannot be written to.
        """
        self.rows: dict[int, Row] = {}
        self._folder = folder
        if folder is None:
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # A folder without a description of a run may hold any files.
            for one in (folder, *piece_folders(folder).values()):
                if (one / RUN).exists():
                    self._load(one, about)
            replace_file(folder / RUN, json.dumps(about, indent=2) + "\n")
            self.add([])
        except OSError as error:
            raise ValueError(f"{folder} cannot be written to: {error.strerror or error}") from None

    def _load(self, folder: Path, about: dict[str, Any]) -> None:
        """Read the rows of an earlier call, after a check that its run is the same."""
        with _damaged(folder / RUN):
            known = read_json(folder / RUN)
            # Raises an error if the entries to compare are missing.
            {**known, **known["options"]}
        check_same_run(known, about, folder)
        self.rows |= read_rows(folder)

    def add(self, rows: list[Row]) -> None:
        """Add the rows of a batch, in memory and in the file, sorted by episode.

        Raises:
            OSError: If the file cannot be written.
        """
        self.rows |= {int(row["episode"]): row for row in rows}
        if self._folder is None:
            return
        ordered = [self.rows[episode] for episode in sorted(self.rows)]
        # All rows share the first columns; infos that some rows lack come last.
        columns = list(dict.fromkeys([*COLUMNS, *(name for row in ordered for name in row)]))
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, restval="nan", lineterminator="\n")
        writer.writeheader()
        writer.writerows(ordered)
        replace_file(self._folder / EPISODES, text.getvalue())


def read_rows(folder: Path) -> dict[int, Row]:
    """Read the rows of a folder, by the number of the episode.

    Raises:
        ValueError: If the rows cannot be read.
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
    """Convert errors of a damaged file to a ValueError that names the file."""
    # Invalid UTF-8 and invalid JSON raise ValueErrors.
    try:
        yield
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise ValueError(
            f"{path.parent} holds a run that is damaged ({path.name}: {reason_of(error)}): "
            "delete it or choose another folder"
        ) from None


def check_same_run(known: dict[str, Any], about: dict[str, Any], folder: Path) -> None:
    """Raise ValueError unless both descriptions are of the same run, for any number of episodes."""
    known, about = (
        {**one["options"], **one, "options": 0, "episodes": 0, "call": 0} for one in (known, about)
    )
    for name in about:
        if known.get(name) != about[name]:
            raise ValueError(
                f"{folder} holds another run: its {name} is {shown(known.get(name))}, "
                f"not {shown(about[name])}; choose another folder"
            )
