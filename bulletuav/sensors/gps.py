"""Satellite positioning with white noise, random walk and dropouts."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from bulletuav.engine.engine import Engine
from bulletuav.registry import register
from bulletuav.sensors.base import Image, Label, Moment, Sensor, SensorSetup, Uncertain
from bulletuav.vehicle.swarm import Swarm

VELOCITY_FRACTION = 0.1
"""1/s; error of the velocity, which is measured by Doppler shift, per position error"""


@register("sensor")
class Gps(Sensor):
    """Position and velocity as the drones know them; on a dropout the last reading is held.

    Attributes:
        noise: (W, N) standard deviation of the position noise on each axis, m; a tenth of it, in
            m/s, for velocities.
        walk: (W, N) standard deviation of the random walk on each axis after one second, m; it
            grows with the square root of time.
        dropout: (W, N) probability of a dropout.
        position: (W, N, 3) readings, m.
        velocity: (W, N, 3) readings, m/s.
    """

    name = "gps"
    gives = ("position", "velocity")
    uncertain: ClassVar = {
        "noise": Uncertain(0.0, 1000.0),
        "walk": Uncertain(0.0, 1000.0),
        "dropout": Uncertain(0.0, 1.0),
    }
    always_if_uncertain = True

    noise: np.ndarray
    walk: np.ndarray
    dropout: np.ndarray

    def labels(self, setup: SensorSetup) -> Mapping[str, tuple[Label, ...] | Image]:
        """Return no labels: the blocks "position" and "velocity" observe these readings."""
        return {}

    def attach(self, setup: SensorSetup, engine: Engine) -> None:
        """Allocate readings and random numbers."""
        super().attach(setup, engine)
        self.position, self.velocity, self._drift = np.zeros((3, *setup.shape, 3))
        self._normal = np.zeros(
            (*setup.shape, 3, 3)
        )  # random walk, then position and velocity noise
        self._uniform = np.zeros(setup.shape)
        self._root = np.sqrt(setup.period)

    def reset(self, world: int, swarm: Swarm, known: Swarm, rng: np.random.Generator) -> None:
        """Take the first readings of a world, which never drop out."""
        self._drift[world] = 0
        normal = rng.standard_normal((self.setup.shape[1], 2, 3))
        errors = self.noise[world][:, None, None] * normal
        self.position[world] = swarm.position[world] + errors[:, 0]
        self.velocity[world] = swarm.velocity[world] + VELOCITY_FRACTION * errors[:, 1]

    def measure(self, moment: Moment) -> Mapping[str, np.ndarray]:
        """Take the next readings in the worlds that executed a decision."""
        flying = moment.flying
        if flying.any():
            self._read(moment.after, flying, moment.rngs)
        return {"position": self.position.copy(), "velocity": self.velocity.copy()}

    def _read(self, swarm: Swarm, flying: np.ndarray, rngs: Sequence[np.random.Generator]) -> None:
        for k in np.flatnonzero(flying).tolist():
            rngs[k].standard_normal(out=self._normal[k])
            rngs[k].random(out=self._uniform[k])
        moves = flying[:, None, None]
        # The random walk continues during dropouts.
        self._drift += moves * (self._root * self.walk[..., None] * self._normal[:, :, 0])
        errors = self.noise[..., None, None] * self._normal[:, :, 1:]
        comes = moves & (self._uniform >= self.dropout)[..., None]
        position = swarm.position + self._drift + errors[:, :, 0]
        np.copyto(self.position, position, where=comes)
        np.copyto(self.velocity, swarm.velocity + VELOCITY_FRACTION * errors[:, :, 1], where=comes)
