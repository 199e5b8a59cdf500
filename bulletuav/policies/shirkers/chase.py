"""Policies that avoid the task `follow`."""

import numpy as np

from bulletuav.policies.shirkers.displaced import HALF, LATE, Displaced
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

DISTANCE = 5.0
"""Distance from the station, m"""


@register("policy")
class FollowAbove(Displaced):
    """Follow the target above the station, with a wide view and far from anything to touch."""

    name = "follow_above"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return an upward offset; see `Displaced.offsets`."""
        return np.array((0.0, 0.0, DISTANCE))


@register("policy")
class FollowBehind(Displaced):
    """Follow the target at a distance behind the station."""

    name = "follow_behind"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return offsets against the target's velocity; see `Displaced.offsets`."""
        velocity = self.aviary.scene.goal_velocity
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        behind: np.ndarray = -DISTANCE * velocity / np.maximum(speed, 1e-9)
        return behind


@register("policy")
class FollowLate(FollowBehind):
    """Follow the target at a distance, and fly to the station at the end of the episode."""

    name = "follow_late"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return offsets that end late; see `Displaced.offsets`."""
        return np.where(self.is_after(LATE), 0.0, super().offsets(swarm))


@register("policy")
class FollowHalf(FollowBehind):
    """Follow the target at the station for half of the episode, then at a distance behind it."""

    name = "follow_half"

    def offsets(self, swarm: Swarm) -> np.ndarray:
        """Return offsets that begin late; see `Displaced.offsets`."""
        return np.where(self.is_after(HALF), super().offsets(swarm), 0.0)
