"""Users whose velocities change gradually: the Gauss-Markov model.

B. Liang and Z. Haas, Predictive distance-based mobility management for PCS networks, INFOCOM 1999; T. Camp, J. Boleng and
V. Davies, A survey of mobility models for ad hoc network research, WCMC 2(5), 2002.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.kernel import elementwise, kernel
from bulletuav.network.mobility.base import (
    LONGEST,
    MOST_SPEED,
    Generators,
    State,
    Walking,
    headings,
    normals,
)
from bulletuav.network.mobility.ground import Ground, bounce, length

CORRELATION_TIME = -1 / math.log(0.75)  # s; velocities a second apart have the correlation 0.75
MOST_DEVIATIONS = 4.0


@elementwise
def gauss_markov(value, mean, keep, deviation, normal):
    """The next value of a Gauss-Markov process: keep v + (1 - keep) mean + deviation sqrt(1 - keep^2) w (Liang and Haas).

    Its stationary mean and standard deviation are `mean` and `deviation`, its correlation over k steps keep^k; `normal` is
    a standard normal number. Steps of dt in a process of correlation time tau keep exp(-dt / tau).
    """
    return keep * value + (1.0 - keep) * mean + deviation * math.sqrt(1.0 - keep * keep) * normal


@dataclass(frozen=True)
class GaussMarkov(Walking):
    """Each user's velocity is a Gauss-Markov process about a mean velocity of its own: a random heading, `speed` fast.

    Nobody is faster than the mean speed and 4 deviations: such velocities are shortened. At walls and the edge users turn
    as light does by mirrors, and their mean velocity turns away from the wall.

    correlation_time  of velocities, s
    deviation         standard deviation of each axis of the velocity, m/s
    """

    name: ClassVar[str] = "gauss_markov"
    correlation_time: float = CORRELATION_TIME
    deviation: float = 0.5

    def __post_init__(self):
        super().__post_init__()
        self._size("correlation_time", " s", LONGEST, above_zero=True)
        self._size("deviation", " m/s", MOST_SPEED, above_zero=False)

    @property
    def max_speed(self) -> float:
        """No user is ever faster, m/s."""
        return self.speed[1] + MOST_DEVIATIONS * self.deviation

    def state(self, count: int) -> dict[str, tuple[int, ...]]:
        """Also "user_mean_velocity" (U, 2) m/s."""
        return super().state(count) | {"user_mean_velocity": (count, 2)}

    def start(self, rng: np.random.Generator, ground: Ground, layout: int, count: int) -> State:
        """At random places, with velocities of the stationary distribution."""
        places = ground.places(rng, layout, count)
        mean = rng.uniform(*self.speed, (count, 1)) * headings(rng, count)
        velocity = mean + self.deviation * rng.standard_normal((count, 2))
        most = np.linalg.norm(mean, axis=1) + MOST_DEVIATIONS * self.deviation
        velocity *= np.minimum(1, most / np.linalg.norm(velocity, axis=1))[:, None]
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
        velocity, mean = state["user_velocity"], state["user_mean_velocity"]
        noise = normals(rng, flying, *velocity.shape[1:])
        keep = math.exp(-dt / self.correlation_time)
        advance(
            state["users"],
            velocity,
            mean,
            noise,
            ground.raster,
            layout,
            flying,
            dt,
            keep,
            self.deviation,
        )


@kernel
def advance(users, velocity, mean, noise, raster, layout, flying, dt, keep, deviation):
    """Move users (W, U, 3) of velocities and means (W, U, 2) through dt s; noise (W, U, 2) is standard normal."""
    for w in range(users.shape[0]):
        if not flying[w]:
            continue
        for i in range(users.shape[1]):
            x = gauss_markov(velocity[w, i, 0], mean[w, i, 0], keep, deviation, noise[w, i, 0])
            y = gauss_markov(velocity[w, i, 1], mean[w, i, 1], keep, deviation, noise[w, i, 1])
            speed = length(x, y)
            most = length(mean[w, i, 0], mean[w, i, 1]) + MOST_DEVIATIONS * deviation
            if speed > most:
                x, y = x * most / speed, y * most / speed
            users[w, i, 0], users[w, i, 1], turned_x, turned_y = bounce(
                raster, layout[w], users[w, i, 0], users[w, i, 1], x * dt, y * dt
            )
            velocity[w, i, 0], velocity[w, i, 1] = turned_x * x, turned_y * y
            if turned_x < 0.0:
                mean[w, i, 0] = math.copysign(mean[w, i, 0], velocity[w, i, 0])
            if turned_y < 0.0:
                mean[w, i, 1] = math.copysign(mean[w, i, 1], velocity[w, i, 1])
