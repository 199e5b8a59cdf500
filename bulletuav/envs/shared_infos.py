"""Infos of steps in memory that processes share, so that none of them is sent."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bulletuav.envs.infos import Infos, later, untold
from bulletuav.envs.results import INFOS

MORE = 16
"""How many infos of tasks, sensors and what is uncertain have room beside the usual ones"""
TYPES = tuple(map(np.dtype, ("f8", "i8", "?")))
"""Types of infos that have room"""
EXACT = 2**53
"""Greatest whole number up to which a float64 holds all"""


def room_for(terms: int) -> int:
    """Tell for how many infos there has to be room, with so many reward terms."""
    return terms + len(INFOS) + MORE


class SharedInfos:
    """Infos of some worlds in a shared array; both sides know from the last reset what is where."""

    def __init__(self, array: np.ndarray) -> None:
        """Take the array.

        Args:
            array: (W, K, N) float64.
        """
        self._array = array
        self._types: dict[str, np.dtype[Any]] = {}

    def learn(self, infos: Mapping[str, Any]) -> None:
        """Note names and types of infos right after a reset, which each step has, too."""
        worlds, room, drones = self._array.shape
        fit = len(infos) <= room and all(
            isinstance(one, np.ndarray) and one.shape == (worlds, drones) and one.dtype in TYPES
            for one in infos.values()
        )
        self._types = {name: one.dtype for name, one in infos.items()} if fit else {}

    def put(self, infos: Mapping[str, Any]) -> bool:
        """Write infos of a step.

        Returns:
            Whether all are as those of the reset, and were written.
        """
        if not self._types:
            return False
        told, begin = untold(infos), 0
        # Numbers of a decision lie in a table, from which infos need not be made first
        if told is not None:
            rows = [k for k, (name, _) in enumerate(told.rows) if name is not None]
            names, begin = [told.rows[k][0] for k in rows], len(rows)
            if [*names, *told.more] != list(self._types):
                return False
            table = told.table if begin == len(told.table) else told.table[rows]
            self._array[:, :begin] = table.swapaxes(0, 1)
            infos = told.more
        elif list(infos) != list(self._types):
            return False
        others = zip(infos.values(), list(self._types.values())[begin:], strict=True)
        for k, (one, kind) in enumerate(others, begin):
            if one.dtype != kind or (kind.kind == "i" and np.abs(one).max(initial=0) > EXACT):
                return False
            self._array[:, k] = one
        return True

    def take(self, told: list[Any], parts: list[slice]) -> dict[str, Any]:
        """Copy the infos of a step; where all were put here, they are made when they are read.

        Args:
            told: What each process answered: None where it put its infos here, else the infos.
            parts: Worlds of each process.
        """
        infos = self._copy()
        if all(one is None for one in told):
            return infos
        each = zip(told, parts, strict=True)
        full = [one or {name: every[part] for name, every in infos.items()} for one, part in each]
        return merged(parts, full, len(self._array))

    def _copy(self) -> Infos:
        array, types = self._array[:, : len(self._types)].copy(), self._types
        return later(
            lambda: {name: array[:, k].astype(kind) for k, (name, kind) in enumerate(types.items())}
        )


def merged(parts: list[slice], infos: list[dict[str, Any]], num_envs: int) -> dict[str, Any]:
    """Merge infos of several processes.

    Args:
        parts: Worlds of each process.
        infos: Infos of each process.
        num_envs: How many worlds there are in all.

    Returns:
        Infos of all worlds. Where a process lacks an entry (final ones) its worlds have zeros.
    """
    whole: dict[str, Any] = {}
    for name in dict.fromkeys(name for info in infos for name in info):
        # Those that have the entry, and what it is in them.
        given = [
            (part, info[name]) for part, info in zip(parts, infos, strict=True) if name in info
        ]
        first = given[0][1]
        if isinstance(first, dict):
            own_parts = [part for part, _ in given]
            own_infos = [value for _, value in given]
            whole[name] = merged(own_parts, own_infos, num_envs)
            continue
        shape = (num_envs, *first.shape[1:])
        whole[name] = np.zeros(shape, dtype=first.dtype)
        for part, value in given:
            whole[name][part] = value
    return whole
