"""Wind: steady, Dryden turbulence on top, or a function of place and time.

Dryden spectra at low altitude after MIL-F-8785C (altitude h in feet, kept within 10 and 1000), sampled exactly: each filter
is advanced by the transition of its linear system over the time step, so the variance is right for every step.
"""

import inspect
import math
from collections.abc import Callable, Sequence

import numpy as np

from bulletuav.errors import numbers_of
from bulletuav.geometry.rotation import dot
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Swarm

FOOT = 0.3048  # m
KNOT = 1852 / 3600  # m/s
TURBULENCE = {"light": 15 * KNOT, "moderate": 30 * KNOT, "severe": 45 * KNOT}
"""Wind speed at 20 feet, m/s, that MIL-F-8785C names so"""
SLOWEST = 1.0  # m/s; below this airspeed the turbulence passes as if at it

MOST_WIND = 100.0  # m/s

WindField = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Wind (W, N, 3) m/s at positions (W, N, 3) m and times (W,) s"""


@func
def dryden_scales(altitude, wind20):
    """Scale lengths L_u = L_v, L_w (m) and intensities s_u = s_v, s_w (m/s) at `altitude` m, `wind20` m/s at 20 feet."""
    h = min(max(altitude / FOOT, 10.0), 1000.0)
    ratio = 0.177 + 0.000823 * h
    s_w = 0.1 * wind20
    return h / ratio**1.2 * FOOT, h * FOOT, s_w / ratio**0.4, s_w


@func
def first_order(state, share, noise):
    """Longitudinal filter of unit variance after `share` = dt / tau: exact for the spectrum 1 / (1 + tau s)."""
    decay = math.exp(-share)
    return decay * state + math.sqrt(-math.expm1(-2.0 * share)) * noise


@func
def second_order(one, two, share, noise_one, noise_two):
    """Transverse filter after `share` = dt / tau: its two states, scaled to unit variance each and uncorrelated.

    For x' = A x the transition is e^-r [[1 + r, r], [-r, 1 - r]] in these units, and the noise has the covariance 1 - M M^T.
    """
    r = share
    decay = math.exp(-r)
    a, b, c, d = decay * (1.0 + r), decay * r, -decay * r, decay * (1.0 - r)
    square = decay * decay
    p = (
        r**3 * (4.0 / 3.0 - 2.0 * r) if r < 1e-3 else 1.0 - a * a - b * b
    )  # its terms cancel for small r
    q = 2.0 * r * r * square
    rest = -math.expm1(-2.0 * r) + square * (2.0 * r - 2.0 * r * r)
    left = math.sqrt(p)
    low = q / left if left > 0.0 else 0.0
    right = math.sqrt(max(rest - low * low, 0.0))
    return (
        a * one + b * two + left * noise_one,
        c * one + d * two + low * noise_one + right * noise_two,
    )


@kernel
def advance_gusts(state, noise, position, velocity, steady, wind20, dt, wind):
    """Advance the filters by dt (s) and add the gusts to `wind` (W, N, 3).

    state (W, N, 5) holds u, v (2) and w (2), each of unit variance; noise (W, N, 5) is standard normal. u is along the
    steady wind (W, 3) (east where there is none), v to its left, w up; the air passes at the drone's speed against it.
    """
    for w in range(state.shape[0]):
        size = math.hypot(steady[w, 0], steady[w, 1])
        ex, ey = (steady[w, 0] / size, steady[w, 1] / size) if size > 1e-9 else (1.0, 0.0)
        for i in range(state.shape[1]):
            x, n, v = state[w, i], noise[w, i], velocity[w, i]
            length_u, length_w, s_u, s_w = dryden_scales(position[w, i, 2], wind20)
            air = (v[0] - steady[w, 0], v[1] - steady[w, 1], v[2] - steady[w, 2])
            passed = dt * max(math.sqrt(dot(air, air)), SLOWEST)
            x[0] = first_order(x[0], passed / length_u, n[0])
            x[1], x[2] = second_order(x[1], x[2], passed / length_u, n[1], n[2])
            x[3], x[4] = second_order(x[3], x[4], passed / length_w, n[3], n[4])
            along = s_u * x[0]
            left = s_u * (0.5 * x[1] + math.sqrt(0.75) * x[2])
            wind[w, i, 0] += along * ex - left * ey
            wind[w, i, 1] += along * ey + left * ex
            wind[w, i, 2] += s_w * (0.5 * x[3] + math.sqrt(0.75) * x[4])


class Wind:
    """The wind of all worlds: steady or a field, with Dryden gusts on top where `wind20` is above 0.

    given   (3,) the steady wind asked for, m/s; zero for a field
    steady  (W, 3) that of each world, which may be set; beside a field it adds to it
    """

    def __init__(
        self,
        steady: tuple[float, float, float] | WindField,
        wind20: float,
        shape: tuple[int, int],
        dt: float,
    ):
        """`wind20`: wind speed at 20 feet that sets the turbulence, m/s; shape (W, N); dt between samples, s."""
        self._field = steady if callable(steady) else None
        self.given = np.zeros(3) if callable(steady) else np.array(steady, dtype=float)
        self.steady = np.tile(self.given, (shape[0], 1))
        self._wind20, self._dt = wind20, dt
        self._shape = shape
        self._gusts = np.zeros((*shape, 5))

    def reset(self, world: int, rng: np.random.Generator) -> None:
        """Start the gusts of one world in their stationary distribution."""
        if self._wind20 > 0:
            self._gusts[world] = rng.standard_normal(self._gusts[world].shape)

    def sample(
        self,
        swarm: Swarm,
        time: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
        flying: np.ndarray,
    ) -> np.ndarray:
        """(W, N, 3) m/s for the next decision; `time` (W,) s; only worlds of `flying` (W,) draw from their generators.

        Raises ValueError when the wind field gives another shape or numbers that are not finite.
        """
        wind = np.empty((*self._shape, 3))
        wind[:] = self.steady[:, None]
        if self._field is not None:
            wind += self._checked(self._field(swarm.position.copy(), time.copy()))
        if self._wind20 > 0:
            noise = np.zeros_like(self._gusts)
            for k in np.flatnonzero(flying).tolist():
                rng = rngs[k]
                assert rng is not None  # a world that flies was reset
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
        given = numbers_of("what the wind function gave is", wind)
        if given.shape != (*self._shape, 3):
            raise ValueError(
                f"the wind function gave shape {given.shape}: finite numbers of shape {(*self._shape, 3)} are needed"
            )
        wrong = ~np.isfinite(given)
        if wrong.any():
            w, i, _ = np.argwhere(wrong)[0]
            raise ValueError(
                f"the wind function gave shape {given.shape} with {given[w, i]} m/s at drone {i} in world {w}: "
                f"finite numbers are needed"
            )
        return given


def check_field(wind: WindField) -> None:
    """Raise ValueError unless a wind function takes positions and times; one that does not tell what it takes may pass."""
    if inspect.isclass(wind):
        raise ValueError(
            f"wind is the class {wind.__name__}: a function of positions and times is needed"
        )
    try:
        signature = inspect.signature(wind)
    except (TypeError, ValueError):  # of functions written in C
        return
    try:
        signature.bind(None, None)
    except TypeError as error:
        raise ValueError(
            f"wind is a function that does not take positions and times: {error}"
        ) from None
