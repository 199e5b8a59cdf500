"""Messages that name the wrong value and the remedy."""

import difflib
import math
import numbers
import os
import reprlib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

MOST_SHOWN = 200  # letters of a value in a message
USUAL_MEMORY = 16 * 2**30  # bytes, where the machine does not tell how much it has
GIB = 2**30


class _Shown(reprlib.Repr):
    """Of lists and texts as much as a message holds; arrays and objects are cut, too."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxtuple, self.maxset, self.maxdict = 4, 12, 12, 12, 12
        self.maxstring = self.maxother = self.maxlong = MOST_SHOWN


_SHOWN = _Shown()


class UnknownOptionError(ValueError, TypeError):
    """An option that there is not: a wrong value for us, a wrong keyword for whoever passes keywords on."""


def shown(value: object) -> str:
    """What a value looks like in a message: its repr, cut where it is long; never raises."""
    try:
        text = (
            repr(value)
            if isinstance(value, float | str) and len(str(value)) < MOST_SHOWN
            else _SHOWN.repr(value)
        )
    except Exception:  # a number of too many digits, or an object whose repr is broken
        text = f"<{type(value).__name__} that cannot be shown>"
    text = " ".join(text.split("\n"))
    return text if len(text) <= 2 * MOST_SHOWN else f"{text[:MOST_SHOWN]}..."


def unknown(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """An error for a name that is not among `choices`, offering the nearest ones."""
    return ValueError(f"unknown {what} {shown(name)}: {nearest(name, choices)}")


def nearest(name: object, choices: Iterable[str]) -> str:
    """Offer the choices nearest to a name, or all where none is near."""
    choices = sorted(choices)
    text = name[:MOST_SHOWN] if isinstance(name, str) else ""
    near = difflib.get_close_matches(text, choices, n=3, cutoff=0.5)
    return (
        f"did you mean {' or '.join(map(repr, near))}?"
        if near
        else f"choose from {', '.join(choices)}"
    )


CHECKOUT, SHARED = Path(__file__).parents[1], Path(sys.prefix, "share", "bulletuav")
"""Where constraints.txt is: beside the package in a checkout, else where the wheel puts it"""


def install(extra: str) -> str:
    """The command that installs an extra at tested versions; without them pip fetches a PyTorch of several gigabytes."""
    if (CHECKOUT / "setup.cfg").is_file():
        return f"pip install -c {CHECKOUT / 'constraints.txt'} -e '{CHECKOUT}[{extra}]'"
    return f"pip install -c {SHARED / 'constraints.txt'} 'bulletuav[{extra}]'"


def missing(what: str, extra: str) -> ImportError:
    """An error for `what`, that the user wanted to do, such as "training", and that takes an extra."""
    return ImportError(f"{what} needs the extra {extra!r}: {install(extra)}")


def memory() -> int:
    """Bytes of memory that this machine has."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):  # not on Windows
        return USUAL_MEMORY


def require_memory(what: str, needed: float, remedy: str) -> None:
    """Refuse what this machine cannot hold, before anything of it is made.

    Args:
        what: Is asked for.
        needed: Bytes that it takes, about.
        remedy: What to do.

    Raises:
        ValueError: It is more than the machine has; both figures are named.
    """
    if needed > memory():
        raise ValueError(
            f"{what} need about {needed / GIB:.3g} GiB, and this machine has {memory() / GIB:.3g} GiB: {remedy}"
        )


def require_file(what: str, path: Any, remedy: str) -> Path:
    """The path of a file that is there.

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
    except (
        OSError,
        ValueError,
        RuntimeError,
    ) as error:  # too long a name, a NUL in it, nobody's home
        raise ValueError(
            f"{what} {shown(str(path))} is no path of a file: {error.args[-1]}; {remedy}"
        ) from None
    raise FileNotFoundError(f"no {what} file {found}: {remedy}")


def read_file(path: Path) -> str:
    """The text of a file, UTF-8. Raises ValueError, which names it, where it is none or cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path} is no text in UTF-8 ({error.reason} at byte {error.start}): save it as UTF-8"
        ) from None
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from None


def as_int(name: str, value: Any, least: int, most: int | None = None) -> int:
    """`value` as an int. Raises ValueError unless it is a whole number, at least `least` and at most `most`."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} is {shown(value)}: a whole number, at least {least}, is needed")
    if most is not None and value > most:
        raise ValueError(
            f"{name} is {shown(value)}: a whole number from {least} to {most} is needed"
        )
    return int(value)


def finite(name: str, value: Any, least: float | None = None, most: float | None = None) -> float:
    """`value` as a float, which is what to keep. Raises ValueError unless it is a finite number within the bounds.

    Bools are none. Without `most` any finite number is.
    """
    try:
        number = (
            float(value)
            if not isinstance(value, bool | np.bool_) and isinstance(value, numbers.Real)
            else math.nan
        )
    except (OverflowError, ValueError, TypeError):  # a whole number or a fraction beyond all floats
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} is {shown(value)}: a finite number is needed")
    if least is not None and number < least:
        raise ValueError(f"{name} is {number:g}: at least {least:g} is needed")
    if most is not None and number > most:
        raise ValueError(f"{name} is {number:g}: at most {most:g} is possible")
    return number


def as_sequence(name: str, value: Any, count: int | None = None, most: int | None = None) -> tuple:
    """`value` as a tuple. Raises ValueError unless it is a list or tuple, of `count` entries or up to `most` where given."""
    listed = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1)
    if not listed or count not in (None, len(value)):
        of = "" if count is None else f" of {count} values"
        raise ValueError(f"{name} is {shown(value)}: a list or tuple{of} is needed")
    if most is not None and len(value) > most:
        raise ValueError(f"{name} has {len(value)} entries: at most {most} are possible")
    return tuple(value)


def numbers_of(subject: str, value: Any) -> np.ndarray:
    """`value` as a float64 array. Raises ValueError ("`subject` not numbers") for anything that is not made of them."""
    try:
        array = np.asarray(value)
        real = array.dtype.kind in "fiub" or (
            array.dtype.kind == "O" and all(map(_is_real, array.flat))
        )
        if not real:  # NumPy makes numbers of texts, dates and None, and drops what is imaginary
            raise TypeError(f"{shown(value)} has others than real ones")
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{subject} not numbers: {error}") from None


def _is_real(value: Any) -> bool:
    return isinstance(value, numbers.Real)


def points_of(name: str, value: Any) -> np.ndarray:
    """`value` as an array (M, 3) of points, one or more. Raises ValueError unless it is finite numbers of that shape."""
    points = np.atleast_2d(numbers_of(f"{name} is", value))
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"{name} is {shown(value)}: a finite point (x, y, z), or several, is needed"
        )
    return points


def choose(what: str, name: Any, table: Mapping[str, Any]) -> Any:
    """`table[name]`, or `unknown` when it is not there."""
    if not isinstance(name, str) or name not in table:
        raise unknown(what, name, table)
    return table[name]
