"""Flight logs: CSV files with named columns, read into arrays in SI units.

Required columns:

- `t`, s;
- `x`, `y`, `z`: position, world ENU, z above the ground, m;
- `qx`, `qy`, `qz`, `qw`: attitude, body FLU to world; or `roll`, `pitch`, `yaw`, rad;
- `w1` ... (rad/s) or `rpm1` ... (1/min) or `pwm1` ...: commands of the rotors, in the airframe's
  order.

Optional columns:

- `vx`, `vy`, `vz`: velocity, world, m/s;
- `p`, `q`, `r`: rates from the gyroscope, body, rad/s;
- `ax`, `ay`, `az`: specific force from the accelerometer, body, m/s^2; only its unit is checked;
- `vbat`, `current`: the battery's voltage and current, V and A;
- `other_x`, `other_y`, `other_z`: position of a drone above the drone of the log, world, m.
"""

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bulletuav.errors import require_file, shown, suggest_names
from bulletuav.parsing import plain_digits
from bulletuav.vehicle.airframe import MAX_ROTORS, STANDARD_GRAVITY
from bulletuav.vehicle.rotors import RPM

POSITION = ("x", "y", "z")
QUATERNION = ("qx", "qy", "qz", "qw")
EULER = ("roll", "pitch", "yaw")
VELOCITY = ("vx", "vy", "vz")
RATES = ("p", "q", "r")
FORCE = ("ax", "ay", "az")
OTHER = ("other_x", "other_y", "other_z")
GROUPS = (VELOCITY, RATES, FORCE, ("vbat",), ("current",), OTHER)
"""Optional columns, in groups that must be complete"""
COMMANDS = ("w", "rpm", "pwm")
"""Kinds of commands; column names append the number of the rotor"""
NAMES = (
    "t",
    *POSITION,
    *QUATERNION,
    *EULER,
    *(name for group in GROUPS for name in group),
    *(f"{kind}{rotor}" for kind in COMMANDS for rotor in range(1, MAX_ROTORS + 1)),
)
"""Names of all columns that are read"""
FACTORS = {
    "deg": math.pi / 180,
    "g": STANDARD_GRAVITY,
    "rpm": RPM,
    "mm": 1e-3,
    "cm": 1e-2,
    "ms": 1e-3,
    "us": 1e-6,
}
"""Units that can be named instead of a factor"""
MAX_HINT_LENGTH = 600
"""Maximum length of the list of columns that a message suggests, characters"""
SOURCE_PATTERN = re.compile(
    r"(?P<column>[^*]+?)(\*(?P<factor>[^*+]+?))?(?P<offset>[+-]\d[\d.e-]*)?"
)


@dataclass(frozen=True)
class ColumnSource:
    """Column of a file and its conversion: factor * column + offset.

    Attributes:
        column: Name in the file's header.
        factor: What it is multiplied by.
        offset: What is added then.
    """

    column: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Log:
    """One logged flight.

    Attributes:
        path: The file.
        columns: Values (n,) by the names of `NAMES`, SI units, finite.
        filled: Number of missing values that were interpolated, by column.
        used: Columns of the file from which each column was read.
        unused: Columns and topics of the file that are not used.
    """

    path: Path
    columns: Mapping[str, np.ndarray]
    filled: Mapping[str, int]
    used: Mapping[str, str] = field(default_factory=dict)
    unused: tuple[str, ...] = ()

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def stack(self, names: Iterable[str]) -> np.ndarray:
        """Stack columns side by side, (n, len(names))."""
        return np.stack([self.columns[name] for name in names], axis=1)

    @property
    def time(self) -> np.ndarray:
        """Times, (n,), s."""
        return self.columns["t"]

    @property
    def kind(self) -> str:
        """Kind of the commands, one of `COMMANDS`."""
        return next(kind for kind in COMMANDS if f"{kind}1" in self)


def parse_map(pairs: Iterable[str]) -> dict[str, ColumnSource]:
    """Parse column mappings such as "z=altitude*mm-0.03".

    Args:
        pairs: Texts NAME=COLUMN, optionally followed by *FACTOR (a number or one of `FACTORS`, with
            a minus sign for a reversed axis) and by +OFFSET or -OFFSET.

    Returns:
        The sources by name.

    Raises:
        ValueError: If a name is unknown or repeated, or a text has another form.
    """
    sources: dict[str, ColumnSource] = {}
    for pair in pairs:
        name, equals, text = (part.strip() for part in pair.partition("="))
        if not equals or not text:
            raise ValueError(f"--map {pair}: NAME=COLUMN[*FACTOR][+OFFSET] is needed")
        if name not in NAMES:
            raise ValueError(
                f"--map {pair}: no column is called {name!r}; {suggest_names(name, NAMES)}"
            )
        if name in sources:
            raise ValueError(f"--map {pair}: {name} is given twice")
        sources[name] = _parse_source(pair, text)
    return sources


def _parse_source(pair: str, text: str) -> ColumnSource:
    """Parse the text after the equals sign."""
    found = SOURCE_PATTERN.fullmatch(text)
    if found is None:
        raise ValueError(f"--map {pair}: NAME=COLUMN[*FACTOR][+OFFSET] is needed")
    factor = (found["factor"] or "1").strip()
    sign = -1.0 if factor.startswith("-") else 1.0
    size = factor.removeprefix("-")
    try:
        number = FACTORS[size] if size in FACTORS else float(size)
        offset = float(found["offset"] or 0.0)
    except ValueError:
        raise ValueError(
            f"--map {pair}: the factor is {factor!r}: a number, or one of {', '.join(FACTORS)}, "
            f"is needed"
        ) from None
    return ColumnSource(found["column"].strip(), sign * number, offset)


def read_log(path: str | Path, sources: Mapping[str, ColumnSource], num_rotors: int) -> Log:
    """Read a log from a CSV file.

    Args:
        path: A CSV file whose first line names the columns.
        sources: Sources of the columns that have other names or units in the file.
        num_rotors: Number of rotors R of the airframe, and so of commands.

    Returns:
        The log. Missing values are NaN until `checks.check_log` interpolates them.

    Raises:
        FileNotFoundError: If the file does not exist.
        ValueError: If columns are missing, or the file cannot be parsed; the message names them.
    """
    found = require_file("log", path, "pass the path of a CSV file")
    try:
        with found.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            _check_header(found, header)
            wanted = select_columns(found, header, sources, num_rotors)
            places = {source.column: header.index(source.column) for source in wanted.values()}
            table = parse_rows(found, reader, len(header), places)
    except UnicodeDecodeError:
        raise ValueError(
            f"{found} is neither text in UTF-8 nor a known log (its first bytes are of none): copy "
            f"it again, or export the log as CSV"
        ) from None
    except csv.Error as error:
        raise ValueError(
            f"{found} is not a CSV file: {error}; is a quotation mark missing?"
        ) from None
    columns = {
        name: source.factor * table[source.column] + source.offset
        for name, source in wanted.items()
    }
    used = {name: source.column for name, source in wanted.items()}
    return Log(found, columns, {}, used, tuple(name for name in header if name not in places))


def parse_rows(
    path: Path, reader: Iterable[list[str]], width: int, places: Mapping[str, int]
) -> dict[str, np.ndarray]:
    """Read columns of a CSV file.

    Args:
        path: The file, for messages.
        reader: Iterator over the cells of the rows below the header.
        width: Number of cells of a row; further cells must be empty.
        places: Index of each column in a row, by name.

    Returns:
        Numbers (n,) by name, NaN for empty cells.

    Raises:
        ValueError: If a row has fewer or more cells, a cell is not a number, or there are no rows.
    """
    rows = []
    for number, row in enumerate(reader, start=2):
        if not any(map(str.strip, row)) or row[0].startswith("#"):
            continue
        if len(row) < width or any(map(str.strip, row[width:])):
            raise ValueError(
                f"{path}: rows have other numbers of columns: row {number} has {len(row)}, the "
                f"header has {width}"
            )
        for name, place in places.items():
            try:
                rows.append(float(plain_digits(row[place]) if row[place].strip() else "nan"))
            except ValueError:
                raise ValueError(
                    f"{path}: {name} is {shown(row[place])} in row {number}: a number is needed, "
                    f"such as 0.5, or nothing where it is missing"
                ) from None
    if not rows:
        raise ValueError(f"{path} has no rows below its header: export the log again")
    table = np.array(rows).reshape(-1, len(places))
    return {name: table[:, k] for k, name in enumerate(places)}


def _check_header(path: Path, header: list[str]) -> None:
    """Raise ValueError if the first line does not name the columns."""
    if not header:
        raise ValueError(f"{path} is empty")
    numbers = [name for name in header if re.fullmatch(r"[-+]?\d[\d.eE+-]*", name)]
    if numbers:
        raise ValueError(
            f"{path} has no header: its first line begins with {header[0]}; name the columns "
            f"there, such as t,x,y,z,qx,qy,qz,qw,w1,w2,w3,w4"
        )
    if len(header) == 1 and (other := re.search("[;\t]", header[0])):
        raise ValueError(
            f"{path} has {other[0]!r} between its columns: export the log with commas between "
            f"columns, and points in numbers"
        )
    twice = [name for name, count in Counter(header).items() if count > 1]
    if twice:
        raise ValueError(
            f"{path}: the header has the column {twice[0]!r} twice: rename one of them"
        )


def select_columns(
    path: Path,
    header: list[str],
    sources: Mapping[str, ColumnSource],
    num_rotors: int,
    advice: str = "",
) -> dict[str, ColumnSource]:
    """Select the columns to read.

    Args:
        path: The file, for messages.
        header: Names of the columns.
        sources: Sources of columns that have other names.
        num_rotors: Number of rotors, and so of commands.
        advice: What to do if columns are missing, for the message; for CSV files by default.

    Returns:
        The source of each column to read, by name.

    Raises:
        ValueError: If required columns are missing.
    """
    # Names in another case, such as X or Roll, are the same columns
    like = {name.lower(): name for name in reversed(header)}
    like |= {name: name for name in header}
    known = {name: ColumnSource(like[name]) for name in NAMES if name in like} | dict(sources)
    for name, source in known.items():
        if source.column not in header:
            raise ValueError(
                f"{path}: --map {name}={source.column}: there is no such column; "
                f"{suggest_names(source.column, header)}"
            )
    attitude = EULER if all(name in known for name in EULER) else QUATERNION
    if all(name in known for name in QUATERNION):
        attitude = QUATERNION
    kinds = [kind for kind in COMMANDS if f"{kind}1" in known]
    if len(kinds) > 1:
        raise ValueError(f"{path} has commands of several kinds ({', '.join(kinds)}): map one")
    kind = kinds[0] if kinds else COMMANDS[0]
    needed = ["t", *POSITION, *attitude, *(f"{kind}{r + 1}" for r in range(num_rotors))]
    for group in GROUPS:
        if any(name in known for name in group):
            needed += group
    lacking = [name for name in needed if name not in known]
    if lacking:
        of_hint: dict[str, list[str]] = {}
        for name in lacking[:4]:
            of_hint.setdefault(_hint(name, header), []).append(name)
        hints = "; ".join(f"{', '.join(names)}: {hint}" for hint, names in of_hint.items())
        advice = advice or (f"Name them in the header, or map them by --map {lacking[0]}=COLUMN")
        raise ValueError(f"{path} lacks the columns {', '.join(lacking)} ({hints}). {advice}")
    return {name: known[name] for name in needed}


SYNONYMS = {
    "t": ("time", "timestamp", "stamp"),
    **{axis: (f"p{axis}", f"pos_{axis}", f"position_{axis}") for axis in "xyz"},
    "p": ("gyro_x", "wx"),
    "q": ("gyro_y", "wy"),
    "r": ("gyro_z", "wz"),
    **{
        f"{kind}{r}": (f"m{r}", f"motor_{r}", f"motor{r}")
        for kind in COMMANDS
        for r in range(1, MAX_ROTORS + 1)
    },
}
"""Names of the columns in other tools"""


def _hint(name: str, header: list[str]) -> str:
    """Suggest columns of a header that may be a missing one."""
    known = SYNONYMS.get(name, (name,))
    like = [column for column in header if column.lower().endswith(known)]
    if like:
        return f"perhaps {' or '.join(map(repr, like[:3]))}"
    return suggest_names(name, header)[:MAX_HINT_LENGTH]
