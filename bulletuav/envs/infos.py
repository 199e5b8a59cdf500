"""Infos of a decision: arrays by name, made when they are read."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

PENDING = {"": None}
"""What stands in place of the values: code in C takes a dict without any for empty at once"""


class Infos(dict[str, Any]):
    """A dict whose values are made all at once when somebody asks for one.

    Most decisions of a training are never asked. `later` makes one.
    """

    __slots__ = ("_make",)
    _make: Callable[[], Mapping[str, Any]] | None

    def _fill(self) -> None:
        if self._make is not None:
            # In this order: after an interrupt they are made by the next who asks
            super().update(self._make())
            super().pop("", None)
            self._make = None

    def __reduce__(self) -> Any:
        """Travel as a plain dict."""
        return dict, (dict(self),)

    def copy(self) -> dict[str, Any]:
        """Return a plain dict."""
        return dict(self)


def later(make: Callable[[], Mapping[str, Any]]) -> Infos:
    """Make infos whose values `make` makes when somebody asks for one."""
    infos = Infos(PENDING)
    infos._make = make
    return infos


def untold(infos: Mapping[str, Any]) -> "Told | None":
    """Tell what a decision told where nobody has asked for its infos yet; None otherwise."""
    make = infos._make if type(infos) is Infos else None
    return make if type(make) is Told else None


def _filled_first(name: str) -> Any:
    """Make a method of dict that makes the values first."""
    plain = getattr(dict, name)

    def method(self: Infos, *args: Any, **kwargs: Any) -> Any:
        self._fill()
        return plain(self, *args, **kwargs)

    method.__name__, method.__doc__ = name, plain.__doc__
    return method


METHODS = (
    *("__contains__", "__delitem__", "__eq__", "__getitem__", "__ior__", "__iter__", "__len__"),
    *("__ne__", "__or__", "__repr__", "__reversed__", "__ror__", "__setitem__", "clear", "get"),
    *("items", "keys", "pop", "popitem", "setdefault", "update", "values"),
)
"""Methods of dict that look at the values"""
for _name in METHODS:
    setattr(Infos, _name, _filled_first(_name))


@dataclass(slots=True)
class Told:
    """What a decision told; calling it makes infos.

    Attributes:
        table: (K, W, N) numbers.
        rows: Name and type of each row of it; those without a name are left out.
        more: Arrays (W, N) by name, told beside; those that stay as they are come as they are.
        world: Index of the world of which infos tell; all when left out.
    """

    table: np.ndarray
    rows: Sequence[tuple[str | None, Any]]
    more: Mapping[str, np.ndarray]
    world: Any = ...

    def __call__(self) -> dict[str, np.ndarray]:
        """Make infos, whose arrays callers may write into."""
        more = {
            name: (value.copy() if stays(value) else value)[self.world]
            for name, value in self.more.items()
        }
        return columns(self.table[:, self.world], self.rows) | more


def stays(value: Any) -> bool:
    """Tell whether nobody writes into an array: it is read-only, and no view of another."""
    return type(value) is np.ndarray and value.base is None and not value.flags.writeable


def columns(table: np.ndarray, names: Iterable[tuple[str | None, Any]]) -> dict[str, np.ndarray]:
    """Make infos of a table's rows.

    Args:
        table: (K, W, N) numbers.
        names: Name and type of each row; those without a name are left out.

    Returns:
        Arrays (W, N) by name.
    """
    told = zip(table, names, strict=True)
    return {name: row.astype(kind) for row, (name, kind) in told if name is not None}
