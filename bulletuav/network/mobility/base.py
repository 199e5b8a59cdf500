"""The interface of mobility models, and where their random numbers come from."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.errors import as_sequence, finite, shown
from bulletuav.kernel import func
from bulletuav.network.mobility.ground import Ground

MOST_SPEED, LONGEST = 100.0, 1e6
"""m/s, of users; s or m, of times and ways"""
State = Mapping[str, np.ndarray]
"""Of each array its name: in one world, or of W worlds with W as the first axis, float64"""
Generators = Sequence[np.random.Generator | None]


@dataclass(frozen=True)
class Mobility(ABC):
    """How U users walk in each of W worlds: always outdoors and in bounds, at the height that the ground tells.

    Its fields are its options. Raises ValueError for those that cannot be.

    name  what `find_mobility` calls it
    """

    name: ClassVar[str]

    def _keep(self, name: str, value: Any) -> None:
        """Store an option as its check gave it, so that kernels see one type of it."""
        object.__setattr__(self, name, value)

    def _size(self, name: str, unit: str, most: float, above_zero: bool) -> None:
        """Keep an option as a float. Raises ValueError unless it is at least 0, or above it, and at most `most`."""
        given = getattr(self, name)
        value = finite(name, given, most=most)
        if value < 0 or (above_zero and value == 0):
            raise ValueError(
                f"{name} is {given!r}{unit}: a number {'above' if above_zero else 'from'} 0 is needed"
            )
        self._keep(name, value)

    @property
    def max_speed(self) -> float:
        """No user is ever faster, m/s."""
        return 0.0

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Shapes in a world of `count` users: "users" (U, 3) m, "user_velocity" (U, 2) m/s, and what else is kept."""
        return {"users": (count, 3), "user_velocity": (count, 2)}

    def require(self, ground: Ground) -> None:  # noqa: B027
        """Raise ValueError where nobody can walk so."""

    @abstractmethod
    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """The arrays of `state` in a new world that has this layout."""

    def move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Move the users of the worlds `flying` (W,) bool through `dt` s, in place; the other worlds stay as they are.

        `state` holds the arrays of all worlds, `layout` (W,) int those of the worlds. World k draws from `rng[k]` alone,
        whatever the others do. Raises ValueError for a `dt` that is not above 0.
        """
        if not finite("dt", dt) > 0:
            raise ValueError(f"dt is {dt!r} s: a number above 0 is needed")
        self._move(state, ground, layout, flying, float(dt), rng)

    @abstractmethod
    def _move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None: ...


@dataclass(frozen=True)
class Walking(Mobility):
    """Users who walk.

    speed  m/s, from low to high, drawn uniformly
    """

    speed: tuple[float, float] = (0.5, 3.0)

    def __post_init__(self):
        self._keep("speed", check_range("speed", self.speed, "m/s", MOST_SPEED, above_zero=True))

    @property
    def max_speed(self) -> float:
        """No user is ever faster, m/s."""
        return self.speed[1]


def check_range(
    name: str, value: Any, unit: str, most: float, above_zero: bool
) -> tuple[float, float]:
    """(low, high) as floats. Raises ValueError unless they are in order, up to `most`, and low at least 0, or above it."""
    low, high = (finite(name, end, most=most) for end in as_sequence(name, value, 2))
    if not 0 <= low <= high or (above_zero and low == 0):
        raise ValueError(
            f"{name} is {shown(value)} {unit}: from low to high, {'above' if above_zero else 'at least'} 0, is needed"
        )
    return low, high


def headings(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 2) unit vectors, uniform on the circle."""
    angle = rng.uniform(-math.pi, math.pi, count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def normals(rng: Generators, flying: np.ndarray, *shape: int) -> np.ndarray:
    """(W, *shape) standard normal numbers; anything in worlds that do not fly."""
    values = np.empty((len(flying), *shape))
    for k, own in _flown(rng, flying):
        own.standard_normal(out=values[k])
    return values


def keys(rng: Generators, flying: np.ndarray) -> np.ndarray:
    """(W,) uint64, keys for `uniform`, 0 in worlds that do not fly: a move draws one, however many numbers it takes."""
    values = np.zeros(len(flying), dtype=np.uint64)
    for k, own in _flown(rng, flying):
        values[k] = own.bit_generator.random_raw()
    return values


def _flown(rng: Generators, flying: np.ndarray) -> Iterator[tuple[int, np.random.Generator]]:
    for k in np.flatnonzero(flying).tolist():
        own = rng[k]
        assert own is not None  # a world that flies was started
        yield k, own


@func
def uniform(key, index):
    """Number `index` (from 0) of the stream of a key (uint64), in [0, 1).

    SplitMix64: G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014; constants of its
    64-bit mixer by D. Stafford (variant 13).
    """
    mixed = np.uint64(key) + np.uint64(index + 1) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
