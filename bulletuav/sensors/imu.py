"""Inertial measurement unit: accelerometer and gyroscope with white noise and bias random walks."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.engine.engine import Engine
from bulletuav.geometry.rotation import Quat4Like, Vec3, Vec3Like, to_body, vec3
from bulletuav.registry import register
from bulletuav.sensors.base import (
    Moment,
    Sensor,
    SensorSetup,
    Uncertain,
    vector_labels,
)
from bulletuav.vehicle.swarm import Swarm, get_state

MAX_FORCE = 100.0
"""Bound of an observed specific force, m/s^2"""
MAX_BODY_RATE = 50.0
"""Bound of an observed angular velocity, rad/s"""


@func
def specific_force(
    quaternion: Quat4Like, before: Vec3Like, after: Vec3Like, period: float, gravity: float
) -> Vec3:
    """Compute the specific force R^T (a - g) that an accelerometer measures.

    Args:
        quaternion: Attitude, body to world.
        before: Initial velocity, m/s, world axes.
        after: Final velocity, m/s, world axes.
        period: Time between the two, s; a is the mean acceleration.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        Specific force, m/s^2, body axes.

    References:
        P. D. Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems
        (2013).
    """
    x = (after[0] - before[0]) / period
    y = (after[1] - before[1]) / period
    z = (after[2] - before[2]) / period
    return to_body(quaternion, (x, y, z + gravity))


@kernel
def _measure(
    worlds: np.ndarray,
    before: Swarm,
    after: Swarm,
    period: float,
    gravity: np.ndarray,
    scale: np.ndarray,
    normal: np.ndarray,
    root: float,
    bias: np.ndarray,
    reading: np.ndarray,
) -> None:
    """Update bias and reading (W, N, 2, 3) of the listed worlds.

    `scale` (W, N, 4) and `normal` (W, N, 4, 3) are ordered: two random walks, then two white
    noises.
    """
    for w in worlds:
        for i in range(reading.shape[1]):
            _, quaternion, velocity, rates = get_state(after, w, i)
            start = vec3(before.velocity, w, i)
            force = specific_force(quaternion, start, velocity, period, gravity[w, i])
            truth = force, rates
            for s in range(2):
                for k in range(3):
                    # Advance the bias, then add bias and white noise to the true value.
                    bias[w, i, s, k] += root * scale[w, i, s] * normal[w, i, s, k]
                    white = scale[w, i, 2 + s] * normal[w, i, 2 + s, k]
                    reading[w, i, s, k] = truth[s][k] + bias[w, i, s, k] + white


@register("sensor")
class Imu(Sensor):
    """Specific force and angular velocity in body axes (forward, left, up).

    Attributes:
        accelerometer_noise: (W, N) standard deviation of the white noise on each axis, m/s^2.
        gyroscope_noise: (W, N) standard deviation of the white noise on each axis, rad/s.
        accelerometer_walk: (W, N) random walk of the bias on each axis after one second, m/s^2.
        gyroscope_walk: (W, N) random walk of the bias on each axis after one second, rad/s; both
            grow with the square root of time.
        acceleration: (W, N, 3) specific force, m/s^2: gravity upwards at rest, zero in free fall.
        rates: (W, N, 3) angular velocity, rad/s.
    """

    name = "imu"
    prefix = ""
    numbers = (
        *vector_labels("force", "m/s^2", [-MAX_FORCE] * 3, [MAX_FORCE] * 3),
        *vector_labels("rates", "rad/s", [-MAX_BODY_RATE] * 3, [MAX_BODY_RATE] * 3),
    )
    uncertain: ClassVar = {
        "accelerometer_noise": Uncertain(0.0, 1000.0),
        "accelerometer_walk": Uncertain(0.0, 1000.0),
        "gyroscope_noise": Uncertain(0.0, 1000.0),
        "gyroscope_walk": Uncertain(0.0, 1000.0),
    }

    accelerometer_noise: np.ndarray
    accelerometer_walk: np.ndarray
    gyroscope_noise: np.ndarray
    gyroscope_walk: np.ndarray

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate biases, readings and random numbers."""
        super().attach(setup, engine)
        self._bias, self._reading = np.zeros((2, *setup.shape, 2, 3))
        self.acceleration = self._reading[:, :, 0]
        self.rates = self._reading[:, :, 1]
        self._gravity = np.full(setup.shape, float(setup.gravity))
        self._normal = np.zeros((*setup.shape, 4, 3))  # two random walks, then two white noises

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Take the first readings of a world, without acceleration and biases."""
        self._bias[world] = 0
        self._draw(world, rng)
        self._take(np.array([world]), swarm, swarm, 0.0, self._gravity)

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Measure the mean acceleration over the decision, and the angular velocity after it.

        Each world draws from its own generator if its noise or walk is above 0.
        """
        worlds = np.flatnonzero(moment.flying)
        for k in worlds.tolist():
            self._draw(k, moment.rngs[k])
        gravity = self._gravity if moment.gravity is None else moment.gravity
        self._take(worlds, moment.before, moment.after, np.sqrt(self.setup.period), gravity)
        return {"imu": np.concatenate([self.acceleration, self.rates], axis=-1)}

    def _draw(self, world: int, rng: np.random.Generator) -> None:
        if any(scale[world].any() for scale in self._scales()):
            rng.standard_normal(out=self._normal[world])

    def _take(
        self, worlds: np.ndarray, before: Swarm, after: Swarm, root: float, gravity: np.ndarray
    ) -> None:
        """Measure in `worlds`; `root` is the square root of the elapsed time, s, for the walks."""
        period = self.setup.period
        scale = np.stack(self._scales(), axis=-1)
        state = (self._normal, root, self._bias, self._reading)
        _measure(worlds, before, after, period, gravity, scale, *state)

    def _scales(self) -> tuple[np.ndarray, ...]:
        walks = (self.accelerometer_walk, self.gyroscope_walk)
        return *walks, self.accelerometer_noise, self.gyroscope_noise
