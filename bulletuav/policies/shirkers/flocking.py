"""Policies that avoid the task `flocking`."""

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.flocking import OlfatiSaber
from bulletuav.policies.scripted import Scripted
from bulletuav.policies.shirkers.displaced import HALF
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.flocking import Flocking
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

CLUMP = 0.7
"""Distance between drones in a clump, in d_safe"""
SCATTER = 2.0
"""Distance between scattered drones, in units of the link range"""


@register("policy")
class FlockHover(OlfatiSaber):
    """Gather to a connected group in the middle of the arena, and hover there."""

    name = "flock_hover"

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic, with a leader that stands; see `Avoidance.traffic`."""
        traffic = super().traffic(observations, swarm)
        goal = -self.blocks(observations)["position"]
        goal[..., 2] = traffic.goal[..., 2]
        return traffic._replace(goal=goal, goal_velocity=np.zeros(goal.shape))


@register("policy")
class FlockHeading(Scripted):
    """Fly east at the speed of the flock from the start, in perfect order, without observing."""

    name = "flock_heading"

    def __init__(self, aviary: Aviary) -> None:
        """Read the speed of the flock; see `Policy`.

        Raises:
            ValueError: If the task is not `flocking`.
        """
        super().__init__(aviary)
        self._speed = require_supported_task(self, Flocking).config.flock_speed

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return one velocity for all drones; see `Scripted.velocities`."""
        return np.full(swarm.position.shape, (self._speed, 0.0, 0.0))


@register("policy")
class FlockScatter(OlfatiSaber):
    """Fly as the leader does, in perfect order, but so far from each other that none are linked."""

    name = "flock_scatter"

    def __init__(self, aviary: Aviary) -> None:
        """Widen the flock; see `FlockPolicy`."""
        super().__init__(aviary)
        wide = SCATTER * self.rules.link_range
        widened = self.rules.radius * wide / self.rules.spacing
        self.rules = self.rules._replace(spacing=wide, link_range=1.5 * wide, radius=widened)


@register("policy")
class FlockClump(OlfatiSaber):
    """Fly in a flock that is much too dense."""

    name = "flock_clump"

    def __init__(self, aviary: Aviary) -> None:
        """Narrow the flock; see `FlockPolicy`."""
        super().__init__(aviary)
        near = CLUMP * float(aviary.task.config.d_safe)
        narrowed = self.rules.radius * near / self.rules.spacing
        self.rules = self.rules._replace(spacing=near, radius=narrowed)


@register("policy")
class FlockUnseeing(OlfatiSaber):
    """Follow the leader to within the radius of the flock, without observing other drones."""

    name = "flock_unseeing"

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic without other drones; see `Avoidance.traffic`."""
        traffic = super().traffic(observations, swarm)
        return traffic._replace(known=np.zeros_like(traffic.known))


@register("policy")
class FlockHalf(OlfatiSaber):
    """Fly in the flock for half of the episode, then hover."""

    name = "flock_half"

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command zero velocities in the second half; see `Policy.act`."""
        aviary = self.aviary
        leaves = aviary.steps >= HALF * aviary.options.horizon
        hover = self.encoded(np.zeros(swarm.position.shape))
        return np.where(leaves[:, None, None], hover, super().act(observations, swarm))
