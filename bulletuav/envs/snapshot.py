"""Snapshots: all that makes the future of worlds, as bytes that can be kept, sent and put back."""

import hashlib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from bulletuav.contact.contact_log import MAX_LOGGED_CONTACTS
from bulletuav.contact.warm_start import MAX_CACHED_POINTS
from bulletuav.dynamics.divergence import FASTEST, FASTEST_SPIN
from bulletuav.envs.described import text_of
from bulletuav.envs.rows import Rows
from bulletuav.errors import shown
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

BODIES, BODIES_BYTES = "bodies", 8
"""Array (W,) uint64 that differs where other bodies were added; the first one of a snapshot"""
GENERATOR = 37
"""Bytes of the state of a random generator"""
CHECKSUM = 16
"""Bytes of a checksum"""
UNSTARTED = np.random.default_rng(0)
"""Generator of worlds before their first reset; nothing draws from it"""
Fields = Mapping[str, np.ndarray]
"""Arrays (W, ...) by name"""


Bounds = Mapping[str, tuple[Any, Any]]
"""Lowest and highest value of arrays by name; "name.field" where rows have fields"""
UNIT = 1e-6
"""Rounding of the components of a quaternion"""
MAX_ROTOR_SPEED = 1e6
"""Speed of a rotor, rad/s"""
MAX_COORDINATE = 1e7
"""Distance of a drone from its world's origin, m; flights that diverge end before"""
FIRST_FIELDS = ("data", "form", "checksum")
"""What a pickled snapshot consists of"""
FORM_FIELDS = ("of", "parts", "arrays")
"""The same of its form"""
FACE_FIELDS = ("of", "flight", "beside", "checksum")
"""The same of one of an environment class"""
ANOTHER_VERSION = "the snapshot is of another version of bulletuav: save it again with this one"
MOST_NAMED = 8
"""Differences that a message lists"""


@dataclass(frozen=True)
class Form:
    """What a snapshot was saved from.

    Attributes:
        of: What kind of thing, such as "environment of 'crossing'".
        parts: A text for everything that it is made from, by name; see `described.parts_of`.
        arrays: Name, type and shape of each array of a world.
    """

    of: str
    parts: Mapping[str, str]
    arrays: tuple[tuple[str, str, tuple[int, ...]], ...]

    @cached_property
    def digest(self) -> bytes:
        """Hash of all of it."""
        text = repr((self.of, sorted(self.parts.items()), self.arrays))
        return hashlib.blake2b(text.encode(), digest_size=CHECKSUM).digest()

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes alone: the hash is computed again from what arrives."""
        return {"of": self.of, "parts": dict(self.parts), "arrays": self.arrays}

    def require(self, other: "Form") -> None:
        """Raise ValueError with the names of the differences unless the other is the same."""
        if self is other or self.digest == other.digest:
            return
        require_parts(other, self.parts, self.of)
        mine, theirs = set(self.arrays), set(other.arrays)
        arrays = dict.fromkeys(name for name, *_ in sorted(mine ^ theirs, key=repr))
        raise ValueError(
            f"the snapshot is of another simulation than this {self.of}: its state has other "
            f"arrays ({', '.join(arrays)}); load it where the sensors and dynamics are the same"
        )


def require_parts(form: Form, parts: Mapping[str, str], of: str) -> None:
    """Refuse what was saved from other parts than there are here.

    Args:
        form: What the snapshot was saved from.
        parts: What there is here, see `described.parts_of`.
        of: What kind of thing this is.

    Raises:
        ValueError: They differ; the names and both values are listed.
    """
    every = dict.fromkeys((*parts, *form.parts))
    names = [name for name in every if parts.get(name) != form.parts.get(name)]
    # With another task or airframe most of the rest differs, too
    names = [name for name in names if name.partition(".")[0] not in {*names} - {name}]
    names = ["task"] if "task" in names else names
    if not names:
        return
    missing = "not there"
    differ = [
        f"{name} is {form.parts.get(name, missing)} in the snapshot and "
        f"{parts.get(name, missing)} here"
        for name in names[:MOST_NAMED]
    ]
    if len(names) > MOST_NAMED:
        differ.append(f"others are {', '.join(names[MOST_NAMED:])}")
    raise ValueError(
        f"the snapshot is of another simulation than this {of}: {'; '.join(differ)}; load it "
        f"where these are the same"
    )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of S worlds, as `save_state` gives it. It can be pickled, and sent to others.

    The bytes are read-only. A snapshot of this process is known to be whole and is loaded without a
    second look. One that was pickled carries a checksum, and is checked when it is loaded.

    Attributes:
        data: (S, B) uint8, read-only.
        form: What it was saved from.
        checksum: Hash of both; None for a snapshot of this process.
    """

    data: np.ndarray
    form: Form
    checksum: bytes | None = None

    def __post_init__(self) -> None:
        """Copy the bytes, so that what is checked stays as it is."""
        # Arrays of objects have no bytes; `require_whole` refuses them
        if isinstance(self.data, np.ndarray) and not self.data.dtype.hasobject:
            copied = np.frombuffer(self.data.tobytes(), self.data.dtype)
            object.__setattr__(self, "data", copied.reshape(self.data.shape))

    def __len__(self) -> int:
        """Count its worlds."""
        self._require_kinds()
        return len(self.data)

    def __getitem__(self, worlds: int | slice | list[int] | np.ndarray) -> "Snapshot":
        """Take some of its worlds, in the order of their indices, also several times."""
        self.require_whole()
        chosen = [worlds] if isinstance(worlds, int | np.integer) else worlds
        data = self.data[chosen]
        if data.ndim != 2 or isinstance(worlds, bool):
            raise IndexError(
                f"worlds of a snapshot are {shown(worlds)}: a whole number, a slice, or a list of "
                f"whole numbers is needed"
            )
        if self.is_own:
            return own_snapshot(data, self.form)
        return Snapshot(data, self.form, checksum_of(data, self.form))

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled, with a checksum."""
        self._require_kinds()
        checksum = checksum_of(self.data, self.form) if self.is_own else self.checksum
        return dict(zip(FIRST_FIELDS, (self.data, self.form, checksum), strict=True))

    def __setstate__(self, state: Any) -> None:
        """Take what was pickled; it is checked when it is loaded."""
        if not isinstance(state, dict) or tuple(state) != FIRST_FIELDS:
            raise ValueError(ANOTHER_VERSION)
        for name, value in state.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @property
    def is_own(self) -> bool:
        """Whether it was saved in this process, and its bytes cannot have changed."""
        return "_own" in vars(self)

    def require_whole(self) -> None:
        """Raise ValueError for a snapshot that is damaged, or that was put together by hand."""
        if "_own" in vars(self) or "_whole" in vars(self):
            return
        self._require_kinds()
        if self.checksum != checksum_of(self.data, self.form):
            raise ValueError(
                "the snapshot is damaged: its checksum is not that of its bytes; take another "
                "copy, or save it again"
            )
        object.__setattr__(self, "_whole", True)

    def _require_kinds(self) -> None:
        """Raise ValueError where an attribute is missing, or is of another type."""
        if self.is_own:
            return
        # Objects that were put together by hand may have no attributes at all
        data, form, checksum = map(vars(self).get, FIRST_FIELDS)
        if not isinstance(data, np.ndarray) or data.dtype != np.uint8 or data.ndim != 2:
            found = shown(data)
            if isinstance(data, np.ndarray):
                found = f"{data.shape} {data.dtype}"
            wrong = f"data {found} instead of (S, B) uint8"
        elif not _is_form(form):
            wrong = f"form {shown(form)}"
        elif not isinstance(checksum, bytes | None):
            wrong = f"checksum {shown(checksum)} instead of bytes"
        else:
            return
        raise ValueError(
            f"the snapshot has {wrong}: one as save_state of this version gives is needed; "
            f"save it again"
        )


def _is_form(form: Any) -> bool:
    """Return True for a `Form` whose attributes have the types that they need."""
    if not isinstance(form, Form):
        return False
    of, parts, arrays = map(vars(form).get, FORM_FIELDS)
    return (
        isinstance(of, str)
        and isinstance(parts, Mapping)
        and all(isinstance(text, str) for pair in parts.items() for text in pair)
        and isinstance(arrays, tuple)
        and all(map(_is_array_form, arrays))
    )


def _is_array_form(array: Any) -> bool:
    """Return True for name, type and shape of an array."""
    return (
        isinstance(array, tuple)
        and tuple(map(type, array)) == (str, str, tuple)
        and all(isinstance(size, int) for size in array[2])
    )


def own_snapshot(data: np.ndarray, form: Form) -> Snapshot:
    """Make a snapshot of bytes (S, B) that this process just wrote, without a copy or checksum."""
    snapshot = object.__new__(Snapshot)
    # A view of read-only memory cannot be made writeable again
    fields = {
        "data": np.asarray(memoryview(cast(Any, data)).toreadonly()),
        "form": form,
        "checksum": None,
    }
    for name, value in fields.items():
        object.__setattr__(snapshot, name, value)
    object.__setattr__(snapshot, "_own", True)
    return snapshot


def checksum_of(data: np.ndarray, form: Form) -> bytes:
    """Hash the bytes (S, B) of a snapshot, with what it was saved from."""
    text = repr((form.digest, data.shape)).encode()
    digest = hashlib.blake2b(text, digest_size=CHECKSUM)
    digest.update(cast(Any, np.ascontiguousarray(data)))
    return digest.digest()


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

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled, with a checksum."""
        self.require_kinds()
        own = {"of": self.of, "flight": self.flight, "beside": dict(self.beside)}
        return {**own, "checksum": self._checksum(own["beside"])}

    def __setstate__(self, state: Any) -> None:
        """Take what was pickled.

        Raises:
            ValueError: It is damaged, or of another version.
        """
        if not isinstance(state, dict) or tuple(state) != FACE_FIELDS:
            raise ValueError(ANOTHER_VERSION)
        if self._checksum(state["beside"]) != state["checksum"]:
            raise ValueError(
                f"the snapshot of {shown(state['of'])} is damaged: its checksum is not that of "
                f"what it holds; take another copy, or save it again"
            )
        for name in FACE_FIELDS[:-1]:
            object.__setattr__(self, name, state[name])

    def require_kinds(self) -> None:
        """Raise ValueError where an attribute is missing, or is of another type."""
        kinds = dict(zip(FACE_FIELDS, (str, Snapshot, Mapping), strict=False))
        for name, kind in kinds.items():
            if not isinstance(value := vars(self).get(name), kind):
                raise ValueError(
                    f"the snapshot has {name} {shown(value)} instead of a {kind.__name__}: one as "
                    f"save_state of this version gives is needed; save it again"
                )

    @staticmethod
    def _checksum(beside: Any) -> bytes:
        return hashlib.blake2b(text_of(beside).encode(), digest_size=CHECKSUM).digest()


def require_snapshot(snapshot: Any, kind: type, worlds: int | None = 1) -> None:
    """Refuse what is no snapshot of a kind, a damaged one, or one of another number of worlds.

    Args:
        snapshot: What was given.
        kind: `Snapshot` or `FaceSnapshot`.
        worlds: How many worlds are to be written; None for any number.

    Raises:
        ValueError: It is something else, is damaged, or holds more or fewer of them.
    """
    if not isinstance(snapshot, kind):
        raise ValueError(f"snapshot is {shown(snapshot)}: what save_state gave is needed")
    if isinstance(snapshot, Snapshot):
        snapshot.require_whole()
        if worlds is not None and len(snapshot) != worlds:
            raise ValueError(
                f"the snapshot holds {len(snapshot)} worlds, and {worlds} are to be written: "
                f"take some of them, snapshot[0], or name the worlds"
            )


def require_face(snapshot: Any, of: str, names: Collection[str] | None = None) -> None:
    """Refuse what is no snapshot of a class of environments.

    Args:
        snapshot: What was given.
        of: What makes environments of the class.
        names: What `beside` consists of; anything when left out.

    Raises:
        ValueError: It is something else, is damaged, or is of another class.
    """
    require_snapshot(snapshot, FaceSnapshot)
    snapshot.require_kinds()
    if snapshot.of != of:
        raise ValueError(
            f"the snapshot is of {snapshot.of}, and this is of {of}: load it in its own class"
        )
    differ: set[str] = set() if names is None else set(names) ^ set(snapshot.beside)
    if differ:
        raise ValueError(
            f"the snapshot of {of} lacks {shown(sorted(differ, key=repr))}, or has them in excess: "
            f"save it again with this version"
        )


def state_bounds(swarm: Swarm) -> dict[str, tuple[float, float]]:
    """Return the bounds of the state of drones, and of the parameters that index rotors."""
    return {
        "position": (-MAX_COORDINATE, MAX_COORDINATE),
        "quaternion": (-1.0 - UNIT, 1.0 + UNIT),
        "velocity": (-FASTEST, FASTEST),
        "rates": (-FASTEST_SPIN, FASTEST_SPIN),
        "rotor_speed": (0.0, MAX_ROTOR_SPEED),
        "parameters.num_rotors": (0, swarm.rotor_speed.shape[-1]),
    }


def contact_bounds(scenery: Scenery) -> dict[str, tuple[float, float]]:
    """Return the bounds of counts, and of numbers of shapes, that contacts remember."""
    shapes = (0, scenery.ground)
    return {
        **dict.fromkeys(("slept number", "touches number"), (0, MAX_LOGGED_CONTACTS)),
        **dict.fromkeys(("slept other", "touches other"), shapes),
        "memory number": (0, MAX_CACHED_POINTS),
        "memory rows.other": shapes,
    }


def require_contacts(contacts: str | None) -> None:
    """Refuse contacts of which nothing can be saved. Raises ValueError."""
    if contacts == "bullet":
        raise ValueError(
            "contacts='bullet' has no snapshots, as Bullet keeps its contacts to itself: "
            "choose contacts='impulse'"
        )


def arrays_of(fields: Fields) -> tuple[tuple[str, str, tuple[int, ...]], ...]:
    """List name, type and shape of the arrays of a world."""
    return tuple((name, str(one.dtype), one.shape[1:]) for name, one in fields.items())


def pack(fields: Fields, rngs: list[np.random.Generator], worlds: np.ndarray) -> np.ndarray:
    """Copy worlds (S,) of all arrays, and their random generators, into bytes (S, B)."""
    rows = _rows(worlds)
    parts = [_bytes_of(array[rows]) for array in fields.values() if array.size]
    states = b"".join(_generator_bytes(rngs[w]) for w in worlds.tolist())
    parts.append(np.frombuffer(states, np.uint8).reshape(len(worlds), GENERATOR))
    return np.concatenate(parts, axis=1)


def unpack(
    data: np.ndarray, fields: Fields, rngs: list[np.random.Generator], worlds: np.ndarray
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
    them was replaced; see `Parts.layout`.

    Attributes:
        form: What snapshots have to fit.
    """

    def __init__(self, of: str, parts: Mapping[str, str], bounds: Bounds, fields: Fields) -> None:
        """Look at arrays.

        Args:
            of: See `Form`, like the parts.
            parts: What the simulation is made from.
            bounds: Of arrays that are indices, counts or the like.
            fields: The arrays (W, ...) by name.
        """
        self._fields, self._bounds = dict(fields), dict(bounds)
        self.form = Form(of, parts, arrays_of(fields))
        self._rows: Rows | None = None
        self._is_known = False

    def require(self, snapshot: Snapshot, worlds: np.ndarray) -> None:
        """Check everything that is to be written to worlds (S,), before any of it is.

        Raises:
            ValueError: The snapshot does not fit.
        """
        self.form.require(snapshot.form)
        # The first array of every layout
        here = self._fields[BODIES][worlds].view(np.uint8).reshape(len(worlds), BODIES_BYTES)
        if not np.array_equal(snapshot.data[:, :BODIES_BYTES], here):
            raise ValueError(
                "the snapshot is of worlds in which other bodies stand: add the same bodies, in "
                "the same order, before it is loaded"
            )
        # Looked at once: its bytes cannot change
        known = vars(snapshot)
        if not snapshot.is_own and known.get("_within") is not self._bounds:
            self._check(snapshot.data)
            object.__setattr__(snapshot, "_within", self._bounds)

    def _check(self, data: np.ndarray) -> None:
        """Check the bytes (S, B) of a snapshot that comes from elsewhere against all bounds."""
        size = sum(array[0].nbytes for array in self._fields.values() if array.size) + GENERATOR
        if data.shape[1] != size:
            raise ValueError(
                f"the snapshot has {data.shape[1]} bytes a world: {size} are needed; it is cut off"
            )
        for name, values in _columns(data, self._fields):
            bounds = self._bounds.get(name)
            if values.dtype == bool:
                values, bounds = values.view(np.uint8), (0, 1)
            if bounds is None:
                continue
            # NaN is within no bounds
            low, high = bounds
            wrong = ~((values >= low) & (values <= high))
            if wrong.any():
                low, high = (np.broadcast_to(one, values.shape)[wrong][0] for one in bounds)
                raise ValueError(
                    f"the snapshot has {name} {values[wrong][0]:g}: from {low:g} to {high:g} is "
                    f"needed; it is damaged"
                )
        if (data[:, 32 - GENERATOR] > 1).any() or not (data[:, 16 - GENERATOR] % 2).all():
            raise ValueError("the snapshot has no state of a random generator: it is damaged")

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

    def unpack(self, data: np.ndarray, rngs: list[np.random.Generator], worlds: np.ndarray) -> None:
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


def _columns(data: np.ndarray, fields: Fields) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the values of each array in bytes (S, B), each field of rows by itself."""
    at = 0
    for name, array in fields.items():
        if not array.size:
            continue
        size = array[0].nbytes
        values = np.ascontiguousarray(data[:, at : at + size]).view(array.dtype)
        values = values.reshape(len(data), *array.shape[1:])
        at += size
        if array.dtype.names is None:
            yield name, values
        for field in array.dtype.names or ():
            yield f"{name}.{field}", np.ascontiguousarray(values[field])


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


def _restore(rngs: list[np.random.Generator], world: int, data: bytes) -> None:
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
