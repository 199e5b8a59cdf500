"""Wind: steady, Dryden turbulence on top, or a function of place and time.

Dryden spectra at low altitude after MIL-F-8785C (altitude h in feet, kept within 10 and 1000). They
are sampled exactly: each filter is advanced by the transition of its linear system over the time
step, so the variance is right for every step.
"""

import inspect
import math
from collections.abc import Callable, Sequence

import numpy as np

from bulletuav.errors import numbers_of
from bulletuav.functions import exp, expm1, hypot, power
from bulletuav.geometry.rotation import dot
from bulletuav.kernel import func, kernel
from bulletuav.program import Program
from bulletuav.vehicle.swarm import Swarm

FOOT = 0.3048
"""One foot, m."""
KNOT = 1852 / 3600
"""One knot, m/s."""
TURBULENCE = {"light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}
"""Wind speeds at 20 feet, m/s, by the names that MIL-F-8785C gives them."""
SLOWEST = 1.0
"""Airspeed, m/s, below which the turbulence passes as if at it."""
MOST_WIND = 100.0
"""Greatest wind speed that may be asked for, m/s."""

WindField = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function from positions (W, N, 3), m, and times (W,), s, to the wind (W, N, 3), m/s."""


@func
def dryden_scales(altitude: float, wind20: float) -> tuple[float, float, float, float]:
    """Return scale lengths and intensities of the turbulence by MIL-F-8785C.

    Args:
        altitude: Height above the ground, m.
        wind20: Wind speed at 20 feet, m/s.

    Returns:
        L_u = L_v and L_w, m; s_u = s_v and s_w, m/s.
    """
    h = min(max(altitude / FOOT, 10.0), 1000.0)
    ratio = 0.177 + 0.000823 * h
    s_w = 0.1 * wind20
    return h / power(ratio, 1.2) * FOOT, h * FOOT, s_w / power(ratio, 0.4), s_w


@func
def first_order(state: float, share: float, noise: float) -> float:
    """Advance the longitudinal filter, exactly for the spectrum 1 / (1 + tau s).

    Args:
        state: Its state, of unit variance.
        share: Time step over the time constant, dt / tau.
        noise: A standard normal number.

    Returns:
        The new state, of unit variance.
    """
    decay = exp(-share)
    return decay * state + math.sqrt(-expm1(-2.0 * share)) * noise


@func
def second_order(
    one: float, two: float, share: float, noise_one: float, noise_two: float
) -> tuple[float, float]:
    """Advance the transverse filter.

    Its two states are scaled to unit variance each and uncorrelated. For x' = A x the transition is
    M = e^-r [[1 + r, r], [-r, 1 - r]] in these units, and the noise has the covariance 1 - M M^T.

    Args:
        one: First state.
        two: Second state.
        share: Time step over the time constant, r = dt / tau.
        noise_one: A standard normal number.
        noise_two: Another one.

    Returns:
        The new states.
    """
    r = share
    decay = exp(-r)
    # The transition M.
    a = decay * (1.0 + r)
    b = decay * r
    c = -decay * r
    d = decay * (1.0 - r)
    # The covariance [[p, q], [q, rest]] of the noise; the terms of p cancel for small r.
    square = decay * decay
    p = r**3 * (4.0 / 3.0 - 2.0 * r) if r < 1e-3 else 1.0 - a * a - b * b
    q = 2.0 * r * r * square
    rest = -expm1(-2.0 * r) + square * (2.0 * r - 2.0 * r * r)
    # Its Cholesky factor turns independent numbers into such noise.
    left = math.sqrt(p)
    low = q / left if left > 0.0 else 0.0
    right = math.sqrt(max(rest - low * low, 0.0))
    return (
        a * one + b * two + left * noise_one,
        c * one + d * two + low * noise_one + right * noise_two,
    )


@kernel
def advance_gusts(
    state: np.ndarray,
    noise: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    steady: np.ndarray,
    wind20: float,
    dt: float,
    wind: np.ndarray,
) -> None:
    """Advance the filters of all drones, and add the gusts to the wind.

    The gust u is along the steady wind (east where there is none), v to its left, w up. The air
    passes at the drone's speed against the steady wind.

    Args:
        state: (W, N, 5) states of the filters u, v (2) and w (2), each of unit variance; changed in
            place.
        noise: (W, N, 5) standard normal numbers.
        position: (W, N, 3) positions of the drones, m.
        velocity: (W, N, 3) their velocities, m/s.
        steady: (W, 3) steady wind, m/s.
        wind20: Wind speed at 20 feet, m/s.
        dt: Time step, s.
        wind: (W, N, 3) wind, m/s, to which the gusts are added in place.
    """
    for w in range(state.shape[0]):
        # Direction of the steady wind in plan.
        size = hypot(steady[w, 0], steady[w, 1])
        ex, ey = (steady[w, 0] / size, steady[w, 1] / size) if size > 1e-9 else (1.0, 0.0)
        for i in range(state.shape[1]):
            x = state[w, i]
            n = noise[w, i]
            v = velocity[w, i]
            # How far the air, and the turbulence frozen in it, passes the drone in a step.
            length_u, length_w, s_u, s_w = dryden_scales(position[w, i, 2], wind20)
            air = (v[0] - steady[w, 0], v[1] - steady[w, 1], v[2] - steady[w, 2])
            passed = dt * max(math.sqrt(dot(air, air)), SLOWEST)
            x[0] = first_order(x[0], passed / length_u, n[0])
            x[1], x[2] = second_order(x[1], x[2], passed / length_u, n[1], n[2])
            x[3], x[4] = second_order(x[3], x[4], passed / length_w, n[3], n[4])
            # The filters' outputs are the gusts; turn them into world axes.
            along = s_u * x[0]
            left = s_u * (0.5 * x[1] + math.sqrt(0.75) * x[2])
            wind[w, i, 0] += along * ex - left * ey
            wind[w, i, 1] += along * ey + left * ex
            wind[w, i, 2] += s_w * (0.5 * x[3] + math.sqrt(0.75) * x[4])


@kernel
def _spread(steady: np.ndarray, wind: np.ndarray) -> None:
    """Write the steady wind (W, 3) of each world to all of its drones (W, N, 3)."""
    for w in range(wind.shape[0]):
        for i in range(wind.shape[1]):
            for k in range(3):
                wind[w, i, k] = steady[w, k]


class Wind:
    """The wind of all worlds: steady or a field, with Dryden gusts on top where asked for.

    Attributes:
        given: (3,) the steady wind that was asked for, m/s; zero for a field.
        steady: (W, 3) the steady wind of each world, m/s, which may be set; beside a field it adds
            to it.
    """

    def __init__(
        self,
        steady: tuple[float, float, float] | WindField,
        wind20: float,
        shape: tuple[int, int],
        dt: float,
    ) -> None:
        """Make the wind.

        Args:
            steady: The steady wind, world axes, m/s, or a wind field.
            wind20: Wind speed at 20 feet, which sets the turbulence, m/s; 0 for none.
            shape: (W, N).
            dt: Time between samples, s.
        """
        self._field = steady if callable(steady) else None
        self.given = np.zeros(3) if callable(steady) else np.array(steady, dtype=float)
        self.steady = np.tile(self.given, (shape[0], 1))
        self._wind20 = wind20
        self._dt = dt
        self._shape = shape
        self._gusts = np.zeros((*shape, 5))

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Start the gusts of one world in their stationary distribution."""
        if self._wind20 > 0:
            self._gusts[world] = rng.standard_normal(self._gusts[world].shape)

    def add_to(
        self,
        program: Program,
        swarm: Swarm,
        time: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
        flying: np.ndarray,
        wind: np.ndarray,
    ) -> None:
        """Add to a program that the wind of a decision is written to `wind` (W, N, 3).

        See `sample` for the other arguments.
        """
        if self._field is None and self._wind20 == 0:
            program.call(_spread, self.steady, wind)
            return

        def blow() -> None:
            wind[:] = self.sample(swarm, time, rngs, flying)

        program.turn(blow)

    def sample(
        self,
        swarm: Swarm,
        time: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
        flying: np.ndarray,
    ) -> np.ndarray:
        """Return the wind for the next decision.

        Args:
            swarm: State of the drones.
            time: (W,) time of each world, s.
            rngs: Random generator of each world.
            flying: (W,) bool; only these worlds draw from their generators.

        Returns:
            (W, N, 3) wind, world axes, m/s.

        Raises:
            ValueError: The wind field gives another shape, or numbers that are not finite.
        """
        wind = np.empty((*self._shape, 3))
        wind[:] = self.steady[:, None]
        if self._field is not None:
            wind += self._checked(self._field(swarm.position.copy(), time.copy()))
        if self._wind20 > 0:
            noise = np.zeros_like(self._gusts)
            for k in np.flatnonzero(flying).tolist():
                rng = rngs[k]
                # A world that flies was reset, and so has its generator.
                assert rng is not None
                noise[k] = rng.standard_normal(noise[k].shape)
            advance_gusts(
                self._gusts,
                noise,
                swarm.position,
                swarm.velocity,
                self.steady,
                self._wind20,
                self._dt,
                wind,
            )
        return wind

    def _checked(self, wind: object) -> np.ndarray:
        """Return what the wind field gave, refusing other shapes and numbers."""
        given = numbers_of("what the wind function gave is", wind)
        expected = (*self._shape, 3)
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
