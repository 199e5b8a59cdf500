"""Oracle of `interception`: pursues the evader by its true state and the true terrain."""

import numpy as np

from bulletuav.policies.base import require_supported_task
from bulletuav.policies.pursuers import Lead
from bulletuav.registry import register
from bulletuav.tasks.interception import Interception
from bulletuav.vehicle.swarm import Swarm

NEAR = 12.0
"""Distance to the evader below which a drone flies straight at it, m"""
WAITING = 10.0
"""Distance to the evader below which all drones but the nearest keep their distance, m"""
CLEARANCE = 3.0
"""Height above the lowest heights of paths until then, m"""


@register("policy")
class InterceptionOracle(Lead):
    """Flight to the intercept point of the true evader, clear of terrain, but not of the evader."""

    name = "interception_oracle"

    def spheres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return no spheres, as the evader is the only one; see `Avoidance.spheres`."""
        nothing = np.zeros((self.aviary.num_worlds, 0, 3))
        return nothing, nothing, np.zeros(0)

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the intercept point, far from it above the terrain; see `Game`."""
        task = require_supported_task(self, Interception)
        velocity, place = super().velocities(swarm), swarm.position
        drones = place.shape[1]
        layout = np.repeat(self.aviary.scene.layout, drones)
        height = np.full(len(layout), CLEARANCE)
        # The place in a second
        plan = np.clip(place + velocity, task.arena_low, task.arena_high).reshape(-1, 3)[:, :2]
        lowest = task.evader.place(layout, plan, height)[:, 2].reshape(-1, drones)
        distance = np.linalg.norm(self.aviary.scene.goal - place, axis=-1)
        climb = np.where(distance > NEAR, lowest - place[..., 2], -np.inf)
        velocity[..., 2] = np.maximum(velocity[..., 2], climb)
        # One drone captures the evader, so that no two meet there
        nearest = np.where(self.aviary.alive, distance, np.inf).min(axis=1, keepdims=True)
        waits = (distance > nearest) & (distance < WAITING)
        return np.where(waits[..., None], self.aviary.scene.goal_velocity, velocity)
