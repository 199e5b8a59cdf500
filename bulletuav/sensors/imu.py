"""Inertial measurement: an accelerometer and a gyroscope with white noise and biases that walk."""

from collections.abc import Sequence

import numpy as np

from bulletuav.geometry.rotation import to_body, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.airframe import STANDARD_GRAVITY
from bulletuav.vehicle.swarm import Swarm, get


@func
def specific_force(quaternion, before, after, period, gravity):
    """What an accelerometer feels (m/s^2, body): R^T (a - g), a the mean acceleration from one velocity to another (world).

    Source: P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems (2013).
    """
    x, y, z = (
        (after[0] - before[0]) / period,
        (after[1] - before[1]) / period,
        (after[2] - before[2]) / period,
    )
    return to_body(quaternion, (x, y, z + gravity))


@kernel
def _measure(worlds, before, after, period, gravity, scale, normal, root, bias, reading):
    """Advance bias and reading (W, N, 2, 3) of the listed worlds; scale (W, N, 4) and normal (W, N, 4, 3) as in `Imu`."""
    for w in worlds:
        for i in range(reading.shape[1]):
            _, quaternion, velocity, rates = get(after, w, i)
            truth = (
                specific_force(quaternion, vec3(before.velocity, w, i), velocity, period, gravity),
                rates,
            )
            for s in range(2):
                for k in range(3):
                    bias[w, i, s, k] += root * scale[w, i, s] * normal[w, i, s, k]
                    white = scale[w, i, 2 + s] * normal[w, i, 2 + s, k]
                    reading[w, i, s, k] = truth[s][k] + bias[w, i, s, k] + white


class Imu:
    """What W worlds of N drones feel of their motion, in body axes FLU.

    acceleration_noise, rates_noise  (W, N) standard deviation of each axis, m/s^2, rad/s
    acceleration_walk, rates_walk    (W, N) random walk of each axis's bias after one second, growing with the root of time
    acceleration  (W, N, 3) specific force, m/s^2: gravity upwards at rest, none in free fall
    rates         (W, N, 3) angular velocity, rad/s
    """

    def __init__(self, shape: tuple[int, int], period: float, gravity: float = STANDARD_GRAVITY):
        """`period` between readings, s; `gravity` m/s^2."""
        self.acceleration_noise, self.rates_noise, self.acceleration_walk, self.rates_walk = (
            np.zeros((4, *shape))
        )
        self._bias, self._reading = np.zeros((2, *shape, 2, 3))
        self.acceleration, self.rates = self._reading[:, :, 0], self._reading[:, :, 1]
        self._normal = np.zeros((*shape, 4, 3))  # for the two walks, then for the two noises
        self._period, self._gravity = period, gravity

    def start(self, k: int, swarm: Swarm, rng: np.random.Generator) -> None:
        """First readings of world k, whose drones fly steadily so far; its biases are none yet."""
        self._bias[k] = 0
        self._draw(k, rng)
        self._take(np.array([k]), swarm, swarm, 0.0)

    def read(
        self,
        before: Swarm,
        after: Swarm,
        flying: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
    ) -> None:
        """Readings after a decision in the worlds of `flying` (W,), of the swarm `before` and `after` it.

        The acceleration is the mean over the decision, attitude and rates are those after it. Each world draws from its own
        generator, if noise or walk is asked for.
        """
        worlds = np.flatnonzero(flying)
        for k in worlds.tolist():
            self._draw(k, rngs[k])
        self._take(worlds, before, after, np.sqrt(self._period))

    def _draw(self, k: int, rng: np.random.Generator | None) -> None:
        if any(scale[k].any() for scale in self._scales()):
            assert rng is not None  # a world that flies was reset
            rng.standard_normal(out=self._normal[k])

    def _take(self, worlds: np.ndarray, before: Swarm, after: Swarm, root: float) -> None:
        """`root` of the time in s that biases walked."""
        scale = np.stack(self._scales(), axis=-1)
        _measure(
            worlds,
            before,
            after,
            self._period,
            self._gravity,
            scale,
            self._normal,
            root,
            self._bias,
            self._reading,
        )

    def _scales(self) -> tuple[np.ndarray, ...]:
        return self.acceleration_walk, self.rates_walk, self.acceleration_noise, self.rates_noise
