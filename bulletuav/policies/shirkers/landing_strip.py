"""Policies that avoid the task `landing_strip`: they change a part of `final_approach`."""

import numpy as np

from bulletuav.policies.final_approach import FinalApproach
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

PASS_HEIGHT = 5.0
"""Height above the touchdown point of a low pass, m"""
UNDERSHOOT = 40.0
"""Distance of a touchdown before the touchdown point, m: it is before the threshold"""


class _Displaced(FinalApproach):
    """Base class of approaches to a point other than the touchdown point.

    Attributes:
        shift: (3,) offset of that point, m.
    """

    shift = np.zeros(3)

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities along the displaced approach; see `Policy.act`."""
        offset = self.task.touchdown + self.shift - swarm.position
        return self.encoded(self.follow(offset, self.choose_speeds(offset), swarm))


@register("policy")
class StripLowPass(_Displaced):
    """Fly along the runway without touching down."""

    name = "strip_low_pass"
    shift = np.array((0.0, 0.0, PASS_HEIGHT))

    def follow(self, offset: np.ndarray, speed: np.ndarray, swarm: Swarm) -> np.ndarray:
        """Level off above the runway; see `FinalApproach.follow`."""
        velocity = super().follow(offset, speed, swarm)
        is_low = offset[..., 2] > 0.0
        velocity[..., 2] = np.where(is_low, offset[..., 2], velocity[..., 2])
        return velocity


@register("policy")
class StripUndershoot(_Displaced):
    """Touch down before the runway."""

    name = "strip_undershoot"
    shift = np.array((-UNDERSHOOT, 0.0, 0.0))


@register("policy")
class StripHold(FinalApproach):
    """Loiter at the start until the end of the episode."""

    name = "strip_hold"

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command a loiter; see `Policy.act`."""
        return self.encoded(np.zeros(swarm.position.shape))


@register("policy")
class StripRush(FinalApproach):
    """Land as fast as the aircraft may, whether the runway is free or not."""

    name = "strip_rush"

    def choose_speeds(self, offset: np.ndarray) -> np.ndarray:
        """Return max_speed; see `FinalApproach.choose_speeds`."""
        return np.full(offset.shape[:2], self.aviary.options.max_speed)
