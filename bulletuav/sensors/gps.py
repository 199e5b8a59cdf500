"""Satellite positioning: white noise, a random walk, and readings that fail to come."""

import numpy as np

VELOCITY_SHARE = 0.1  # 1/s; error of a velocity, measured by Doppler shift, for each metre of position error


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
        self._root = np.sqrt(period)

    def start(self, k: int, position: np.ndarray, velocity: np.ndarray, rng: np.random.Generator) -> None:
        """First readings of world k, (N, 3), which do not fail."""
        self._drift[k] = 0
        self._read(k, position, velocity, rng, np.ones(len(position), dtype=bool))

    def read(self, k: int, position: np.ndarray, velocity: np.ndarray, rng: np.random.Generator) -> None:
        """The next readings of world k, from true states (N, 3)."""
        self._drift[k] += self._root * self.walk[k][:, None] * rng.standard_normal(position.shape)
        self._read(k, position, velocity, rng, rng.random(len(position)) >= self.dropout[k])

    def _read(self, k, position, velocity, rng, comes) -> None:
        errors = self.noise[k][:, None, None] * rng.standard_normal((len(position), 2, 3))
        self.position[k, comes] = (position + self._drift[k] + errors[:, 0])[comes]
        self.velocity[k, comes] = (velocity + VELOCITY_SHARE * errors[:, 1])[comes]
