"""Snapshots: the complete state of worlds as bytes, which can be stored, sent and restored."""

import hashlib
import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from bulletuav.contact.contact_log import MAX_LOGGED_CONTACTS
from bulletuav.contact.warm_start import MAX_CACHED_POINTS
from bulletuav.dynamics.divergence import FASTEST, FASTEST_SPIN
from bulletuav.envs.descriptions import canonical_text
from bulletuav.envs.rows import Rows
from bulletuav.errors import shown
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm

BODIES, BODIES_SIZE = "bodies", 8
"""Array (W,) uint64 that identifies the added bodies; the first array of a snapshot"""
GENERATOR_SIZE = 37
"""Size of the state of a random generator, bytes"""
CHECKSUM_SIZE = 16
"""Size of a checksum, bytes"""
UNSTARTED = np.random.default_rng(0)
"""Generator of worlds before their first reset; it is never used"""
Fields = Mapping[str, np.ndarray]
"""Arrays (W, ...) by name"""


Bounds = Mapping[str, tuple[Any, Any]]
"""Lowest and highest value of arrays by name; "name.field" if rows have fields"""
QUATERNION_TOLERANCE = 1e-6
"""Tolerance of the components of a quaternion"""
MAX_ROTOR_SPEED = 1e6
"""Maximum rotor speed, rad/s"""
MAX_COORDINATE = 1e7
"""Maximum distance of a drone from its world's origin, m; diverging flights end before"""
SNAPSHOT_FIELDS = ("data", "form", "checksum")
"""Fields of a pickled snapshot"""
FORM_FIELDS = ("of", "parts", "arrays")
"""Fields of a pickled form"""
ENVIRONMENT_FIELDS = ("of", "flight", "beside", "checksum")
"""Fields of a pickled snapshot of an environment class"""
ANOTHER_VERSION = "the snapshot is of another version of bulletuav: save it again with this one"
MAX_LISTED = 8
"""Maximum number of differences that a message lists"""


@dataclass(frozen=True)
class Form:
    """Description of the simulation that a snapshot was saved from.

    Attributes:
        of: Kind of simulation, such as "environment of 'crossing'".
        parts: Descriptions of the components, by name; see `descriptions.describe_parts`.
        arrays: Name, type and shape of each array of a world.
    """

    of: str
    parts: Mapping[str, str]
    arrays: tuple[tuple[str, str, tuple[int, ...]], ...]

    @cached_property
    def digest(self) -> bytes:
        """Hash of all attributes."""
        text = repr((self.of, sorted(self.parts.items()), self.arrays))
        return hashlib.blake2b(text.encode(), digest_size=CHECKSUM_SIZE).digest()

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the cached hash, which is computed again."""
        return {"of": self.of, "parts": dict(self.parts), "arrays": self.arrays}

    def require(self, other: "Form") -> None:
        """Raise ValueError with the names of the differences unless the other form is equal."""
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
    """Check that a snapshot was saved from the same components.

    Args:
        form: Form of the snapshot.
        parts: Descriptions of the components here, see `descriptions.describe_parts`.
        of: Kind of simulation here.

    Raises:
        ValueError: If components differ; the message lists the names and both values.
    """
    every = dict.fromkeys((*parts, *form.parts))
    names = [name for name in every if parts.get(name) != form.parts.get(name)]
    # With another task or airframe most other components differ, too
    names = [name for name in names if name.partition(".")[0] not in {*names} - {name}]
    names = ["task"] if "task" in names else names
    if not names:
        return
    missing = "missing"
    differ = [
        f"{name} is {form.parts.get(name, missing)} in the snapshot and "
        f"{parts.get(name, missing)} here"
        for name in names[:MAX_LISTED]
    ]
    if len(names) > MAX_LISTED:
        differ.append(f"others are {', '.join(names[MAX_LISTED:])}")
    raise ValueError(
        f"the snapshot is of another simulation than this {of}: {'; '.join(differ)}; load it "
        f"where these are the same"
    )


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of S worlds, from `save_state`; it can be pickled.

    The bytes are read-only. A snapshot of this process is loaded without further checks. A pickled
    one has a checksum, and is checked when it is loaded.

    Attributes:
        data: (S, B) uint8, read-only.
        form: Description of the simulation.
        checksum: Hash of both; None for a snapshot of this process.
    """

    data: np.ndarray
    form: Form
    checksum: bytes | None = None

    def __post_init__(self) -> None:
        """Copy the bytes, so that they cannot change after they were checked."""
        # `require_whole` raises for arrays of objects, which have no bytes
        if isinstance(self.data, np.ndarray) and not self.data.dtype.hasobject:
            copied = np.frombuffer(self.data.tobytes(), self.data.dtype)
            object.__setattr__(self, "data", copied.reshape(self.data.shape))

    def __len__(self) -> int:
        """Return the number of worlds."""
        self._require_kinds()
        return len(self.data)

    def __getitem__(self, worlds: int | slice | list[int] | np.ndarray) -> "Snapshot":
        """Select worlds, in the order of their indices; an index may be repeated."""
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
        """Return the pickled fields, with a checksum."""
        self._require_kinds()
        checksum = checksum_of(self.data, self.form) if self.is_own else self.checksum
        return dict(zip(SNAPSHOT_FIELDS, (self.data, self.form, checksum), strict=True))

    def __setstate__(self, state: Any) -> None:
        """Set the pickled fields, which are checked when the snapshot is loaded."""
        if not isinstance(state, dict) or tuple(state) != SNAPSHOT_FIELDS:
            raise ValueError(ANOTHER_VERSION)
        for name, value in state.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    @property
    def is_own(self) -> bool:
        """Whether it was saved in this process, so that its bytes cannot have changed."""
        return "_own" in vars(self)

    def require_whole(self) -> None:
        """Raise ValueError for a snapshot that is damaged or was constructed by hand."""
        if "_own" in vars(self) or "_whole" in vars(self):
            return
        self._require_kinds()
        if self.checksum != checksum_of(self.data, self.form):
            raise ValueError(
                "the snapshot is damaged: its checksum is not that of its bytes; use another "
                "copy, or save it again"
            )
        object.__setattr__(self, "_whole", True)

    def _require_kinds(self) -> None:
        """Raise ValueError if an attribute is missing or has another type."""
        if self.is_own:
            return
        # Objects that were constructed by hand may have no attributes
        data, form, checksum = map(vars(self).get, SNAPSHOT_FIELDS)
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
            f"the snapshot has {wrong}: a result of save_state of this version is needed; "
            f"save it again"
        )


def _is_form(form: Any) -> bool:
    """Return True for a `Form` whose attributes have valid types."""
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
    """Return True for the name, type and shape of an array."""
    return (
        isinstance(array, tuple)
        and tuple(map(type, array)) == (str, str, tuple)
        and all(isinstance(size, int) for size in array[2])
    )


def own_snapshot(data: np.ndarray, form: Form) -> Snapshot:
    """Create a snapshot of bytes (S, B) of this process, without a copy or checksum."""
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
    """Return the hash of the bytes (S, B) of a snapshot and its form."""
    text = repr((form.digest, data.shape)).encode()
    digest = hashlib.blake2b(text, digest_size=CHECKSUM_SIZE)
    digest.update(cast(Any, np.ascontiguousarray(data)))
    return digest.digest()


@dataclass(frozen=True, eq=False)
class EnvironmentSnapshot:
    """State of an environment class that has state in addition to its world.

    Attributes:
        of: Function that creates environments of the class, such as "aec_env".
        flight: State of the world.
        beside: Further state of the class, such as the agents' turns.
    """

    of: str
    flight: Snapshot
    beside: Mapping[str, Any]

    def __getstate__(self) -> dict[str, Any]:
        """Return the pickled fields, with a checksum."""
        self.require_kinds()
        own = {"of": self.of, "flight": self.flight, "beside": dict(self.beside)}
        return {**own, "checksum": self._checksum(own["beside"])}

    def __setstate__(self, state: Any) -> None:
        """Set the pickled fields.

        Raises:
            ValueError: If the snapshot is damaged, or of another version.
        """
        if not isinstance(state, dict) or tuple(state) != ENVIRONMENT_FIELDS:
            raise ValueError(ANOTHER_VERSION)
        if self._checksum(state["beside"]) != state["checksum"]:
            raise ValueError(
                f"the snapshot of {shown(state['of'])} is damaged: its checksum is not that of "
                f"its contents; use another copy, or save it again"
            )
        for name in ENVIRONMENT_FIELDS[:-1]:
            object.__setattr__(self, name, state[name])

    def require_kinds(self) -> None:
        """Raise ValueError if an attribute is missing or has another type."""
        kinds = dict(zip(ENVIRONMENT_FIELDS, (str, Snapshot, Mapping), strict=False))
        for name, kind in kinds.items():
            if not isinstance(value := vars(self).get(name), kind):
                raise ValueError(
                    f"the snapshot has {name} {shown(value)} instead of a {kind.__name__}: a "
                    f"result of save_state of this version is needed; save it again"
                )

    @staticmethod
    def _checksum(beside: Any) -> bytes:
        return hashlib.blake2b(canonical_text(beside).encode(), digest_size=CHECKSUM_SIZE).digest()


def require_snapshot(snapshot: Any, kind: type, worlds: int | None = 1) -> None:
    """Check that an object is an undamaged snapshot with the right number of worlds.

    Args:
        snapshot: Value of the argument.
        kind: `Snapshot` or `EnvironmentSnapshot`.
        worlds: Number of worlds that are written; None for any number.

    Raises:
        ValueError: If the object is something else, is damaged, or has another number of worlds.
    """
    if not isinstance(snapshot, kind):
        raise ValueError(f"snapshot is {shown(snapshot)}: a result of save_state is needed")
    if isinstance(snapshot, Snapshot):
        snapshot.require_whole()
        if worlds is not None and len(snapshot) != worlds:
            raise ValueError(
                f"the snapshot has {len(snapshot)} worlds, and {worlds} are to be written: "
                f"choose some of them, snapshot[0], or list the worlds"
            )


def require_environment_snapshot(
    snapshot: Any, of: str, names: Collection[str] | None = None
) -> None:
    """Check that an object is a snapshot of a class of environments.

    Args:
        snapshot: Value of the argument.
        of: Function that creates environments of the class.
        names: Names in `beside`; None for any.

    Raises:
        ValueError: If the object is something else, is damaged, or is of another class.
    """
    require_snapshot(snapshot, EnvironmentSnapshot)
    snapshot.require_kinds()
    if snapshot.of != of:
        raise ValueError(
            f"the snapshot is of {snapshot.of}, and this is of {of}: load it in its own class"
        )
    differ: set[str] = set() if names is None else set(names) ^ set(snapshot.beside)
    if differ:
        raise ValueError(
            f"the snapshot of {of} lacks {shown(sorted(differ, key=repr))}, or must not have them: "
            f"save it again with this version"
        )


def state_bounds(swarm: Swarm) -> dict[str, tuple[float, float]]:
    """Return the bounds of the state of drones, and of parameters that index rotors."""
    return {
        "position": (-MAX_COORDINATE, MAX_COORDINATE),
        "quaternion": (-1.0 - QUATERNION_TOLERANCE, 1.0 + QUATERNION_TOLERANCE),
        "velocity": (-FASTEST, FASTEST),
        "rates": (-FASTEST_SPIN, FASTEST_SPIN),
        "rotor_speed": (0.0, MAX_ROTOR_SPEED),
        "deflection": (-math.pi, math.pi),
        "parameters.num_rotors": (0, swarm.rotor_speed.shape[-1]),
    }


def contact_bounds(scenery: Scenery) -> dict[str, tuple[float, float]]:
    """Return the bounds of counts and of shape indices in the contact cache."""
    shapes = (0, scenery.ground)
    return {
        **dict.fromkeys(("slept number", "touches number"), (0, MAX_LOGGED_CONTACTS)),
        **dict.fromkeys(("slept other", "touches other"), shapes),
        "memory number": (0, MAX_CACHED_POINTS),
        "memory rows.other": shapes,
    }


def require_contacts(contacts: str | None) -> None:
    """Raise ValueError for contacts whose state cannot be saved."""
    if contacts == "bullet":
        raise ValueError(
            "contacts='bullet' has no snapshots, as Bullet does not expose its contact cache: "
            "choose contacts='impulse'"
        )


def arrays_of(fields: Fields) -> tuple[tuple[str, str, tuple[int, ...]], ...]:
    """Return name, type and shape of the arrays of a world."""
    return tuple((name, str(one.dtype), one.shape[1:]) for name, one in fields.items())


def pack_worlds(fields: Fields, rngs: list[np.random.Generator], worlds: np.ndarray) -> np.ndarray:
    """Copy worlds (S,) of all arrays, and their random generators, into bytes (S, B)."""
    rows = _rows(worlds)
    parts = [_bytes_of(array[rows]) for array in fields.values() if array.size]
    states = b"".join(_generator_bytes(rngs[w]) for w in worlds.tolist())
    parts.append(np.frombuffer(states, np.uint8).reshape(len(worlds), GENERATOR_SIZE))
    return np.concatenate(parts, axis=1)


def unpack_worlds(
    data: np.ndarray, fields: Fields, rngs: list[np.random.Generator], worlds: np.ndarray
) -> None:
    """Write bytes (S, B) to worlds (S,) of all arrays, and to their random generators."""
    at, rows = 0, _rows(worlds)
    for array in fields.values():
        if array.size:
            size = array[0].nbytes
            part = np.ascontiguousarray(data[:, at : at + size])
            array[rows] = part.view(array.dtype).reshape(len(worlds), *array.shape[1:])
            at += size
    for w, row in zip(worlds.tolist(), data[:, at:], strict=True):
        _restore(rngs, w, row.tobytes())


class SnapshotLayout:
    """Layout of arrays in the bytes of a snapshot.

    Inspecting 80 arrays takes longer than copying them. So it is done once, and again if an array
    was replaced; see `Parts.layout`.

    Attributes:
        form: Form that snapshots must have.
    """

    def __init__(self, of: str, parts: Mapping[str, str], bounds: Bounds, fields: Fields) -> None:
        """Inspect the arrays.

        Args:
            of: See `Form`, like the parts.
            parts: Descriptions of the simulation's components.
            bounds: Bounds of arrays, such as indices and counts.
            fields: The arrays (W, ...) by name.
        """
        self._fields, self._bounds = dict(fields), dict(bounds)
        self.form = Form(of, parts, arrays_of(fields))
        self._rows: Rows | None = None
        self._is_known = False

    def require(self, snapshot: Snapshot, worlds: np.ndarray) -> None:
        """Check everything that would be written to worlds (S,), without writing it.

        Raises:
            ValueError: If the snapshot does not fit.
        """
        self.form.require(snapshot.form)
        # The first array of every layout
        here = self._fields[BODIES][worlds].view(np.uint8).reshape(len(worlds), BODIES_SIZE)
        if not np.array_equal(snapshot.data[:, :BODIES_SIZE], here):
            raise ValueError(
                "the snapshot is of worlds with other bodies: add the same bodies, in the same "
                "order, before it is loaded"
            )
        # Checked once, as its bytes cannot change
        known = vars(snapshot)
        if not snapshot.is_own and known.get("_within") is not self._bounds:
            self._check(snapshot.data)
            object.__setattr__(snapshot, "_within", self._bounds)

    def _check(self, data: np.ndarray) -> None:
        """Check the bytes (S, B) of a foreign snapshot against all bounds."""
        size = (
            sum(array[0].nbytes for array in self._fields.values() if array.size) + GENERATOR_SIZE
        )
        if data.shape[1] != size:
            raise ValueError(
                f"the snapshot has {data.shape[1]} bytes per world, not {size}: it is truncated"
            )
        for name, values in _columns(data, self._fields):
            bounds = self._bounds.get(name)
            if values.dtype == bool:
                values, bounds = values.view(np.uint8), (0, 1)
            if bounds is None:
                continue
            # Written so that NaN is out of bounds
            low, high = bounds
            wrong = ~((values >= low) & (values <= high))
            if wrong.any():
                low, high = (np.broadcast_to(one, values.shape)[wrong][0] for one in bounds)
                raise ValueError(
                    f"the snapshot has {name} {values[wrong][0]:g}: from {low:g} to {high:g} is "
                    f"needed; it is damaged"
                )
        if (data[:, 32 - GENERATOR_SIZE] > 1).any() or not (data[:, 16 - GENERATOR_SIZE] % 2).all():
            raise ValueError("the snapshot has no valid state of a random generator: it is damaged")

    def pack_worlds(self, rngs: list[np.random.Generator], worlds: np.ndarray) -> np.ndarray:
        """Copy worlds (S,) of all arrays, and their random generators; see the function."""
        rows = self._chosen(worlds)
        if rows is None:
            return pack_worlds(self._fields, rngs, worlds)
        rows.gather.run()
        size = rows.data.shape[1]
        data = np.empty((len(worlds), size + GENERATOR_SIZE), dtype=np.uint8)
        data[np.argsort(worlds), :size] = rows.data[: len(worlds)]
        for row, w in zip(data, worlds.tolist(), strict=True):
            row[size:].data[:] = _generator_bytes(rngs[w])
        return data

    def unpack_worlds(
        self, data: np.ndarray, rngs: list[np.random.Generator], worlds: np.ndarray
    ) -> None:
        """Write bytes (S, B) to worlds (S,) of all arrays; see the function."""
        rows = self._chosen(worlds)
        if rows is None:
            unpack_worlds(data, self._fields, rngs, worlds)
            return
        size = rows.data.shape[1]
        rows.data[: len(worlds)] = data[np.argsort(worlds), :size]
        rows.scatter.run()
        for row, w in zip(data, worlds.tolist(), strict=True):
            _restore(rngs, w, row[size:].tobytes())

    def _chosen(self, worlds: np.ndarray) -> Rows | None:
        """Select worlds (S,) of the row buffer; None if arrays are copied one by one."""
        if self._rows is None and self._is_known:
            filled = [array for array in self._fields.values() if array.size]
            if all(array.flags.c_contiguous for array in filled):
                self._rows = Rows(filled)
        # A program is compiled only for a layout that is used again
        self._is_known = True
        if self._rows is not None:
            self._rows.mask[:] = False
            self._rows.mask[worlds] = True
        return self._rows


def _columns(data: np.ndarray, fields: Fields) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the values of each array in bytes (S, B), with each field of rows separately."""
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


def hash_array_rows(data: Iterable[np.ndarray]) -> tuple[str, ...]:
    """Return the hash of each row of bytes."""
    return tuple(hashlib.blake2b(row.tobytes(), digest_size=16).hexdigest() for row in data)


def _rows(worlds: np.ndarray) -> slice | np.ndarray:
    """Index worlds (S,), by a slice if they are consecutive, which is several times as fast."""
    first = int(worlds[0]) if len(worlds) else 0
    side_by_side = np.array_equal(worlds, np.arange(first, first + len(worlds)))
    return slice(first, first + len(worlds)) if side_by_side else worlds


def _bytes_of(rows: np.ndarray) -> np.ndarray:
    flat = np.ascontiguousarray(rows).reshape(len(rows), math.prod(rows.shape[1:]))
    return flat.view(np.uint8)


def _generator_bytes(rng: np.random.Generator) -> bytes:
    """Return the state of a generator of `default_rng`. Raises ValueError for others."""
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
    """Set the state of a world's generator from the bytes of `_generator_bytes`."""
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
