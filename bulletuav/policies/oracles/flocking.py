"""Policy `flock_oracle`: the flocking of Vasarhelyi et al. with the true state of all drones."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.flocking import TINY, Vasarhelyi
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

LEVEL = np.array((1.0, 1.0, 0.0))
"""Horizontal axes"""


@register("policy")
class FlockOracle(Vasarhelyi):
    """Policy `vasarhelyi` without noise and losses, which knows all drones within the link range.

    It shows how much of the failures of the policies of `flocking` is due to their sensors. Without
    a leader drones follow the centre of all drones, which flies in the mean direction.
    """

    name = "flock_oracle"
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Follow the centre of the drones as a leader; see `FlockPolicy`."""
        super().__init__(aviary)
        self.max_distance = self.rules.link_range
        self.follows_centre = not self.rules.leads
        self.rules = self.rules._replace(leads=True)

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the true traffic of linked drones; see `Avoidance.traffic`."""
        traffic = Avoidance.traffic(self, observations, swarm)
        gap = traffic.offset
        linked = (gap * gap).sum(axis=-1) <= self.rules.link_range**2
        traffic = traffic._replace(known=np.logical_and(traffic.known, linked))
        if not self.follows_centre:
            return traffic
        alive = self.aviary.alive[..., None]
        flown = np.maximum(alive.sum(axis=1, keepdims=True), 1)
        centre = np.where(alive, swarm.position, 0.0).sum(axis=1, keepdims=True) / flown
        course = np.where(alive, swarm.velocity, 0.0).sum(axis=1, keepdims=True) * LEVEL
        length = np.maximum(np.sqrt((course * course).sum(axis=-1, keepdims=True)), TINY)
        # The altitude is that of the task
        goal = np.where(LEVEL > 0.0, centre - swarm.position, traffic.goal)
        velocity = np.broadcast_to(self.rules.speed * course / length, goal.shape)
        return traffic._replace(goal=goal, goal_velocity=velocity)
