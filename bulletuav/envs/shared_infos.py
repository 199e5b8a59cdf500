"""Infos of steps in shared memory, so that none of them is sent between processes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.envs.infos import Infos, lazy_infos, unread_table
from bulletuav.envs.results import INFOS

MAX_MORE_INFOS = 16
"""Number of rows for infos of tasks, sensors and randomization, in addition to `INFOS`"""
INFO_TYPES = tuple(map(np.dtype, ("f8", "i8", "?")))
"""Types of infos that can be shared"""
MAX_EXACT_INTEGER = 2**53
"""Largest whole number up to which float64 is exact"""


def num_info_rows(terms: int) -> int:
    """Return the number of info rows to allocate for a number of reward terms."""
    return terms + len(INFOS) + MAX_MORE_INFOS


class SharedInfos:
    """Infos of some worlds in a shared array.

    Both sides know the names and types of the rows from the last reset.
    """

    def __init__(self, array: np.ndarray) -> None:
        """Use a shared array.

        Args:
            array: (W, K, N) float64.
        """
        self._array = array
        self._types: dict[str, np.dtype[Any]] = {}

    def set_types(self, infos: Mapping[str, Any]) -> None:
        """Store names and types of infos after a reset, which each step has, too."""
        worlds, room, drones = self._array.shape
        fit = len(infos) <= room and all(
            isinstance(one, np.ndarray)
            and one.shape == (worlds, drones)
            and one.dtype in INFO_TYPES
            for one in infos.values()
        )
        self._types = {name: one.dtype for name, one in infos.items()} if fit else {}

    def write(self, infos: Mapping[str, Any]) -> bool:
        """Write the infos of a step.

        Returns:
            True if names and types are those of the reset, and the infos were written.
        """
        if not self._types:
            return False
        info_table, begin = unread_table(infos), 0
        # If infos were not read, their table is copied as a whole
        if info_table is not None:
            rows = [k for k, (name, _) in enumerate(info_table.rows) if name is not None]
            names, begin = [info_table.rows[k][0] for k in rows], len(rows)
            if [*names, *info_table.more] != list(self._types):
                return False
            table = info_table.table if begin == len(info_table.table) else info_table.table[rows]
            self._array[:, :begin] = table.swapaxes(0, 1)
            infos = info_table.more
        elif list(infos) != list(self._types):
            return False
        others = zip(infos.values(), list(self._types.values())[begin:], strict=True)
        for k, (one, kind) in enumerate(others, begin):
            if one.dtype != kind or (
                kind.kind == "i" and np.abs(one).max(initial=0) > MAX_EXACT_INTEGER
            ):
                return False
            self._array[:, k] = one
        return True

    def read(self, answers: list[Any], parts: list[slice]) -> dict[str, Any]:
        """Copy the infos of a step. Infos that were shared are computed when they are read.

        Args:
            answers: Answer of each process: None if it shared its infos, else the infos.
            parts: Worlds of each process.
        """
        infos = self._copy()
        if all(one is None for one in answers):
            return infos
        each = zip(answers, parts, strict=True)
        full = [one or {name: every[part] for name, every in infos.items()} for one, part in each]
        return merge_infos(parts, full, len(self._array))

    def _copy(self) -> Infos:
        array, types = self._array[:, : len(self._types)].copy(), self._types
        return lazy_infos(
            lambda: {name: array[:, k].astype(kind) for k, (name, kind) in enumerate(types.items())}
        )


def merge_infos(parts: list[slice], infos: list[dict[str, Any]], num_envs: int) -> dict[str, Any]:
    """Merge the infos of several processes.

    Args:
        parts: Worlds of each process.
        infos: Infos of each process.
        num_envs: Total number of worlds.

    Returns:
        Infos of all worlds. Worlds of a process without an entry (final ones) have zeros.
    """
    whole: dict[str, Any] = {}
    for name in dict.fromkeys(name for info in infos for name in info):
        given = [
            (part, info[name]) for part, info in zip(parts, infos, strict=True) if name in info
        ]
        first = given[0][1]
        if isinstance(first, dict):
            own_parts = [part for part, _ in given]
            own_infos = [value for _, value in given]
            whole[name] = merge_infos(own_parts, own_infos, num_envs)
            continue
        shape = (num_envs, *first.shape[1:])
        whole[name] = np.zeros(shape, dtype=first.dtype)
        for part, value in given:
            whole[name][part] = value
    return whole
