"""Infos of a decision: arrays by name, computed when they are first read."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

PENDING = {"": None}
"""Placeholder of the values: C code would treat a dict without any entry as empty"""


class Infos(dict[str, Any]):
    """A dict whose values are computed when any of them is first read.

    Most training steps never read their infos. `lazy_infos` creates such a dict.
    """

    __slots__ = ("_make",)
    _make: Callable[[], Mapping[str, Any]] | None

    def _fill(self) -> None:
        if self._make is not None:
            # In this order: after an interrupt the next access fills them
            super().update(self._make())
            super().pop("", None)
            self._make = None

    def __reduce__(self) -> Any:
        """Pickle as a plain dict."""
        return dict, (dict(self),)

    def copy(self) -> dict[str, Any]:
        """Return a plain dict."""
        return dict(self)


def lazy_infos(make: Callable[[], Mapping[str, Any]]) -> Infos:
    """Create infos whose values `make` returns when any of them is first read."""
    infos = Infos(PENDING)
    infos._make = make
    return infos


def unread_table(infos: Mapping[str, Any]) -> "InfoTable | None":
    """Return the results of a decision if its infos have not been read yet, else None."""
    make = infos._make if type(infos) is Infos else None
    return make if type(make) is InfoTable else None


def _fill_first(name: str) -> Any:
    """Wrap a method of dict so that the values are computed first."""
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
"""Methods of dict that read the values"""
for _name in METHODS:
    setattr(Infos, _name, _fill_first(_name))


@dataclass(slots=True)
class InfoTable:
    """Results of a decision; calling the object makes infos.

    Attributes:
        table: (K, W, N) numbers.
        rows: Name and type of each row of the table; rows without a name are left out.
        more: Further arrays (W, N) by name. They belong to the table, except immutable arrays,
            which are shared with the environment and copied when infos are made.
        world: Index of the world of the infos; `...` for all.
    """

    table: np.ndarray
    rows: Sequence[tuple[str | None, Any]]
    more: Mapping[str, np.ndarray]
    world: Any = ...

    def __call__(self) -> dict[str, np.ndarray]:
        """Return infos: arrays (W, N) by name, or (N,) for one world, which callers may modify."""
        more = {
            name: (value.copy() if is_immutable(value) else value)[self.world]
            for name, value in self.more.items()
        }
        return rows_by_name(self.table[:, self.world], self.rows) | more


def is_immutable(value: Any) -> bool:
    """Return True if an array is immutable: read-only, and not a view of another array."""
    return type(value) is np.ndarray and value.base is None and not value.flags.writeable


def rows_by_name(
    table: np.ndarray, names: Iterable[tuple[str | None, Any]]
) -> dict[str, np.ndarray]:
    """Return the rows of a table by name.

    Args:
        table: (K, W, N) numbers, or (K, N) of one world.
        names: Name and type of each row; rows without a name are left out.

    Returns:
        Arrays without the first axis of the table, by name.
    """
    named_rows = zip(table, names, strict=True)
    return {name: row.astype(kind) for row, (name, kind) in named_rows if name is not None}
