"""Interface of mobility models, and their random streams."""

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
"""Maximum speed in options, m/s"""
MAX_VELOCITY = 10 * SPEED_LIMIT
"""Bound of a user's velocity in a snapshot, m/s"""
MAX_TIME = 1e6
"""Maximum time in options, s"""
MAX_LENGTH = 1e6
"""Maximum length in options, m"""
State = Mapping[str, np.ndarray]
"""Arrays by name, float64: of one world, or of W worlds with W as the first axis"""
Generators = Sequence[np.random.Generator | None]
"""Generator of each of W worlds; may be None for worlds that do not fly"""


@dataclass(frozen=True)
class Mobility(ABC):
    """Base class of mobility models for U users in each of W worlds.

    Users are always outdoors and in bounds, at the height of `Ground`. A model is a frozen
    dataclass whose fields are its options. The constructor raises ValueError for invalid options.

    Attributes:
        name: Name of the model in `find_mobility`.
    """

    name: ClassVar[str]

    def _set_option(self, name: str, value: Any) -> None:
        """Store a validated option of the frozen dataclass."""
        object.__setattr__(self, name, value)

    def _check_number(self, name: str, unit: str, most: float, above_zero: bool) -> None:
        """Validate an option, and store it as a float; raise ValueError if out of bounds."""
        given = getattr(self, name)
        value = finite(name, given, most=most)
        if value < 0 or (above_zero and value == 0):
            bound = "above" if above_zero else "from"
            raise ValueError(f"{name} is {given!r}{unit}: a number {bound} 0 is needed")
        self._set_option(name, value)

    @property
    def max_speed(self) -> float:
        """Maximum speed of users, m/s."""
        return 0.0

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Return the names and shapes of the state arrays of one world.

        Args:
            count: Number U of users.

        Returns:
            Shapes by name: "users" (U, 3), positions, m; "user_velocity" (U, 2), m/s; and further
            arrays of the model.
        """
        return {"users": (count, 3), "user_velocity": (count, 2)}

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the state arrays, for snapshots.

        Args:
            ground: Ground of all layouts.

        Returns:
            Lower and upper bounds by name; they broadcast to the array of one world.
        """
        half_side = float(ground.raster.half_side)
        return {
            "users": (-half_side, max(half_side, ground.height)),
            "user_velocity": (-MAX_VELOCITY, MAX_VELOCITY),
        }

    def require(self, ground: Ground) -> None:  # noqa: B027
        """Check that the model supports a ground.

        Args:
            ground: Ground of all layouts.

        Raises:
            ValueError: If the model does not support it.
        """

    @abstractmethod
    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw the initial state of an episode.

        Args:
            rng: Generator of the world.
            ground: Ground of all layouts.
            layout: Index of the world's layout.
            count: Number U of users.

        Returns:
            The state arrays of one world, see `state`.
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
        """Advance users by one time step, in place.

        Args:
            state: State arrays of all W worlds; modified.
            ground: Ground of all layouts.
            layout: Layout (W,) of each world, int.
            flying: Whether (W,) an episode of each world is running. Other worlds do not change.
            dt: Length of the step, s.
            rng: Generator of each world. Each world draws from its own generator, independently of
                the others.

        Raises:
            ValueError: If `dt` is not positive.
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
        """Advance users as `move`, with a validated `dt`."""


@dataclass(frozen=True)
class Walking(Mobility):
    """Base class of mobility models with walking users.

    Attributes:
        speed: Minimum and maximum speed, m/s; the speed of each user is drawn uniformly.
    """

    speed: tuple[float, float] = (0.5, 3.0)

    def __post_init__(self) -> None:
        """Validate the options."""
        speed = check_range("speed", self.speed, unit="m/s", most=SPEED_LIMIT, above_zero=True)
        self._set_option("speed", speed)

    @property
    def max_speed(self) -> float:
        """Maximum speed of users, m/s."""
        return self.speed[1]


def check_range(
    name: str, value: Any, unit: str, most: float, above_zero: bool
) -> tuple[float, float]:
    """Validate an option that is a range (low, high), and return it as floats.

    Args:
        name: Name of the option, for messages.
        value: Value of the option.
        unit: Unit, for messages.
        most: Maximum value.
        above_zero: Whether low must be positive, not only non-negative.

    Raises:
        ValueError: If the value is not a valid range.
    """
    low, high = (finite(name, end, most=most) for end in as_sequence(name, value, 2))
    if not 0 <= low <= high or (above_zero and low == 0):
        bound = "above" if above_zero else "at least"
        raise ValueError(f"{name} is {shown(value)} {unit}: from low to high, {bound} 0, is needed")
    return low, high


def random_headings(rng: np.random.Generator, count: int) -> np.ndarray:
    """Draw unit vectors (count, 2) with uniformly distributed angles."""
    angle = rng.uniform(-math.pi, math.pi, count)
    return np.column_stack([cos(angle), sin(angle)])


def standard_normals(rng: Generators, flying: np.ndarray, *shape: int) -> np.ndarray:
    """Draw standard normal numbers for worlds that fly, each from its own generator.

    Args:
        rng: Generator of each world.
        flying: Whether (W,) each world draws.
        *shape: Shape of the numbers of one world.

    Returns:
        Numbers (W, *shape); undefined for worlds that do not fly.
    """
    values = np.empty((len(flying), *shape))
    for w, generator in _flying_generators(rng, flying):
        generator.standard_normal(out=values[w])
    return values


def stream_keys(rng: Generators, flying: np.ndarray) -> np.ndarray:
    """Draw a key of a counter-based random stream for each world that flies, see `stream_uniform`.

    One step consumes a single number of the generator, independent of how many numbers users need.

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
    """Yield index and generator of each world that flies."""
    for w in np.flatnonzero(flying).tolist():
        generator = rng[w]
        assert generator is not None  # set by the reset of the world
        yield w, generator


@func
def stream_uniform(key: int, index: int) -> float:
    """Return a number of a counter-based random stream, uniform in [0, 1).

    The generator is SplitMix64; the constants of its 64-bit mixer are by D. Stafford (variant 13).

    Args:
        key: Key of the stream, uint64.
        index: Position in the stream, from 0.

    References:
        G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number generators, OOPSLA 2014.
    """
    # State at that position, then two rounds of mixing
    mixed = np.uint64(key) + np.uint64(index + 1) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    # The upper 53 bits fill the mantissa of a float
    return float((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53
