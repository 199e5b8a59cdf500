"""Policy `approach_oracle`: a landing sequence by speeds, and by turns where these are not enough.

References:
    FAA Order JO 7110.65, Air Traffic Control, sections 5-7 and 5-9: speed adjustments and vectors
    for the spacing of arrivals.
"""

import math

import numpy as np

from bulletuav.compiled.functions import acos, cos, sin
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.final_approach import FinalApproach
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

WEAVE = math.radians(60.0)
"""Maximum angle of an S-turn to the course of the approach, rad"""
WEAVE_PERIOD = 16.0
"""Time from one turn to the left to the next, s"""
STRAIGHT_TIME = 16.0
"""Duration of the last part of the approach, without S-turns, s"""


@register("policy")
class ApproachOracle(FinalApproach):
    """Landing in sequence as `final_approach`, with S-turns of aircraft that must be later.

    All aircraft of a world turn to the same side at the same time, so that they stay apart.
    """

    name = "approach_oracle"

    def __init__(self, aviary: Aviary) -> None:
        """Allow mean speeds along the approach below those of flight; see `FinalApproach`."""
        super().__init__(aviary)
        self._flown = self._slow
        self._slow = cos(WEAVE) * self._slow

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities along the approach, with S-turns; see `Policy.act`."""
        offset = self.task.touchdown - swarm.position
        speed = self.choose_speeds(offset)
        velocity = self.follow(offset, np.maximum(speed, self._flown), swarm)
        # The delay is made before the straight part, which is flown at the slowest speed
        distance = np.sqrt((offset[..., :2] ** 2).sum(axis=-1))
        turning = np.maximum(distance - STRAIGHT_TIME * self._flown, 0.0)
        duration = np.maximum(distance / speed - STRAIGHT_TIME, 1e-6)
        ratio = np.clip(turning / duration / self._flown, cos(WEAVE), 1.0)
        angle = np.where(turning > 0.0, acos(ratio), 0.0)
        now = self.aviary.steps / self.aviary.options.decision_hz
        side = np.where(now % WEAVE_PERIOD < WEAVE_PERIOD / 2, 1.0, -1.0)[:, None]
        along, across = cos(angle), side * sin(angle)
        east, north = velocity[..., 0].copy(), velocity[..., 1].copy()
        velocity[..., 0] = along * east - across * north
        velocity[..., 1] = across * east + along * north
        return self.encoded(velocity)
