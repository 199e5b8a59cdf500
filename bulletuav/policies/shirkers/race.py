"""Policies that avoid the task `race`, or race without regard to others."""

import numpy as np

from bulletuav.policies.race_pilot import RacePilot
from bulletuav.policies.scripted import Scripted
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

NEVER = 1e6
"""Time of starts that do not happen, s"""
BESIDE = np.array((2.0, 4.0, 0.0))
"""Position beside a gate, outside its frame, forward, left and up, m"""
ABOVE = np.array((-2.0, 0.0, 4.0))
"""Position above and before a gate, forward, left and up, m"""


@register("policy")
class RaceAlone(RacePilot):
    """Race with one drone, while the others wait on their blocks, so that no conflict occurs."""

    name = "race_alone"
    headway = NEVER


@register("policy")
class RaceRush(RacePilot):
    """Race without waiting for the drone ahead, so that drones get into each other's way."""

    name = "race_rush"
    headway = 0.1


@register("policy")
class RaceStop(RacePilot):
    """Pass half of the gates, and hover there in safety."""

    name = "race_stop"

    def _stops(self) -> np.ndarray:
        """Return which drones have passed half of the gates, (W, N) bool."""
        stops: np.ndarray = 2 * self._memory("passed") >= self._task.turns
        return stops

    def _is_lost(self, now: np.ndarray) -> np.ndarray:
        """Return which drones need a new line; see `RacePilot`. Stopped drones do not."""
        lost: np.ndarray = super()._is_lost(now) & ~self._stops()
        return lost

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Stop after half of the gates; see `Policy.act`."""
        actions = super().act(observations, swarm)
        still = self.encoded(np.zeros(swarm.position.shape))
        return np.where(self._stops()[..., None], still, actions)


class RaceHover(Scripted):
    """Base class of policies by which one drone hovers near a gate and the others wait.

    Attributes:
        gate: Index of the gate, negative from the last one.
        offset: (3,) position in the axes of the gate, m.
    """

    gate: int
    offset: np.ndarray

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return the velocities of the first drones to the position; see `Scripted.velocities`."""
        memory = self.aviary.scene.memory
        axes = memory["gate_axis"][:, self.gate]
        target = memory["gate"][:, self.gate] + (self.offset[:, None] * axes).sum(axis=1)
        velocity = np.zeros(swarm.position.shape)
        velocity[:, 0] = target - swarm.position[:, 0]
        return velocity


@register("policy")
class RaceBeside(RaceHover):
    """Fly beside the first gate instead of through it."""

    name = "race_beside"
    gate = 0
    offset = BESIDE


@register("policy")
class RaceWaiting(RaceHover):
    """Fly to the last gate, and wait there without passing any."""

    name = "race_waiting"
    gate = -1
    offset = ABOVE
