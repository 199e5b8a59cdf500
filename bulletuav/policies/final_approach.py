"""Policy `final_approach`: aircraft land in the order of their distances, each on the glide path.

References:
    R. Beard, T. McLain, Small Unmanned Aircraft, Princeton 2012, section 10.1: the vector field of
    a straight path.
"""

import math

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy, require_supported_task
from bulletuav.registry import register
from bulletuav.tasks.landing_strip import LandingStrip
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

INTERCEPT = math.radians(50.0)
"""Largest angle at which the centreline is approached, rad"""
HEIGHT_GAIN = 0.4
"""Gain from the error of height to climb, 1/s"""
SLOW, FAST = 1.03, 1.25
"""Range of speeds on the approach, in minimum speeds"""
RESERVE = 1.2
"""Time between two touchdowns by the time for which a touchdown occupies the runway"""
HOVER_SPEED = 5.0
"""Minimum speed of drones that can hover on the approach, m/s"""


@register("policy")
class FinalApproach(Policy):
    """Landing in sequence: speeds keep the runway free for each aircraft in turn.

    Each aircraft flies to the extended centreline and down the glide path. The arrival times of
    the sequence set its speed.
    """

    name = "final_approach"
    actions = ("velocity",)
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Check the task; see `Policy`.

        Raises:
            ValueError: If the task is not `landing_strip`.
        """
        super().__init__(aviary)
        self.task = require_supported_task(self, LandingStrip)
        gains = aviary.worlds.cascade.gains[0]
        slowest = np.where(gains["min_speed"] > 0, gains["min_speed"], HOVER_SPEED)
        self._slow = SLOW * slowest
        self._fast = np.minimum(FAST * slowest, self.task.config.touchdown_speed)
        self._capture = max(self.task.context.turn_radius, 10.0)

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities along the approach; see `Policy.act`."""
        offset = self.task.touchdown - swarm.position
        speed = self.choose_speeds(offset)
        return self.encoded(self.follow(offset, speed, swarm))

    def choose_speeds(self, offset: np.ndarray) -> np.ndarray:
        """Return horizontal speeds (W, N), m/s, that keep the sequence.

        Args:
            offset: (W, N, 3) offsets to the touchdown point, m.
        """
        aviary = self.aviary
        distance = np.sqrt((offset[..., :2] ** 2).sum(axis=-1))
        occupied = self.task.config.runway_time
        reserve = (RESERVE - 1.0) * occupied
        speed = np.broadcast_to(self._fast, distance.shape).copy()
        now = aviary.steps / aviary.options.decision_hz
        for w in np.flatnonzero(aviary.alive.any(axis=1)).tolist():
            free = aviary.scene.memory["runway_free"][w, 0] - now[w] + reserve
            flying = np.flatnonzero(aviary.alive[w])
            for i in flying[np.argsort(distance[w, flying], kind="stable")].tolist():
                arrival = max(distance[w, i] / self._fast[i], free)
                speed[w, i] = max(distance[w, i] / max(arrival, 1e-6), self._slow[i])
                free = distance[w, i] / speed[w, i] + occupied + reserve
        limited: np.ndarray = np.minimum(speed, self._fast)
        return limited

    def follow(self, offset: np.ndarray, speed: np.ndarray, swarm: Swarm) -> np.ndarray:
        """Return velocities (W, N, 3), m/s, along the vector field of the glide path.

        Args:
            offset: (W, N, 3) offsets to the touchdown point, m.
            speed: (W, N) horizontal speeds, m/s.
            swarm: State of the drones.
        """
        aside = -offset[..., 1]
        course = -INTERCEPT * (2 / math.pi) * atan2(aside, np.full_like(aside, self._capture))
        # Height error to the glide path, and the descent along it
        height = -offset[..., 2] - np.maximum(offset[..., 0], 0.0) * self.task.slope
        climb = -speed * self.task.slope - HEIGHT_GAIN * height
        velocity = np.stack([speed * cos(course), speed * sin(course), climb], axis=-1)
        return velocity
