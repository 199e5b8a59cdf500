"""Gauss-Markov mobility model: users with gradually changing velocities.

References:
    B. Liang and Z. Haas, Predictive distance-based mobility management for PCS networks, INFOCOM
    1999; T. Camp, J. Boleng and V. Davies, A survey of mobility models for ad hoc network research,
    WCMC 2(5), 2002.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import exp, log
from bulletuav.compiled.kernel import elementwise, kernel
from bulletuav.network.mobility.base import (
    MAX_TIME,
    MAX_VELOCITY,
    SPEED_LIMIT,
    Generators,
    State,
    Walking,
    random_headings,
    standard_normals,
)
from bulletuav.network.mobility.ground import Ground
from bulletuav.network.mobility.raster import Raster, bounce, length
from bulletuav.registry import register

CORRELATION_TIME = -1 / log(0.75)
"""Default correlation time, s: velocities one second apart have correlation 0.75"""
MAX_DEVIATIONS = 4.0
"""Maximum excess over the mean speed, in standard deviations"""


@elementwise
def gauss_markov(
    value: float, mean: float, correlation: float, deviation: float, normal: float
) -> float:
    """Return the next value of a Gauss-Markov process (Liang and Haas).

    For a correlation a, the next value is a v + (1 - a) mean + deviation sqrt(1 - a^2) w. The
    correlation over k steps is a^k. For steps of dt and a correlation time tau, a = exp(-dt / tau).

    Args:
        value: Current value v.
        mean: Stationary mean.
        correlation: Correlation a of consecutive values.
        deviation: Stationary standard deviation.
        normal: Standard normal number w.
    """
    noise = deviation * math.sqrt(1.0 - correlation * correlation) * normal
    return correlation * value + (1.0 - correlation) * mean + noise


@register("mobility")
@dataclass(frozen=True)
class GaussMarkov(Walking):
    """Gauss-Markov mobility model.

    The velocity of each user is a Gauss-Markov process around a mean velocity with a random heading
    and a speed drawn from `speed`. Speeds are limited to the mean speed plus 4 deviations. At walls
    and at the edge, users are reflected, and their mean velocity is turned away from the wall.

    Attributes:
        correlation_time: Correlation time of velocities, s.
        deviation: Standard deviation of each component of the velocity, m/s.
    """

    name: ClassVar[str] = "gauss_markov"
    correlation_time: float = CORRELATION_TIME
    deviation: float = 0.5

    def __post_init__(self) -> None:
        """Validate the options."""
        super().__post_init__()
        self._check_number("correlation_time", unit=" s", most=MAX_TIME, above_zero=True)
        self._check_number("deviation", unit=" m/s", most=SPEED_LIMIT, above_zero=False)

    @property
    def max_speed(self) -> float:
        """Maximum speed of users, m/s."""
        return self.speed[1] + MAX_DEVIATIONS * self.deviation

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Return the state arrays, see `Mobility.state`.

        The additional array is "user_mean_velocity" (U, 2), m/s.
        """
        return super().state(count) | {"user_mean_velocity": (count, 2)}

    def bounds(self, ground: Ground) -> dict[str, tuple[Any, Any]]:
        """Return the bounds of the state arrays, see `Mobility.bounds`."""
        mean = {"user_mean_velocity": (-MAX_VELOCITY, MAX_VELOCITY)}
        return super().bounds(ground) | mean

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """Draw random positions, and velocities from the stationary distribution.

        See `Mobility.start`.
        """
        places = ground.places(rng, layout, count)
        speed = rng.uniform(*self.speed, (count, 1))
        mean = speed * random_headings(rng, count)
        velocity = mean + self.deviation * rng.standard_normal((count, 2))
        # Limit the speed
        fastest = np.linalg.norm(mean, axis=1) + MAX_DEVIATIONS * self.deviation
        velocity *= np.minimum(1, fastest / np.linalg.norm(velocity, axis=1))[:, None]
        return {"users": places, "user_velocity": velocity, "user_mean_velocity": mean}

    def _move(
        self,
        state: State,
        ground: Ground,
        layout: np.ndarray,
        flying: np.ndarray,
        dt: float,
        rng: Generators,
    ) -> None:
        """Advance users as `move`."""
        velocity = state["user_velocity"]
        # One normal number for each user and axis
        noise = standard_normals(rng, flying, *velocity.shape[1:])
        correlation = exp(-dt / self.correlation_time)
        advance_gauss_markov(
            state["users"],
            velocity,
            state["user_mean_velocity"],
            noise,
            ground.raster,
            layout,
            flying,
            dt,
            correlation,
            self.deviation,
        )


@kernel
def advance_gauss_markov(
    users: np.ndarray,
    velocity: np.ndarray,
    mean: np.ndarray,
    noise: np.ndarray,
    raster: Raster,
    layout: np.ndarray,
    flying: np.ndarray,
    dt: float,
    correlation: float,
    deviation: float,
) -> None:
    """Advance users by one time step, in place.

    Args:
        users: Positions (W, U, 3), m; modified.
        velocity: Velocities (W, U, 2), m/s; modified.
        mean: Mean velocities (W, U, 2), m/s; modified at walls.
        noise: Standard normal numbers (W, U, 2).
        raster: Free cells of all layouts.
        layout: Layout (W,) of each world.
        flying: Whether (W,) users of each world move.
        dt: Length of the step, s.
        correlation: Correlation of velocities `dt` apart.
        deviation: Standard deviation of each component of the velocity, m/s.
    """
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        for i in range(users.shape[1]):
            # Next velocity
            x = gauss_markov(
                velocity[w, i, 0], mean[w, i, 0], correlation, deviation, noise[w, i, 0]
            )
            y = gauss_markov(
                velocity[w, i, 1], mean[w, i, 1], correlation, deviation, noise[w, i, 1]
            )
            speed = length(x, y)
            # Limit the speed in the tails of the distribution
            fastest = length(mean[w, i, 0], mean[w, i, 1]) + MAX_DEVIATIONS * deviation
            if speed > fastest:
                x = x * fastest / speed
                y = y * fastest / speed
            # Move, with reflections at walls
            end_x, end_y, turned_x, turned_y = bounce(
                raster, layout[w], users[w, i, 0], users[w, i, 1], x * dt, y * dt
            )
            users[w, i, 0] = end_x
            users[w, i, 1] = end_y
            velocity[w, i, 0] = turned_x * x
            velocity[w, i, 1] = turned_y * y
            # Turn the mean velocity, too, so that users do not stay at the wall
            if turned_x < 0.0:
                mean[w, i, 0] = math.copysign(mean[w, i, 0], velocity[w, i, 0])
            if turned_y < 0.0:
                mean[w, i, 1] = math.copysign(mean[w, i, 1], velocity[w, i, 1])
