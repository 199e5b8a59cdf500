"""Policy `station_keeper`: follows a moving goal with feed-forward of its acceleration."""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

APPROACH = 2.0
"""Gain from distance to speed, 1/s"""
LEAD = 0.35
"""Look-ahead of the goal's velocity, s: lag of the velocity loop plus half of a decision"""


@register("policy")
class StationKeeper(Policy):
    """Flight with the velocity that the goal is going to have, plus a correction to its position.

    The acceleration of the goal is the change of its velocity in the last decision. Other drones
    and obstacles are not considered.
    """

    name = "station_keeper"
    actions = ("velocity",)
    reads_swarm = True
    remembers = ("_goal_velocity",)

    def __init__(self, aviary: Aviary) -> None:
        """Start without velocities of goals; see `Policy`."""
        super().__init__(aviary)
        self._goal_velocity = np.full((*aviary.alive.shape, 3), np.nan)

    def reset(self, mask: np.ndarray) -> None:
        """Drop the velocities of the goals in the worlds of `mask` (W,)."""
        self._goal_velocity[mask] = np.nan

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities to the goals; see `Policy.act`."""
        scene, options = self.aviary.scene, self.aviary.options
        change = np.nan_to_num(scene.goal_velocity - self._goal_velocity)
        self._goal_velocity = scene.goal_velocity.copy()
        ahead = scene.goal_velocity + LEAD * options.decision_hz * change
        velocity = ahead + APPROACH * (scene.goal - swarm.position)
        return self.encoded(limit_norm(velocity, options.max_speed))
