"""Wind: steady (uniform or with a height profile) or a user's function, with gusts and thermals.

Gusts are those of `bulletuav.vehicle.gusts`, thermals those of `bulletuav.vehicle.thermals`.
Buildings and drones cast no wind shadows.
"""

import inspect
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import log, power
from bulletuav.compiled.kernel import func, kernel
from bulletuav.compiled.program import Program
from bulletuav.errors import as_sequence, find_choice, finite, numbers_of
from bulletuav.vehicle.gusts import FOOT, NUM_DRAWS, NUM_WAVE_ROWS, NUM_WAVES, add_gusts, draw_waves
from bulletuav.vehicle.thermals import Thermals, add_thermals

KNOT = 1852 / 3600
"""One knot, m/s."""
TURBULENCE = {"light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}
"""Wind speeds at 20 feet, m/s, of the turbulence levels of MIL-F-8785C."""
MAX_WIND = 100.0
"""Maximum wind speed, m/s."""
REFERENCE_HEIGHT = 20 * FOOT
"""Height at which a steady wind with a profile has its nominal speed, m, as in MIL-F-8785C; also
the height of the wind speed that sets the turbulence
"""
MAX_PROFILE_HEIGHT = 1000 * FOOT
"""Height above which profiles are constant, m, as in MIL-F-8785C"""

WindField = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function from positions (W, N, 3), m, and times (W,), s, to the wind (W, N, 3), m/s."""


class Profile(NamedTuple):
    """Law of the steady wind's speed over height.

    Attributes:
        law: Name of the law in `PROFILES`.
        number: Exponent of the law "power"; roughness length of the law "log", m.
    """

    law: str
    number: float


class _Number(NamedTuple):
    """The parameter of a law: its name, default value, minimum and maximum."""

    name: str
    default: float
    minimum: float
    maximum: float


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
    """Check and convert a profile of the steady wind.

    Args:
        given: None for a uniform wind, a name in `PROFILES`, or (name, number).

    Returns:
        The profile, or None.

    Raises:
        ValueError: If there is no such law, or its number is out of bounds.
    """
    if given is None:
        return None
    named = isinstance(given, str)
    law, *numbers = (given,) if named else as_sequence("wind_profile", given, 2)
    number = find_choice("wind_profile", law, PROFILES)
    if not numbers:
        return Profile(law, number.default)
    label = f"wind_profile: {number.name} of {law!r}"
    return Profile(law, finite(label, numbers[0], number.minimum, number.maximum))


@func
def profile_speed_ratio(altitude: float, is_log: bool, number: float) -> float:
    """Return the speed of a steady wind at a height, divided by its speed at `REFERENCE_HEIGHT`.

    Args:
        altitude: Height above the ground, m.
        is_log: Whether the law is logarithmic, else it is a power law.
        number: Roughness length, m, or exponent.

    Returns:
        (h / REFERENCE_HEIGHT)^number, or ln(h / number) / ln(REFERENCE_HEIGHT / number); 0 on the
        ground and below the roughness length; constant above `MAX_PROFILE_HEIGHT`.
    """
    h = min(max(altitude, 0.0), MAX_PROFILE_HEIGHT)
    if is_log:
        return log(h / number) / log(REFERENCE_HEIGHT / number) if h > number else 0.0
    return power(h / REFERENCE_HEIGHT, number)


@kernel
def _spread(steady: np.ndarray, wind: np.ndarray) -> None:
    """Write the steady wind (W, 3) of each world to all of its drones (W, N, 3)."""
    for w in range(wind.shape[0]):
        for i in range(wind.shape[1]):
            for k in range(3):
                wind[w, i, k] = steady[w, k]


@kernel
def _spread_by_height(
    steady: np.ndarray, position: np.ndarray, is_log: bool, number: float, wind: np.ndarray
) -> None:
    """Write the steady wind (W, 3) to drones, with a profile of its horizontal components.

    See `profile_speed_ratio` for the profile.
    """
    for w in range(wind.shape[0]):
        for i in range(wind.shape[1]):
            ratio = profile_speed_ratio(position[w, i, 2], is_log, number)
            wind[w, i, 0] = ratio * steady[w, 0]
            wind[w, i, 1] = ratio * steady[w, 1]
            wind[w, i, 2] = steady[w, 2]


class Wind:
    """The wind of all worlds: steady or a field, with optional Dryden gusts and thermals.

    It is a function of position, time, and the random numbers of each world's reset. It does not
    depend on the order of queries.

    Attributes:
        given: (3,) the steady wind of the options, m/s; zero for a field.
        steady: (W, 3) the steady wind of each world, m/s, which a reset may change; it is added to
            a field. It carries the gusts.
    """

    def __init__(
        self,
        steady: tuple[float, float, float] | WindField,
        wind20: float,
        num_worlds: int,
        profile: Profile | None = None,
        thermals: Thermals | None = None,
    ) -> None:
        """Make the wind.

        Args:
            steady: The steady wind, world axes, m/s, or a wind field.
            wind20: Wind speed at 20 feet, which sets the turbulence, m/s; 0 for none.
            num_worlds: W.
            profile: Change of the steady wind with height; None for a uniform wind.
            thermals: Rising air; None for none.
        """
        self._field = steady if callable(steady) else None
        self.given = np.zeros(3) if callable(steady) else np.array(steady, dtype=float)
        self.steady = np.tile(self.given, (num_worlds, 1))
        self._wind20 = wind20
        self._profile = profile
        # No memory is needed for worlds without gusts
        self._waves = np.zeros((num_worlds if wind20 > 0 else 0, NUM_WAVE_ROWS, NUM_WAVES))
        self._parts = np.zeros((3, NUM_WAVES))
        self._thermals = thermals
        # Centres of the thermals of each world
        self._centres = np.zeros((num_worlds, 0 if thermals is None else thermals.number, 2))

    def kept(self) -> dict[str, np.ndarray]:
        """Return the arrays (W, ...) by name that determine the wind of a world, for snapshots."""
        gusts = {"waves": self._waves} if len(self._waves) else {}
        rising = {} if self._thermals is None else {"thermals": self._centres}
        return {"steady wind": self.steady, **gusts, **rising}

    @property
    def is_gusty(self) -> bool:
        """Whether there are gusts."""
        return self._wind20 > 0

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Draw the gusts and thermals of one world."""
        if self._wind20 > 0:
            draw_waves(rng.random(NUM_DRAWS), self._waves[world])
        if self._thermals is not None:
            self._centres[world] = self._thermals.draw(rng)

    def add_to(
        self, program: Program, position: np.ndarray, time: np.ndarray, wind: np.ndarray
    ) -> None:
        """Add the computation of the wind to a program.

        Args:
            program: The program.
            position: (W, N, 3) positions at which to compute the wind, m.
            time: (W,) time of each world, s.
            wind: (W, N, 3) array to write the wind to, world axes, m/s.
        """
        if self._profile is None:
            program.call(_spread, self.steady, wind)
        else:
            law = (self._profile.law == "log", self._profile.number)
            program.call(_spread_by_height, self.steady, position, *law, wind)
        if self._field is not None:
            program.callback(lambda: self._add_field(position, time, wind))
        if self._wind20 > 0:
            arrays = (self._waves, self._parts)
            program.call(add_gusts, *arrays, position, time, self.steady, self._wind20, wind)
        if self._thermals is not None:
            air = (self._thermals.strength, self._thermals.depth, self._thermals.area)
            program.call(add_thermals, self._centres, position, *air, wind)

    def sample(self, position: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Compute the wind at given positions.

        Args:
            position: (W, N, 3) positions, m; N may be any number.
            time: (W,) time of each world, s.

        Returns:
            (W, N, 3) wind, world axes, m/s.

        Raises:
            ValueError: If the wind field returns another shape, or numbers that are not finite.
        """
        program, wind = Program(), np.empty(position.shape)
        self.add_to(program, position, time, wind)
        program.interpret()
        return wind

    def _add_field(self, position: np.ndarray, time: np.ndarray, wind: np.ndarray) -> None:
        """Add the values of the wind field to the wind."""
        assert self._field is not None
        wind += self._checked(self._field(position.copy(), time.copy()), position.shape)

    def _checked(self, wind: object, expected: tuple[int, ...]) -> np.ndarray:
        """Return the values of the wind field; raise ValueError for wrong shapes and numbers."""
        given = numbers_of("the result of the wind function is", wind)
        if given.shape != expected:
            raise ValueError(
                f"the wind function returned shape {given.shape}: "
                f"finite numbers of shape {expected} are needed"
            )
        wrong = ~np.isfinite(given)
        if wrong.any():
            w, i, _ = np.argwhere(wrong)[0]
            raise ValueError(
                f"the wind function returned shape {given.shape} "
                f"with {given[w, i]} m/s at drone {i} in world {w}: finite numbers are needed"
            )
        return given


def check_field(wind: WindField) -> None:
    """Check that a wind function accepts positions and times.

    A function without a signature, such as one written in C, passes.

    Args:
        wind: The function.

    Raises:
        ValueError: If it is a class, or accepts other arguments.
    """
    if inspect.isclass(wind):
        raise ValueError(
            f"wind is the class {wind.__name__}: a function of positions and times is needed"
        )
    try:
        signature = inspect.signature(wind)
    # Functions written in C may have no signature.
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None)
    except TypeError as error:
        raise ValueError(
            f"wind is a function that does not accept positions and times: {error}"
        ) from None
