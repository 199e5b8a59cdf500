"""Checks of what users give, and error messages that name the wrong value and the remedy.

Functions that return an error (`unknown`, `missing`) leave the `raise` to the caller. Functions
that check (`as_int`, `finite`, `as_sequence`, `numbers_of`, `points_of`) return the value in the
type that the package keeps, and raise ValueError otherwise.
"""

import contextlib
import difflib
import math
import numbers
import os
import reprlib
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

Entry = TypeVar("Entry")

MOST_SHOWN = 200
"""Most characters of a value that a message shows."""
USUAL_MEMORY = 16 * 2**30
"""Bytes of memory that are assumed where the machine does not tell how much it has."""
GIB = 2**30
"""Bytes in a gibibyte."""

CHECKOUT = Path(__file__).parents[1]
"""Folder of constraints.txt in a checkout: beside the package."""
SHARED = Path(sys.prefix, "share", "bulletuav")
"""Folder of constraints.txt after an install: where the wheel puts it."""
PINS = "constraints"
"""Folder beside constraints.txt, with a file for each extra that has versions of its own."""


class _Shown(reprlib.Repr):
    """A repr that cuts long lists, texts and numbers, so that they fit into a message."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 4
        self.maxlist = 12
        self.maxtuple = 12
        self.maxset = 12
        self.maxdict = 12
        self.maxstring = MOST_SHOWN
        self.maxother = MOST_SHOWN
        self.maxlong = MOST_SHOWN


_SHOWN = _Shown()


class UnknownOptionError(ValueError, TypeError):
    """Error for an option that does not exist.

    It is a ValueError, as all refused values are, and also a TypeError, which Python raises for an
    unknown keyword: callers that pass keywords on expect that one.
    """


def shown(value: object) -> str:
    """Format a value for a message: its repr on one line, cut where it is long.

    Never raises, whatever the value's own repr does.
    """
    try:
        if isinstance(value, float | str) and len(str(value)) < MOST_SHOWN:
            text = repr(value)
        else:
            text = _SHOWN.repr(value)
    # A number of too many digits, or an object whose repr is broken.
    except Exception:
        text = f"<{type(value).__name__} that cannot be shown>"
    text = " ".join(text.split("\n"))
    return text if len(text) <= 2 * MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def printable(text: str) -> str:
    """Return a text that can be drawn and written: names of files may have other bytes in them."""
    return text.encode(errors="backslashreplace").decode()


def reason_of(error: Exception) -> str:
    """Describe an error on one line, cut where it is long: its type and what it says."""
    text = " ".join(str(error).split())
    cut = text if len(text) <= 2 * MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
    return f"{type(error).__name__}: {cut}" if cut else type(error).__name__


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name a file in each ValueError of what is done with its content, unless it is named.

    Args:
        path: The file, or its folder.

    Raises:
        ValueError: One was raised.
    """
    try:
        yield
    except ValueError as error:
        # The folder of a name alone is ".", which is in most messages
        folder = str(path.parent) if path.parent.name else str(path)
        if str(path) in str(error) or folder in str(error):
            raise
        raise ValueError(f"{path}: {error}") from None


def unknown(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """Make the error for a name that is not among the choices.

    Args:
        what: What the name stands for, such as "task".
        name: The value that was given.
        choices: The names that exist; the nearest ones are offered.

    Returns:
        The error, for the caller to raise.
    """
    return ValueError(f"unknown {what} {shown(name)}: {nearest(name, choices)}")


def nearest(name: object, choices: Iterable[str]) -> str:
    """Offer the choices nearest to a name, or all of them where none is near."""
    choices = sorted(choices)
    text = name[:MOST_SHOWN] if isinstance(name, str) else ""
    near = difflib.get_close_matches(text, choices, n=3, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    return f"choose from {', '.join(choices)}"


def install(extra: str) -> str:
    """Tell the command that installs an extra at tested versions.

    The versions come from a file: without them pip fetches a PyTorch of several gigabytes.
    """
    in_checkout = (CHECKOUT / "setup.cfg").is_file()
    folder = CHECKOUT if in_checkout else SHARED
    own = folder / PINS / f"{extra}.txt"
    pins = own if own.is_file() else folder / "constraints.txt"
    what = f"-e '{CHECKOUT}[{extra}]'" if in_checkout else f"'bulletuav[{extra}]'"
    return f"pip install -c {pins} {what}"


def missing(what: str, extra: str) -> ImportError:
    """Make the error for something that needs an extra which is not installed.

    Args:
        what: What the user wanted to do, such as "training".
        extra: Name of the extra, such as "sb3".

    Returns:
        The error, for the caller to raise; it tells the command that installs the extra.
    """
    return ImportError(f"{what} needs the extra {extra!r}: {install(extra)}")


def memory() -> int:
    """Tell how many bytes of memory this machine has, or `USUAL_MEMORY` where it does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    # Windows has no sysconf.
    except (AttributeError, ValueError, OSError):
        return USUAL_MEMORY


def require_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse what this machine cannot hold, before any of it is allocated.

    Args:
        what: What is asked for, in the plural.
        needed: Bytes that it takes, about.
        remedy: What the user can do.

    Raises:
        ValueError: It is more than the machine has; both figures are named.
    """
    available = memory()
    if needed > available:
        raise ValueError(
            f"{what} need about {needed / GIB:.3g} GiB, "
            f"and this machine has {available / GIB:.3g} GiB: {remedy}"
        )


def require_file(what: str, path: object, remedy: str) -> Path:
    """Check that a path leads to a file.

    Args:
        what: What the file is, such as "airframe".
        path: The path that was given; "~" is expanded.
        remedy: What the user can do.

    Returns:
        The path.

    Raises:
        ValueError: It is no path at all.
        FileNotFoundError: There is no such file.
    """
    if not isinstance(path, str | Path):
        raise ValueError(
            f"path of the {what} file is {shown(path)}: a text or a Path is needed; {remedy}"
        )
    try:
        found = Path(path).expanduser()
        if found.is_file():
            return found
    # The name is too long or holds a NUL, or the home folder is of nobody.
    except (OSError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"{what} {shown(str(path))} is no path of a file: {error.args[-1]}; {remedy}"
        ) from None
    raise FileNotFoundError(f"no {what} file {found}: {remedy}")


def read_file(path: Path, newline: str | None = None) -> str:
    """Read a text file in UTF-8; a byte order mark, as Windows' editors write it, is left out.

    Args:
        path: The file.
        newline: As in `open`.

    Raises:
        ValueError: It is no text in UTF-8, or cannot be read; the message names the file.
    """
    try:
        with path.open(encoding="utf-8-sig", newline=newline) as file:
            return file.read()
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path} is no text in UTF-8 ({error.reason} at byte {error.start}): save it as UTF-8"
        ) from None
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from None


def as_int(name: str, value: object, least: int, most: int | None = None) -> int:
    """Check that a value is a whole number within bounds.

    Args:
        name: What the number is, for the message.
        value: A Python or numpy integer; bools are refused.
        least: Least number allowed.
        most: Greatest number allowed; any when left out.

    Returns:
        The value as an int.

    Raises:
        ValueError: It is no whole number, or out of bounds.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} is {shown(value)}: a whole number, at least {least}, is needed")
    if most is not None and value > most:
        raise ValueError(
            f"{name} is {shown(value)}: a whole number from {least} to {most} is needed"
        )
    return int(value)


def finite(
    name: str, value: object, least: float | None = None, most: float | None = None
) -> float:
    """Check that a value is a finite number within bounds.

    Args:
        name: What the number is, for the message.
        value: Any real number; bools are refused.
        least: Least number allowed; any when left out.
        most: Greatest number allowed; any finite one when left out.

    Returns:
        The value as a float, which is what to keep.

    Raises:
        ValueError: It is no finite number, or out of bounds.
    """
    try:
        if not isinstance(value, bool | np.bool_) and isinstance(value, numbers.Real):
            number = float(value)
        else:
            number = math.nan
    # A whole number or fraction beyond all floats.
    except (OverflowError, ValueError, TypeError):
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} is {shown(value)}: a finite number is needed")
    if least is not None and number < least:
        raise ValueError(f"{name} is {number:g}: at least {least:g} is needed")
    if most is not None and number > most:
        raise ValueError(f"{name} is {number:g}: at most {most:g} is possible")
    return number


def as_sequence(
    name: str, value: Any, count: int | None = None, most: int | None = None
) -> tuple[Any, ...]:
    """Check that a value is a list, a tuple or an array of one axis.

    Args:
        name: What the values are, for the message.
        value: What was given.
        count: How many entries it must have; any number when left out.
        most: How many entries it may have; any number when left out.

    Returns:
        Its entries as a tuple.

    Raises:
        ValueError: It is none of these, or has another number of entries.
    """
    listed = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1)
    if not listed or count not in (None, len(value)):
        of = "" if count is None else f" of {count} values"
        raise ValueError(f"{name} is {shown(value)}: a list or tuple{of} is needed")
    if most is not None and len(value) > most:
        raise ValueError(f"{name} has {len(value)} entries: at most {most} are possible")
    return tuple(value)


def numbers_of(subject: str, value: object) -> np.ndarray:
    """Check that a value is made of real numbers.

    Args:
        subject: Start of the message, which goes on with "not numbers", such as "positions are".
        value: A number, nested lists of numbers or an array, of any shape.

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: Something in it is no real number.
    """
    try:
        array = np.asarray(value)
        real = array.dtype.kind in "fiub" or (
            array.dtype.kind == "O" and all(map(_is_real, array.flat))
        )
        # NumPy would make numbers of texts, dates and None, and drop what is imaginary.
        if not real:
            raise TypeError(f"{shown(value)} has others than real ones")
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{subject} not numbers: {error}") from None


def _is_real(value: object) -> bool:
    """Tell whether a value is a real number."""
    return isinstance(value, numbers.Real)


def points_of(name: str, value: object) -> np.ndarray:
    """Check that a value is one or more finite points.

    Args:
        name: What the points are, for the message.
        value: A point (3,), or points (M, 3).

    Returns:
        The points as a float64 array (M, 3).

    Raises:
        ValueError: It is not finite numbers of such a shape.
    """
    points = np.atleast_2d(numbers_of(f"{name} is", value))
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"{name} is {shown(value)}: a finite point (x, y, z), or several, is needed"
        )
    return points


def choose(what: str, name: object, table: Mapping[str, Entry]) -> Entry:
    """Look a name up in a table.

    Args:
        what: What the name stands for, for the message.
        name: The name that was given.
        table: The entries by their names.

    Returns:
        The entry of that name.

    Raises:
        ValueError: There is none of that name; the nearest ones are offered.
    """
    if not isinstance(name, str) or name not in table:
        raise unknown(what, name, table)
    return table[name]
