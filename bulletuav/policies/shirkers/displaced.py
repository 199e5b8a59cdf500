"""Base class of policies that keep away from their goals by an offset."""

from abc import abstractmethod

import numpy as np

from bulletuav.policies.scripted import Scripted
from bulletuav.policies.station_keeper import APPROACH
from bulletuav.vehicle.swarm import Swarm

LATE = 0.9
"""Fraction of the episode after which policies that arrive late fly to their goals"""
HALF = 0.5
"""Fraction of the episode after which policies that leave early do so"""


class Displaced(Scripted):
    """Base class of policies that hold an offset from their goals."""

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the goals plus `offsets`; see `Scripted.velocities`."""
        scene = self.aviary.scene
        target = scene.goal + self.offsets(swarm)
        velocity: np.ndarray = scene.goal_velocity + APPROACH * (target - swarm.position)
        return velocity

    @abstractmethod
    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return the offsets from the goals, which broadcast to (W, N, 3), m."""

    def is_after(self, fraction: float) -> np.ndarray:
        """Return whether a fraction of the episode has passed, (W, 1, 1) bool."""
        late: np.ndarray = self.aviary.steps >= fraction * self.aviary.options.horizon
        return late[:, None, None]
