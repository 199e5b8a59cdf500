"""Policy `flock_oracle`: the flocking of Vasarhelyi et al. with the true state of all drones."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.flocking import Vasarhelyi
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class FlockOracle(Vasarhelyi):
    """Policy `vasarhelyi` without noise and losses, which knows all drones within the link range.

    It shows how much of the failures of the policies of `flocking` is due to their sensors.
    """

    name = "flock_oracle"
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Read the link range of the task; see `FlockPolicy`."""
        super().__init__(aviary)
        self.max_distance = self.rules.link_range

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the true traffic of linked drones; see `Avoidance.traffic`."""
        traffic = Avoidance.traffic(self, observations, swarm)
        gap = traffic.offset
        linked = (gap * gap).sum(axis=-1) <= self.rules.link_range**2
        return traffic._replace(known=np.logical_and(traffic.known, linked))
