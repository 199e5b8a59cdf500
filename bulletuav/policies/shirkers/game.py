"""Policies of chasers that avoid the task `pursuit_evasion`."""

import numpy as np

from bulletuav.policies.pursuers import Lead
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

SHADOWING_DISTANCE = 3.0
"""Distance at which evaders are followed, in capture radii"""


@register("policy")
class ChaseShadow(Lead):
    """Close in on the nearest evader, but follow it at a distance instead of capturing it."""

    name = "chase_shadow"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities that keep the distance; see `Game.velocities`."""
        scene, near = self.aviary.scene, SHADOWING_DISTANCE * self.aviary.task.config.capture_radius
        distance = np.linalg.norm(scene.goal - swarm.position, axis=-1, keepdims=True)
        return np.where(distance > near, super().velocities(swarm), scene.goal_velocity)


@register("policy")
class ChaseFreeRide(Lead):
    """Let the first chaser work, and stay in place with all others."""

    name = "chase_free_ride"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities of the first chaser alone; see `Game.velocities`."""
        velocities = super().velocities(swarm)
        velocities[:, 1:] = 0.0
        return velocities


@register("policy")
class ChaseOnce(Lead):
    """Chase until the team has captured one evader, then stay in place."""

    name = "chase_once"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return zeros after the first capture; see `Game.velocities`."""
        captures = self.aviary.scene.memory["captures"].sum(axis=1)[:, None, None]
        return np.where(captures > 0, 0.0, super().velocities(swarm))
