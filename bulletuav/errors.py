"""Validation of user input, and error messages that name the wrong value and the remedy.

Functions that return an error (`unknown`, `missing_extra`) leave the `raise` to the caller.
Functions that validate (`as_int`, `finite`, `as_sequence`, `as_instance`, `numbers_of`,
`points_of`) return the value converted to the type that the package uses, and raise ValueError if
the value is invalid.
"""

import contextlib
import dataclasses
import difflib
import math
import numbers
import os
import reprlib
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

Entry = TypeVar("Entry")
Instance = TypeVar("Instance")

MAX_SHOWN = 200
"""Maximum number of characters of a value that a message shows."""
DEFAULT_MEMORY = 16 * 2**30
"""Memory in bytes that is assumed if the operating system does not report it."""
GIB = 2**30
"""Bytes in a gibibyte."""

CHECKOUT = Path(__file__).parents[1]
"""Folder of constraints.txt in a checkout: the parent folder of the package."""
SHARED = Path(sys.prefix, "share", "bulletuav")
"""Folder of constraints.txt after an installation from a wheel."""
PINS = "constraints"
"""Folder next to constraints.txt, with one file for each extra that pins its own versions."""


class _Shown(reprlib.Repr):
    """A repr that truncates long lists, strings and numbers, so that they fit into a message."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 4
        self.maxlist = 12
        self.maxtuple = 12
        self.maxset = 12
        self.maxdict = 12
        self.maxstring = MAX_SHOWN
        self.maxother = MAX_SHOWN
        self.maxlong = MAX_SHOWN


_SHOWN = _Shown()


class UnknownOptionError(ValueError, TypeError):
    """Error for an option that does not exist.

    The error is a ValueError, like every error for an invalid value, and also a TypeError, which
    Python raises for an unknown keyword argument and which callers that pass keyword arguments
    expect.
    """


def shown(value: object) -> str:
    """Format a value for a message: its repr on one line, truncated if it is long.

    Never raises, even if the `__repr__` of the value does.
    """
    try:
        if isinstance(value, float | str) and len(str(value)) < MAX_SHOWN:
            text = repr(value)
        else:
            text = _SHOWN.repr(value)
    # An integer with too many digits, or an object whose __repr__ raises
    except Exception:
        text = f"<{type(value).__name__} that cannot be shown>"
    text = " ".join(text.split("\n"))
    return text if len(text) <= 2 * MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def printable_text(text: str) -> str:
    """Return a text that can be encoded, with invalid bytes (as in file names) escaped."""
    return text.encode(errors="backslashreplace").decode()


def reason_of(error: Exception) -> str:
    """Describe an error on one line: its type and its message, truncated if it is long."""
    text = " ".join(str(error).split())
    cut = text if len(text) <= 2 * MAX_SHOWN else f"{text[:MAX_SHOWN]}..."
    return f"{type(error).__name__}: {cut}" if cut else type(error).__name__


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Add the path of a file to each ValueError that is raised inside the `with` block.

    Args:
        path: The file, or its folder. Messages that contain the path already stay unchanged.

    Raises:
        ValueError: If the block raises one.
    """
    try:
        yield
    except ValueError as error:
        # The parent of a bare file name is ".", which most messages contain
        folder = str(path.parent) if path.parent.name else str(path)
        if str(path) in str(error) or folder in str(error):
            raise
        raise ValueError(f"{path}: {error}") from None


def unknown(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """Return the error for a name that is not among the choices.

    Args:
        what: Kind of the name, such as "task".
        name: The unknown name.
        choices: The valid names. The message suggests the closest matches.

    Returns:
        The error, for the caller to raise.
    """
    return ValueError(f"unknown {what} {shown(name)}: {suggest_names(name, choices)}")


def suggest_names(name: object, choices: Iterable[str]) -> str:
    """Return a hint with the valid names closest to a name, or with all if none is close."""
    choices = sorted(choices)
    text = name[:MAX_SHOWN] if isinstance(name, str) else ""
    near = difflib.get_close_matches(text, choices, n=3, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(map(repr, near))}?"
    return f"choose from {', '.join(choices)}"


def install(extra: str) -> str:
    """Return the command that installs an extra at tested versions.

    The versions come from a constraints file. Without these constraints, pip downloads a PyTorch
    build of several gigabytes.
    """
    in_checkout = (CHECKOUT / "pyproject.toml").is_file()
    folder = CHECKOUT if in_checkout else SHARED
    own = folder / PINS / f"{extra}.txt"
    pins = own if own.is_file() else folder / "constraints.txt"
    what = f"-e '{CHECKOUT}[{extra}]'" if in_checkout else f"'bulletuav[{extra}]'"
    return f"pip install -c {pins} {what}"


def missing_extra(what: str, extra: str) -> ImportError:
    """Return the error for a feature whose optional dependencies (extra) are not installed.

    Args:
        what: The feature, such as "training".
        extra: Name of the extra, such as "sb3".

    Returns:
        The error, for the caller to raise. The message contains the command that installs the
        extra.
    """
    return ImportError(f"{what} needs the extra {extra!r}: {install(extra)}")


def total_memory() -> int:
    """Return the physical memory of this machine in bytes, or `DEFAULT_MEMORY` if unknown."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    # Windows has no sysconf
    except (AttributeError, ValueError, OSError):
        return DEFAULT_MEMORY


def require_available_memory(what: str, needed: float, remedy: str) -> None:
    """Raise an error if an allocation would exceed the memory of this machine.

    Args:
        what: Name of the objects to allocate, in the plural.
        needed: Approximate size in bytes.
        remedy: What the user can do.

    Raises:
        ValueError: If the size exceeds the physical memory. The message contains both figures.
    """
    available = total_memory()
    if needed > available:
        raise ValueError(
            f"{what} need about {needed / GIB:.3g} GiB, "
            f"and this machine has {available / GIB:.3g} GiB: {remedy}"
        )


def require_file(what: str, path: object, remedy: str) -> Path:
    """Check that a path points to an existing file.

    Args:
        what: Kind of the file, such as "airframe".
        path: A text or a Path; "~" is expanded.
        remedy: What the user can do.

    Returns:
        The path.

    Raises:
        ValueError: If the value cannot be a path.
        FileNotFoundError: If the file does not exist.
    """
    if not isinstance(path, str | Path):
        raise ValueError(
            f"path of the {what} file is {shown(path)}: a text or a Path is needed; {remedy}"
        )
    try:
        found = Path(path).expanduser()
        if found.is_file():
            return found
    # The name is too long or contains NUL, or there is no such user for "~user"
    except (OSError, ValueError, RuntimeError) as error:
        raise ValueError(
            f"{what} {shown(str(path))} is no path of a file: {error.args[-1]}; {remedy}"
        ) from None
    raise FileNotFoundError(f"no {what} file {found}: {remedy}")


def read_file(path: Path, newline: str | None = None) -> str:
    """Read a text file in UTF-8, and skip the byte order mark that Windows editors write.

    Args:
        path: The file.
        newline: As in `open`.

    Raises:
        ValueError: If the file is not UTF-8 or cannot be read. The message contains the path.
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


def as_bool(name: str, value: object) -> bool:
    """Check that a value is True or False.

    Args:
        name: Name of the value, for the message.
        value: The value.

    Returns:
        The value.

    Raises:
        ValueError: If it is of another type.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {shown(value)}: True or False is needed")
    return value


def as_int(name: str, value: object, least: int, most: int | None = None) -> int:
    """Check that a value is an integer within bounds.

    Args:
        name: What the number is, for the message.
        value: A Python or NumPy integer; bools raise ValueError.
        least: Minimum allowed value.
        most: Maximum allowed value; no maximum if None.

    Returns:
        The value as an int.

    Raises:
        ValueError: If the value is not an integer, or out of bounds.
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
        value: Any real number; bools raise ValueError.
        least: Minimum allowed value; no minimum if None.
        most: Maximum allowed value; any finite number if None.

    Returns:
        The value as a Python float.

    Raises:
        ValueError: If the value is not a finite number, or out of bounds.
    """
    try:
        if not isinstance(value, bool | np.bool_) and isinstance(value, numbers.Real):
            number = float(value)
        else:
            number = math.nan
    # An integer or Fraction beyond the range of floats
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
    """Check that a value is a list, a tuple or a one-dimensional array.

    Args:
        name: What the values are, for the message.
        value: The value to check.
        count: Required number of entries; any number if None.
        most: Maximum number of entries; any number if None.

    Returns:
        The entries as a tuple.

    Raises:
        ValueError: If the value is of another type, or has another number of entries.
    """
    listed = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1)
    if not listed or count not in (None, len(value)):
        of = "" if count is None else f" of {count} values"
        raise ValueError(f"{name} is {shown(value)}: a list or tuple{of} is needed")
    if most is not None and len(value) > most:
        raise ValueError(f"{name} has {len(value)} entries: at most {most} are possible")
    return tuple(value)


def as_instance(what: str, kind: type[Instance], given: object) -> Instance:
    """Convert an object of a dataclass, or a dict of its attributes, to the object.

    Args:
        what: Name of the option in messages.
        kind: The dataclass.
        given: The value.

    Raises:
        ValueError: If the value is neither, an attribute is unknown or invalid, or one without a
            default is missing.
    """
    if isinstance(given, kind):
        return given
    needed = {
        one.name: one.default is one.default_factory is dataclasses.MISSING
        for one in dataclasses.fields(cast(Any, kind))
    }
    if not isinstance(given, Mapping):
        raise ValueError(
            f"{what} is {shown(given)}: {kind.__name__}, or a dict of {', '.join(needed)}, is "
            f"needed"
        )
    for name in given:
        if name not in needed:
            raise unknown(f"attribute of {what}:", name, needed)
    for name, is_needed in needed.items():
        if is_needed and name not in given:
            raise ValueError(f"{what} is {shown(dict(given))}: it lacks a {name}")
    return kind(**given)


def numbers_of(subject: str, value: object) -> np.ndarray:
    """Convert a value to a float64 array, and check that it contains only real numbers.

    Args:
        subject: Start of the message, such as "positions are"; "not numbers" follows it.
        value: A number, nested lists of numbers or an array, of any shape.

    Returns:
        The value as a float64 array.

    Raises:
        ValueError: If an element is not a real number.
    """
    try:
        array = np.asarray(value)
        real = array.dtype.kind in "fiub" or (
            array.dtype.kind == "O" and all(map(_is_real, array.flat))
        )
        # NumPy would convert strings, dates and None to numbers, and drop imaginary parts
        if not real:
            raise TypeError(f"{shown(value)} has others than real ones")
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{subject} not numbers: {error}") from None


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real)


def points_of(name: str, value: object) -> np.ndarray:
    """Convert a value to an array of points, and check that all coordinates are finite.

    Args:
        name: Name of the points, for the message.
        value: A point (3,), or points (M, 3).

    Returns:
        The points as a float64 array (M, 3).

    Raises:
        ValueError: If the value has another shape, or is not finite.
    """
    points = np.atleast_2d(numbers_of(f"{name} is", value))
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(
            f"{name} is {shown(value)}: a finite point (x, y, z), or several, is needed"
        )
    return points


def find_choice(what: str, name: object, table: Mapping[str, Entry]) -> Entry:
    """Look up a name in a table of choices.

    Args:
        what: Kind of the name, for the message.
        name: The name to look up.
        table: The entries by name.

    Returns:
        The entry of that name.

    Raises:
        ValueError: If the name is unknown. The message suggests the closest matches.
    """
    if not isinstance(name, str) or name not in table:
        raise unknown(what, name, table)
    return table[name]


def former_names(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Make the `__getattr__` of a module in which public names changed; it warns for one release.

    Args:
        module: Name of the module, `__name__`.
        names: Present names by former ones. A name with dots is in the module before its last dot.

    Returns:
        A function that returns the object of a former name with a DeprecationWarning, and raises
        AttributeError for other names.
    """

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warnings.warn(
            f"{module}.{name} is now {names[name]}; the old name will be removed in the next "
            f"release",
            DeprecationWarning,
            stacklevel=2,
        )
        home, _, present = names[name].rpartition(".")
        return getattr(import_module(home or module), present)

    return find
