"""Snapshots: all that makes the future of worlds, as bytes that can be kept, sent and put back."""

import hashlib
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bulletuav.envs.rows import Rows
from bulletuav.errors import shown

GENERATOR = 37
"""Bytes of the state of a random generator"""
UNSTARTED = np.random.default_rng(0)
"""Generator of worlds before their first reset; nothing draws from it"""
Fields = Mapping[str, np.ndarray]
"""Arrays (W, ...) by name"""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of S worlds, as `save_state` gives it. It can be pickled, and sent to others.

    Attributes:
        data: (S, B) uint8.
        form: What it fits: a hash of the task's name and of the form of all arrays.
    """

    data: np.ndarray
    form: str

    def __len__(self) -> int:
        """Count its worlds."""
        return len(self.data)

    def __getitem__(self, worlds: int | slice | list[int] | np.ndarray) -> "Snapshot":
        """Take some of its worlds, in the order of their indices, also several times."""
        chosen = [worlds] if isinstance(worlds, int | np.integer) else worlds
        return Snapshot(self.data[chosen], self.form)


@dataclass(frozen=True, eq=False)
class FaceSnapshot:
    """The state of an environment class that keeps something beside its world.

    Attributes:
        of: What makes environments of the class, such as "aec_env".
        flight: The state of the world.
        beside: What else the class goes on from, such as whose turn it is.
    """

    of: str
    flight: Snapshot
    beside: Mapping[str, Any]


def require_snapshot(
    snapshot: Any,
    kind: type,
    worlds: int = 1,
) -> None:
    """Refuse what is no snapshot of a kind, or one of another number of worlds.

    Raises:
        ValueError: It is something else, or holds more or fewer of them.
    """
    if not isinstance(snapshot, kind):
        raise ValueError(f"snapshot is {shown(snapshot)}: what save_state gave is needed")
    if isinstance(snapshot, Snapshot) and len(snapshot) != worlds:
        raise ValueError(
            f"the snapshot holds {len(snapshot)} worlds, and {worlds} are to be written: "
            f"take some of them, snapshot[0], or name the worlds"
        )


def require_face(snapshot: Any, of: str) -> None:
    """Refuse what is no snapshot of a class of environments. Raises ValueError."""
    require_snapshot(snapshot, FaceSnapshot)
    if snapshot.of != of:
        raise ValueError(
            f"the snapshot is of {snapshot.of}, and this is of {of}: load it in its own class"
        )


def require_contacts(contacts: str | None) -> None:
    """Refuse contacts of which nothing can be saved. Raises ValueError."""
    if contacts == "bullet":
        raise ValueError(
            "contacts='bullet' has no snapshots, as Bullet keeps its contacts to itself: "
            "choose contacts='impulse'"
        )


def require_form(
    snapshot: Snapshot,
    form: str,
    of: str,
) -> None:
    """Refuse a snapshot of another form. Raises ValueError."""
    if snapshot.form != form:
        raise ValueError(
            f"the snapshot is of another task, or of other options, than this {of}: load it where "
            f"the options are those that it was saved with"
        )


def form_of(task: str, fields: Fields) -> str:
    """Hash what a snapshot has to fit: the task's name, and names, types and shapes of arrays."""
    return _form(task, tuple((name, one.dtype, one.shape[1:]) for name, one in fields.items()))


@lru_cache(maxsize=64)
def _form(task: str, told: tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]) -> str:
    """Hash names, types and shapes of arrays; kept, as it takes longer than the copying."""
    texts = [(name, kind.str, shape) for name, kind, shape in told]
    return hashlib.blake2b(repr((task, texts)).encode(), digest_size=8).hexdigest()


def pack(
    fields: Fields,
    rngs: list[np.random.Generator],
    worlds: np.ndarray,
) -> np.ndarray:
    """Copy worlds (S,) of all arrays, and their random generators, into bytes (S, B)."""
    rows = _rows(worlds)
    parts = [_bytes_of(array[rows]) for array in fields.values() if array.size]
    states = b"".join(_generator_bytes(rngs[w]) for w in worlds.tolist())
    parts.append(np.frombuffer(states, np.uint8).reshape(len(worlds), GENERATOR))
    return np.concatenate(parts, axis=1)


def unpack(
    data: np.ndarray,
    fields: Fields,
    rngs: list[np.random.Generator],
    worlds: np.ndarray,
) -> None:
    """Write bytes (S, B) back into worlds (S,) of all arrays, and of the random generators."""
    at, rows = 0, _rows(worlds)
    for array in fields.values():
        if array.size:
            size = array[0].nbytes
            part = np.ascontiguousarray(data[:, at : at + size])
            array[rows] = part.view(array.dtype).reshape(len(worlds), *array.shape[1:])
            at += size
    for w, row in zip(worlds.tolist(), data[:, at:], strict=True):
        _restore(rngs, w, row.tobytes())


class Layout:
    """Where arrays are in the bytes of a snapshot.

    To look at 80 arrays takes longer than to copy them. So it is done once, and again where one of
    them is another.

    Attributes:
        form: What snapshots have to fit; see `form_of`.
    """

    def __init__(self, task: str, fields: Fields) -> None:
        """Look at arrays (W, ...) by name."""
        self._fields, self.form = dict(fields), form_of(task, fields)
        self._rows: Rows | None = None
        self._is_known = False

    def is_of(self, fields: Fields) -> bool:
        """Tell whether these are the very arrays that it is of."""
        known = self._fields.values()
        return len(known) == len(fields) and all(map(operator.is_, known, fields.values()))

    def pack(self, rngs: list[np.random.Generator], worlds: np.ndarray) -> np.ndarray:
        """Copy worlds (S,) of all arrays, and their random generators; see `pack`."""
        rows = self._chosen(worlds)
        if rows is None:
            return pack(self._fields, rngs, worlds)
        rows.collect.run()
        size = rows.data.shape[1]
        data = np.empty((len(worlds), size + GENERATOR), dtype=np.uint8)
        data[np.argsort(worlds), :size] = rows.data[: len(worlds)]
        for row, w in zip(data, worlds.tolist(), strict=True):
            row[size:].data[:] = _generator_bytes(rngs[w])
        return data

    def unpack(
        self,
        data: np.ndarray,
        rngs: list[np.random.Generator],
        worlds: np.ndarray,
    ) -> None:
        """Write bytes (S, B) back into worlds (S,) of all; see `unpack`."""
        rows = self._chosen(worlds)
        if rows is None:
            unpack(data, self._fields, rngs, worlds)
            return
        size = rows.data.shape[1]
        rows.data[: len(worlds)] = data[np.argsort(worlds), :size]
        rows.spread.run()
        for row, w in zip(data, worlds.tolist(), strict=True):
            _restore(rngs, w, row[size:].tobytes())

    def _chosen(self, worlds: np.ndarray) -> Rows | None:
        """Choose worlds (S,) of rows; None where all arrays are looked at one by one."""
        if self._rows is None and self._is_known:
            filled = [array for array in self._fields.values() if array.size]
            if all(array.flags.c_contiguous for array in filled):
                self._rows = Rows(filled)
        # Only what is used again is worth a program
        self._is_known = True
        if self._rows is not None:
            self._rows.mask[:] = False
            self._rows.mask[worlds] = True
        return self._rows


def layout_of(
    known: Layout | None,
    task: str,
    fields: Fields,
) -> Layout:
    """Look at arrays, unless what is known is of them."""
    return known if known is not None and known.is_of(fields) else Layout(task, fields)


def hashes_of(data: np.ndarray) -> tuple[str, ...]:
    """Hash each row of bytes (S, B)."""
    return tuple(hashlib.blake2b(row.tobytes(), digest_size=16).hexdigest() for row in data)


def _rows(worlds: np.ndarray) -> slice | np.ndarray:
    """Index worlds (S,), by a slice where they stand side by side: several times as fast."""
    first = int(worlds[0]) if len(worlds) else 0
    side_by_side = np.array_equal(worlds, np.arange(first, first + len(worlds)))
    return slice(first, first + len(worlds)) if side_by_side else worlds


def _bytes_of(rows: np.ndarray) -> np.ndarray:
    flat = np.ascontiguousarray(rows).reshape(len(rows), math.prod(rows.shape[1:]))
    return flat.view(np.uint8)


def _generator_bytes(rng: np.random.Generator) -> bytes:
    """Write the state of a generator of `default_rng`. Raises ValueError for another one."""
    state = rng.bit_generator.state
    if state["bit_generator"] != "PCG64":
        raise ValueError(
            f"the random generator of a world is {shown(rng)}: one of np.random.default_rng is "
            f"needed for a snapshot"
        )
    numbers = (state["state"]["state"], state["state"]["inc"])
    parts = [number.to_bytes(16, "little") for number in numbers]
    parts.append(int(state["has_uint32"]).to_bytes(1, "little"))
    parts.append(int(state["uinteger"]).to_bytes(4, "little"))
    return b"".join(parts)


def _restore(
    rngs: list[np.random.Generator],
    world: int,
    data: bytes,
) -> None:
    """Bring a world's generator to the state that `_generator_bytes` wrote, or make one of it."""
    bits = rngs[world].bit_generator
    if rngs[world] is UNSTARTED or not isinstance(bits, np.random.PCG64):
        bits = np.random.PCG64()
        rngs[world] = np.random.Generator(bits)
    bits.state = {
        "bit_generator": "PCG64",
        "state": {
            "state": int.from_bytes(data[:16], "little"),
            "inc": int.from_bytes(data[16:32], "little"),
        },
        "has_uint32": data[32],
        "uinteger": int.from_bytes(data[33:37], "little"),
    }
