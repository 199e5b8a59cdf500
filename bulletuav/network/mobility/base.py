"""The interface of mobility models, and where their random numbers come from."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func
from bulletuav.errors import as_sequence, finite, shown
from bulletuav.network.mobility.ground import Ground

SPEED_LIMIT = 100.0
"""Greatest speed that an option may give users, m/s"""
MAX_VELOCITY = 10 * SPEED_LIMIT
"""Bound of a user's velocity in a snapshot, m/s"""
MAX_TIME = 1e6
"""Longest time that an option may give, s"""
MAX_LENGTH = 1e6
"""Greatest length that an option may give, m"""
State = Mapping[str, np.ndarray]
"""Arrays by name, float64: of one world, or of W worlds with W as the first axis"""
Generators = Sequence[np.random.Generator | None]
"""Generator of each of W worlds; None is possible for worlds that do not fly"""


@dataclass(frozen=True)
class Mobility(ABC):
    """A mobility model: how U users walk in each of W worlds.

    Users are always outdoors and in bounds, at the height that the ground tells. A model is a
    frozen dataclass whose fields are its options. It raises ValueError for impossible options.

    Attributes:
        name: Name of the model, which `find_mobility` knows it by.
    """

    name: ClassVar[str]

    def _set_option(self, name: str, value: Any) -> None:
        """Store an option as its check gave it, so that kernels see one type of it."""
        object.__setattr__(self, name, value)

    def _check_number(self, name: str, unit: str, most: float, above_zero: bool) -> None:
        """Store an option as a float, and refuse one below 0 (or 0 itself) or above `most`."""
        given = getattr(self, name)
        value = finite(name, given, most=most)
        if value < 0 or (above_zero and value == 0):
            bound = "above" if above_zero else "from"
            raise ValueError(f"{name} is {given!r}{unit}: a number {bound} 0 is needed")
        self._set_option(name, value)

    @property
    def max_speed(self) -> float:
        """Speed that no user ever exceeds, m/s."""
        return 0.0

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Tell the names and shapes of the arrays that the model keeps in one world.

        Args:
            count: Number U of users.

        Returns:
            Shapes by name: "users" (U, 3), positions, m; "user_velocity" (U, 2), m/s; and what
            else the model keeps.
        """
        return {"users": (count, 3), "user_velocity": (count, 2)}

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the arrays that the model keeps, for snapshots.

        Args:
            ground: Ground of all layouts.

        Returns:
            Lowest and highest values by name; they broadcast to the array of one world.
        """
        reach = float(ground.raster.reach)
        return {
            "users": (-reach, max(reach, ground.height)),
            "user_velocity": (-MAX_VELOCITY, MAX_VELOCITY),
        }

    def require(self, ground: Ground) -> None:  # noqa: B027
        """Check that users can walk on a ground in this way.

        Args:
            ground: Ground of all layouts.

        Raises:
            ValueError: They cannot.
        """

    @abstractmethod
    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw where users are and how they move when an episode begins.

        Args:
            rng: Generator of the world.
            ground: Ground of all layouts.
            layout: Index of the world's layout.
            count: Number U of users.

        Returns:
            The arrays that `state` names, of one world.
        """

    def move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Move users through a time step, in place.

        Args:
            state: Arrays of all W worlds; changed.
            ground: Ground of all layouts.
            layout: Layout (W,) of each world, int.
            flying: Whether (W,) users of each world move: an episode is under way. The other
                worlds stay as they are.
            dt: Length of the step, s.
            rng: Generator of each world. A world draws from its own alone, whatever others do.

        Raises:
            ValueError: `dt` is not above 0.
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
    ) -> None:
        """Move users as `move` tells, with a `dt` that is checked."""


@dataclass(frozen=True)
class Walking(Mobility):
    """A mobility model of users who walk.

    Attributes:
        speed: Lowest and highest speed, m/s; each user's is drawn uniformly.
    """

    speed: tuple[float, float] = (0.5, 3.0)

    def __post_init__(self) -> None:
        """Check the options."""
        speed = check_range("speed", self.speed, unit="m/s", most=SPEED_LIMIT, above_zero=True)
        self._set_option("speed", speed)

    @property
    def max_speed(self) -> float:
        """Speed that no user ever exceeds, m/s."""
        return self.speed[1]


def check_range(
    name: str, value: Any, unit: str, most: float, above_zero: bool
) -> tuple[float, float]:
    """Return an option that is a range, (low, high), as floats.

    Args:
        name: Name of the option, for messages.
        value: What the user gave.
        unit: Unit, for messages.
        most: Greatest value that is possible.
        above_zero: Whether low must be above 0, and not only at least 0.

    Raises:
        ValueError: It is no such range.
    """
    low, high = (finite(name, end, most=most) for end in as_sequence(name, value, 2))
    if not 0 <= low <= high or (above_zero and low == 0):
        bound = "above" if above_zero else "at least"
        raise ValueError(f"{name} is {shown(value)} {unit}: from low to high, {bound} 0, is needed")
    return low, high


def random_headings(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw unit vectors (count, 2), uniform on the circle."""
    angle = rng.uniform(-math.pi, math.pi, count)
    return np.column_stack([cos(angle), sin(angle)])


def standard_normals(rng: Generators, flying: np.ndarray, *shape: int) -> np.ndarray:
    """Draw standard normal numbers for worlds that fly, each from its own generator.

    Args:
        rng: Generator of each world.
        flying: Whether (W,) each world draws.
        *shape: Shape of the numbers of one world.

    Returns:
        Numbers (W, *shape); those of worlds that do not fly have no meaning.
    """
    values = np.empty((len(flying), *shape))
    for w, generator in _flying_generators(rng, flying):
        generator.standard_normal(out=values[w])
    return values


def stream_keys(rng: Generators, flying: np.ndarray) -> np.ndarray:
    """Draw a key for `uniform` in each world that flies.

    So a move draws one number from the generator, however many numbers its users take.

    Args:
        rng: Generator of each world.
        flying: Whether (W,) each world draws.

    Returns:
        Keys (W,), uint64; 0 in worlds that do not fly.
    """
    values = np.zeros(len(flying), dtype=np.uint64)
    for w, generator in _flying_generators(rng, flying):
        values[w] = generator.bit_generator.random_raw()
    return values


def _flying_generators(
    rng: Generators, flying: np.ndarray
) -> Iterator[tuple[int, np.random.Generator]]:
    """Yield the index and the generator of each world that flies."""
    for w in np.flatnonzero(flying).tolist():
        generator = rng[w]
        assert generator is not None  # a world that flies was started
        yield w, generator


@func
def uniform(key: int, index: int) -> float:
    """Return a number of the random stream of a key, uniform in [0, 1).

    SplitMix64: G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA
    2014. The constants of its 64-bit mixer are by D. Stafford (variant 13).

    Args:
        key: Key of the stream, uint64.
        index: Position in the stream, from 0.
    """
    # State of the generator at that position, then two rounds of mixing
    mixed = np.uint64(key) + np.uint64(index + 1) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    # The upper 53 bits fill the mantissa of a float
    return float((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
