"""Wind: steady, uniform or with a profile over height, or a function; gusts on top.

Gusts are those of `bulletuav.vehicle.gusts`. Buildings and drones cast no wind shadows: what stands
in the way does not slow the wind.
"""

import inspect
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import log, power
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.program import Program
from bulletuav.errors import as_sequence, choose, finite, numbers_of
from bulletuav.vehicle.gusts import DRAWS, FOOT, ROWS, WAVES, add_gusts, draw_waves

KNOT = 1852 / 3600
"""One knot, m/s."""
TURBULENCE = {"light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}
"""Wind speeds at 20 feet, m/s, by the names that MIL-F-8785C gives them."""
MOST_WIND = 100.0
"""Greatest wind speed that may be asked for, m/s."""
REFERENCE = 20 * FOOT
"""Height at which a steady wind with a profile has its full speed, m, as in MIL-F-8785C; the wind
speed that sets the turbulence is of that height, too"""
CEILING = 1000 * FOOT
"""Height up to which profiles go on, m, as in MIL-F-8785C"""

WindField = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function from positions (W, N, 3), m, and times (W,), s, to the wind (W, N, 3), m/s."""


class Profile(NamedTuple):
    """A law of the steady wind's speed over height.

    Attributes:
        law: Its name in `PROFILES`.
        number: Exponent of the law "power"; roughness length of the law "log", m.
    """

    law: str
    number: float


class _Number(NamedTuple):
    """The number of a law: what it is, its usual value, its least and its greatest one."""

    name: str
    usual: float
    least: float
    most: float


PROFILES = {
    "power": _Number("exponent", 1 / 7, 0.0, 1.0),
    "log": _Number("roughness length", 0.15 * FOOT, 1e-5, 3.0),
}
"""Laws of the steady wind over height.

Power law with the exponent 1/7, of open land in neutral air; about 0.1 over water, 0.25 and more
over towns. Logarithmic law with the roughness length 0.15 feet of MIL-F-8785C (terminal flight
phases; 2 feet in all others).
"""


def as_profile(given: object) -> Profile | None:
    """Check a profile of the steady wind.

    Args:
        given: None for a uniform wind, a name in `PROFILES`, or (name, number).

    Raises:
        ValueError: There is no such law, or its number cannot be.
    """
    if given is None:
        return None
    named = isinstance(given, str)
    law, *numbers = (given,) if named else as_sequence("wind_profile", given, 2)
    number = choose("wind_profile", law, PROFILES)
    if not numbers:
        return Profile(law, number.usual)
    label = f"wind_profile: {number.name} of {law!r}"
    return Profile(law, finite(label, numbers[0], number.least, number.most))


@func
def speed_share(
    altitude: float,
    is_log: bool,
    number: float,
) -> float:
    """Return the share of the speed at `REFERENCE` that a steady wind has at a height.

    Args:
        altitude: Height above the ground, m.
        is_log: Whether the law is logarithmic, and not a power.
        number: Roughness length, m, or exponent.

    Returns:
        (h / REFERENCE)^number, or ln(h / number) / ln(REFERENCE / number); 0 on the ground and
        below the roughness length; above `CEILING` as there.
    """
    h = min(max(altitude, 0.0), CEILING)
    if is_log:
        return log(h / number) / log(REFERENCE / number) if h > number else 0.0
    return power(h / REFERENCE, number)


@kernel
def _spread(steady: np.ndarray, wind: np.ndarray) -> None:
    """Write the steady wind (W, 3) of each world to all of its drones (W, N, 3)."""
    for w in range(wind.shape[0]):
        for i in range(wind.shape[1]):
            for k in range(3):
                wind[w, i, k] = steady[w, k]


@kernel
def _spread_by_height(
    steady: np.ndarray,
    position: np.ndarray,
    is_log: bool,
    number: float,
    wind: np.ndarray,
) -> None:
    """Write the steady wind (W, 3) to drones at `position` (W, N, 3); its level part by a profile.

    See `speed_share` for the profile.
    """
    for w in range(wind.shape[0]):
        for i in range(wind.shape[1]):
            share = speed_share(position[w, i, 2], is_log, number)
            wind[w, i, 0] = share * steady[w, 0]
            wind[w, i, 1] = share * steady[w, 1]
            wind[w, i, 2] = steady[w, 2]


class Wind:
    """The wind of all worlds: steady or a field, with Dryden gusts on top where asked for.

    It follows from place, time, and what a world drew at its reset: who asks, and in what order,
    does not matter.

    Attributes:
        given: (3,) the steady wind that was asked for, m/s; zero for a field.
        steady: (W, 3) the steady wind of each world, m/s, which may be set at a reset; beside a
            field it adds to it. It carries the gusts.
    """

    def __init__(
        self,
        steady: tuple[float, float, float] | WindField,
        wind20: float,
        num_worlds: int,
        profile: Profile | None = None,
    ) -> None:
        """Make the wind.

        Args:
            steady: The steady wind, world axes, m/s, or a wind field.
            wind20: Wind speed at 20 feet, which sets the turbulence, m/s; 0 for none.
            num_worlds: W.
            profile: How the steady wind changes with height; None if it does not.
        """
        self._field = steady if callable(steady) else None
        self.given = np.zeros(3) if callable(steady) else np.array(steady, dtype=float)
        self.steady = np.tile(self.given, (num_worlds, 1))
        self._wind20 = wind20
        self._profile = profile
        # Worlds without gusts need no room for them
        self._waves = np.zeros((num_worlds if wind20 > 0 else 0, ROWS, WAVES))
        self._parts = np.zeros((3, WAVES))

    def kept(self) -> dict[str, np.ndarray]:
        """Tell the arrays (W, ...) by name that the wind of a world follows from."""
        gusts = {"waves": self._waves} if len(self._waves) else {}
        return {"steady wind": self.steady, **gusts}

    @property
    def is_gusty(self) -> bool:
        """Whether gusts are drawn."""
        return self._wind20 > 0

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Draw the gusts of one world."""
        if self._wind20 > 0:
            draw_waves(rng.random(DRAWS), self._waves[world])

    def add_to(
        self,
        program: Program,
        position: np.ndarray,
        time: np.ndarray,
        wind: np.ndarray,
    ) -> None:
        """Add to a program that the wind is written.

        Args:
            program: Where to add it.
            position: (W, N, 3) where to tell the wind, m.
            time: (W,) time of each world, s.
            wind: (W, N, 3) what to write, world axes, m/s.
        """
        if self._profile is None:
            program.call(_spread, self.steady, wind)
        else:
            law = (self._profile.law == "log", self._profile.number)
            program.call(_spread_by_height, self.steady, position, *law, wind)
        if self._field is not None:
            program.callback(lambda: self._add_field(position, time, wind))
        if self._wind20 > 0:
            room = (self._waves, self._parts)
            program.call(add_gusts, *room, position, time, self.steady, self._wind20, wind)

    def sample(self, position: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return the wind at some places.

        Args:
            position: (W, N, 3) the places, m; any number N of them.
            time: (W,) time of each world, s.

        Returns:
            (W, N, 3) wind, world axes, m/s.

        Raises:
            ValueError: The wind field gives another shape, or numbers that are not finite.
        """
        program, wind = Program(), np.empty(position.shape)
        self.add_to(program, position, time, wind)
        program.interpret()
        return wind

    def _add_field(
        self,
        position: np.ndarray,
        time: np.ndarray,
        wind: np.ndarray,
    ) -> None:
        """Add what the wind field gives to the wind."""
        assert self._field is not None
        wind += self._checked(self._field(position.copy(), time.copy()), position.shape)

    def _checked(self, wind: object, expected: tuple[int, ...]) -> np.ndarray:
        """Return what the wind field gave, refusing other shapes and numbers."""
        given = numbers_of("what the wind function gave is", wind)
        if given.shape != expected:
            raise ValueError(
                f"the wind function gave shape {given.shape}: "
                f"finite numbers of shape {expected} are needed"
            )
        wrong = ~np.isfinite(given)
        if wrong.any():
            w, i, _ = np.argwhere(wrong)[0]
            raise ValueError(
                f"the wind function gave shape {given.shape} "
                f"with {given[w, i]} m/s at drone {i} in world {w}: finite numbers are needed"
            )
        return given


def check_field(wind: WindField) -> None:
    """Check that a wind function takes positions and times.

    A function that does not tell what it takes, such as one written in C, may pass.

    Args:
        wind: The function.

    Raises:
        ValueError: It is a class, or takes something else.
    """
    if inspect.isclass(wind):
        raise ValueError(
            f"wind is the class {wind.__name__}: a function of positions and times is needed"
        )
    try:
        signature = inspect.signature(wind)
    # Functions written in C do not tell what they take.
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None)
    except TypeError as error:
        raise ValueError(
            f"wind is a function that does not take positions and times: {error}"
        ) from None
