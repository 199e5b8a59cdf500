"""Satellite positioning: white noise, a random walk, and readings that fail to come."""

from collections.abc import Sequence

import numpy as np

VELOCITY_SHARE = (
    0.1  # 1/s; error of a velocity, measured by Doppler shift, for each metre of position error
)


class Gps:
    """What W worlds of N drones read of themselves; a reading that fails leaves the last one.

    noise     (W, N) standard deviation of each axis, m; a tenth of it, in m/s, for velocities
    walk      (W, N) random walk of each axis, m after one second, growing with the root of time
    dropout   (W, N) probability that a reading fails
    position, velocity  (W, N, 3) the readings, m, m/s
    """

    def __init__(self, shape: tuple[int, int], period: float):
        """`period` between readings, s."""
        self.noise, self.walk, self.dropout = np.zeros((3, *shape))
        self.position, self.velocity, self._drift = np.zeros((3, *shape, 3))
        self._normal, self._uniform = np.zeros((*shape, 3, 3)), np.zeros(shape)
        self._root = np.sqrt(period)

    def start(
        self, k: int, position: np.ndarray, velocity: np.ndarray, rng: np.random.Generator
    ) -> None:
        """First readings of world k, whose drones are at (N, 3) m and fly at (N, 3) m/s; they do not fail."""
        self._drift[k] = 0
        errors = self.noise[k][:, None, None] * rng.standard_normal((len(position), 2, 3))
        self.position[k] = position + errors[:, 0]
        self.velocity[k] = velocity + VELOCITY_SHARE * errors[:, 1]

    def read(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        flying: np.ndarray,
        rngs: Sequence[np.random.Generator | None],
    ) -> None:
        """The next readings in the worlds of `flying` (W,), of true states (W, N, 3); each draws from its own generator."""
        for k in np.flatnonzero(flying).tolist():
            rng = rngs[k]
            assert rng is not None  # a world that flies was reset
            rng.standard_normal(out=self._normal[k])
            rng.random(out=self._uniform[k])
        moves = flying[:, None, None]
        self._drift += moves * (self._root * self.walk[..., None] * self._normal[:, :, 0])
        errors = self.noise[..., None, None] * self._normal[:, :, 1:]
        comes = moves & (self._uniform >= self.dropout)[..., None]
        np.copyto(self.position, position + self._drift + errors[:, :, 0], where=comes)
        np.copyto(self.velocity, velocity + VELOCITY_SHARE * errors[:, :, 1], where=comes)
