"""Messages that name the wrong value and the remedy."""

import difflib
import math
import numbers
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np


class UnknownOptionError(ValueError, TypeError):
    """An option that there is not: a wrong value for us, a wrong keyword for whoever passes keywords on."""


def unknown(what: str, name: object, choices: Iterable[str]) -> ValueError:
    """An error for a name that is not among `choices`, offering the nearest ones."""
    return ValueError(f"unknown {what} {name!r}: {nearest(name, choices)}")


def nearest(name: object, choices: Iterable[str]) -> str:
    """Offer the choices nearest to a name, or all where none is near."""
    choices = sorted(choices)
    near = difflib.get_close_matches(str(name), choices, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(map(repr, near))}?" if near else f"choose from {', '.join(choices)}"


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


def whole(name: str, value: Any, least: int) -> int:
    """`value` as an int. Raises ValueError unless it is a whole number, at least `least`."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ValueError(f"{name} is {value!r}: a whole number, at least {least}, is needed")
    return int(value)


def finite(name: str, value: Any) -> float:
    """`value` as a float. Raises ValueError unless it is a finite number."""
    if not isinstance(value, numbers.Real) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}: a finite number is needed")
    return float(value)


def several(name: str, value: Any, count: int | None = None) -> tuple:
    """`value` as a tuple. Raises ValueError unless it is a list or tuple, of `count` entries where that is given."""
    if not isinstance(value, list | tuple | np.ndarray) or count not in (None, len(value)):
        raise ValueError(f"{name} is {value!r}: a list or tuple{'' if count is None else f' of {count} values'} is needed")
    return tuple(value)


def numbers_of(subject: str, value: Any) -> np.ndarray:
    """`value` as a float64 array. Raises ValueError ("`subject` not numbers") for anything that is not made of them."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{subject} not numbers: {error}") from None


def points_of(name: str, value: Any) -> np.ndarray:
    """`value` as an array (M, 3) of points, one or more. Raises ValueError unless it is finite numbers of that shape."""
    points = np.atleast_2d(numbers_of(f"{name} is", value))
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise ValueError(f"{name} is {value!r}: a finite point (x, y, z), or several, is needed")
    return points


def pick(what: str, name: str, table: dict):
    """`table[name]`, or `unknown` when it is not there."""
    if not isinstance(name, str) or name not in table:
        raise unknown(what, name, table)
    return table[name]
