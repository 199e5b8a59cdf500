"""Reproductions of published tables: rows, their verdicts, data, and results."""

import json
import math
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from matplotlib.figure import Figure

from bulletuav.files import replace_file
from bulletuav.report.figures import save_figure
from bulletuav.version import __version__

MIN_DIGITS, MAX_DIGITS = 4, 15
"""Minimum and maximum number of significant digits of a number"""
MAX_PRINTED = 8
"""Maximum number of significant digits that others print; longer numbers are computed"""
Verdict = Literal["within", "better", "explained", "outside", "not comparable", "unpublished"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True)
class Row:
    """One published number, and the one of this package.

    Attributes:
        name: Name of the number, such as "position after 0.5 s".
        ours: Number that is computed here.
        published: Published number; None if there is none.
        unit: Unit, such as "m"; empty for numbers without unit.
        low: Lower bound of the 95 % confidence interval of `ours`; None for exact numbers.
        high: Upper bound.
        tolerance: Difference that counts as none: digits of the published number, or the error of
            reading a curve.
        goal: "equal", or the direction in which numbers are better: "lower" or "higher".
        why: Explanation of a number that is neither within nor better.
        is_comparable: False if the published number is of another quantity, or of a method that
            knows more or less; it then only stands next to ours.
        is_exact: True if repeated computations give the same number, so that the interval does not
            count in the comparison.
    """

    name: str
    ours: float
    published: float | None = None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    tolerance: float = 0.0
    goal: Literal["equal", "lower", "higher"] = "equal"
    why: str = ""
    is_comparable: bool = True
    is_exact: bool = False

    @property
    def verdict(self) -> Verdict:
        """Compare with the published number.

        Returns:
            "within" if the published number is in the interval, widened by the tolerance; "better"
            if ours is better than that; otherwise "explained" with an explanation, or "outside".
            "not comparable" and "unpublished" without a number to compare with.
        """
        if self.published is None:
            return "unpublished"
        if not self.is_comparable:
            return "not comparable"
        low = self.ours if self.low is None or self.is_exact else self.low
        high = self.ours if self.high is None or self.is_exact else self.high
        if low - self.tolerance <= self.published <= high + self.tolerance:
            return "within"
        if self.goal == "lower" and self.ours < self.published:
            return "better"
        if self.goal == "higher" and self.ours > self.published:
            return "better"
        return "explained" if self.why else "outside"


@dataclass(frozen=True)
class Data:
    """Data of others that the user fetches.

    Attributes:
        repository: Address of the git repository.
        commit: Commit that has the data.
        licence: Its licence, as SPDX identifier, or "none".
        contains: A file of the repository by which the folder is recognised.
    """

    repository: str
    commit: str
    licence: str
    contains: str

    @property
    def commands(self) -> str:
        """Commands that fetch the data."""
        name = self.repository.rstrip("/").rpartition("/")[2]
        return f"git clone {self.repository} && git -C {name} checkout {self.commit}"

    def find(self, folder: Path | None, table: str) -> Path:
        """Check the folder of the data.

        Args:
            folder: Folder that the user gives.
            table: Name of the table, for the message.

        Returns:
            The folder.

        Raises:
            ValueError: If there is no folder, or it is at another commit, with the commands that
                fetch the data.
            FileNotFoundError: If the folder lacks the data.
        """
        if folder is None:
            raise ValueError(
                f"{table} needs data: give its folder with --data; fetch it with: {self.commands}"
            )
        if not (folder / self.contains).is_file():
            raise FileNotFoundError(
                f"{folder} has no {self.contains}: fetch the data with: {self.commands}"
            )
        head = _read_head(folder)
        if head is not None and not head.startswith(self.commit):
            raise ValueError(
                f"{folder} is at commit {head[:12]}, and {table} needs another one: "
                f"git -C {folder} checkout {self.commit}"
            )
        return folder


def _read_head(folder: Path) -> str | None:
    """Return the commit of a clone; None for folders without git, or without the command."""
    if not (folder / ".git").exists():
        return None
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


@dataclass(frozen=True)
class Settings:
    """How a table is computed.

    Attributes:
        size: Fraction of the full number of episodes, windows or decisions, above 0 and at most 1.
        data: Folder of the data of others; None if the table needs none.
        workers: Number of processes.
        progress: Callback for the finished fraction.
    """

    size: float = 1.0
    data: Path | None = None
    workers: int = 1
    progress: Callable[[float], None] = lambda fraction: None

    def count(self, full: int, least: int = 1) -> int:
        """Return the number of episodes, or the like, at this size.

        Args:
            full: Number at full size.
            least: Minimum number.
        """
        return max(least, math.ceil(full * self.size))


@dataclass(frozen=True)
class TableOutcome:
    """Rows, picture and notes of a computed table.

    Attributes:
        rows: Numbers next to the published ones.
        figure: Picture of the comparison, from `bulletuav.report.figures.blank_figure`.
        notes: Sentences about protocol, differences, and what misses and why.
        extra: Further values for the JSON file, such as fitted constants.
    """

    rows: Sequence[Row]
    figure: Figure
    notes: Sequence[str] = ()
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reproduction:
    """A published table that can be computed again.

    Attributes:
        title: Title of one line.
        publication: Authors, title, where and when.
        address: Web address of the publication.
        about: One paragraph: what is compared, and how.
        minutes: Duration at full size with two cores.
        compute: Function that computes the table.
        data: Data of others that it needs; None for none.
        is_scalable: Whether it can be computed at a smaller size.
        is_parallel: Whether it can use several processes.
    """

    title: str
    publication: str
    address: str
    about: str
    minutes: float
    compute: Callable[[Settings], TableOutcome]
    data: Data | None = None
    is_scalable: bool = True
    is_parallel: bool = False

    def reproduce(self, name: str, settings: Settings) -> TableOutcome:
        """Check the settings, and compute the table.

        Args:
            name: Name of the table, for messages.
            settings: How it is computed.

        Raises:
            ValueError: If a setting is out of range or has no effect on this table.
            FileNotFoundError: If the folder of the data lacks the data.
        """
        if not 0.0 < settings.size <= 1.0:
            raise ValueError(
                f"size {settings.size:g} of {name}: a fraction above 0 and up to 1 is needed"
            )
        if settings.size < 1.0 and not self.is_scalable:
            raise ValueError(f"size {settings.size:g}: {name} has no smaller size, leave it out")
        if settings.workers < 1:
            raise ValueError(f"{settings.workers} workers for {name}: at least 1 is needed")
        if settings.workers > 1 and not self.is_parallel:
            raise ValueError(f"{settings.workers} workers: {name} runs in one process")
        if self.data is not None:
            self.data.find(settings.data, name)
        elif settings.data is not None:
            raise ValueError(f"data {settings.data}: {name} needs no data, leave it out")
        return self.compute(settings)


def record_outcome(
    name: str, table: Reproduction, outcome: TableOutcome, size: float
) -> dict[str, Any]:
    """Return a computed table as plain values, for a JSON file."""
    return {
        "table": name,
        "title": table.title,
        "publication": table.publication,
        "address": table.address,
        "about": table.about,
        "data": None if table.data is None else asdict(table.data),
        "minutes": table.minutes,
        "bulletuav": __version__,
        "size": size,
        "rows": [{**asdict(row), "verdict": row.verdict} for row in outcome.rows],
        "notes": list(outcome.notes),
        "extra": outcome.extra,
    }


def format_cells(row: Row) -> list[str]:
    """Return the cells of a row: name, unit, published, ours, interval, verdict.

    Published numbers are printed in full, unless they are computed to more than `MAX_PRINTED`
    digits. Ours have as many digits, or more if it takes more to see a difference.
    """
    digits = MIN_DIGITS
    if row.published is not None:
        printed = len(
            f"{row.published!r}".partition("e")[0].strip("-").replace(".", "").lstrip("0")
        )
        digits = max(digits, printed if printed <= MAX_PRINTED else 0)
    while row.verdict in ("better", "explained", "outside") and digits < MAX_DIGITS:
        if f"{row.published:.{digits}g}" != f"{row.ours:.{digits}g}":
            break
        digits += 1
    numbers = [
        # The sum turns a negative zero into zero
        "" if number is None else f"{number + 0.0:.{digits}g}"
        for number in (row.published, row.ours, row.low, row.high)
    ]
    interval = "" if row.low is None else f"{numbers[2]} to {numbers[3]}"
    return [row.name, row.unit, *numbers[:2], interval, row.verdict]


def list_reasons(rows: Sequence[Row]) -> list[str]:
    """Return the explanations of rows, each once, after the names of its rows."""
    names: dict[str, list[str]] = {}
    for row in rows:
        if row.verdict == "explained":
            names.setdefault(row.why, []).append(row.name)
    return [f"{', '.join(found)}: {why}" for why, found in names.items()]


HEADINGS = ("number", "unit", "published", "bulletuav", "95 % interval", "verdict")
"""Headings of the cells of a row"""


def write_outcome(record: dict[str, Any], figure: Figure, out: Path) -> list[Path]:
    """Write a computed table: NAME.json and the picture NAME.png.

    Args:
        record: Values of `record_outcome`.
        figure: Picture.
        out: Folder.

    Returns:
        The files.
    """
    name = record["table"]
    files = [out / f"{name}.json", out / f"{name}.png"]
    replace_file(files[0], json.dumps(record, indent=1, default=_plain, allow_nan=False) + "\n")
    save_figure(figure, files[1])
    return files


def _plain(value: Any) -> Any:
    """Convert values of NumPy for JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{value!r} is no plain value")


def rows_of_record(record: dict[str, Any]) -> list[Row]:
    """Return the rows of a record that `write_outcome` wrote."""
    return [Row(**{k: v for k, v in row.items() if k != "verdict"}) for row in record["rows"]]
