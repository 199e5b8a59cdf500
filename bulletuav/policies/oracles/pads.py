"""Policy `pad_pilot`: lands on pads whose states it reads."""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import Policy, require_supported_task
from bulletuav.policies.pad_approach import LEAD, PadTarget, approach_pads, keep_apart, match_pads
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.pad_landing import PadLanding
from bulletuav.tasks.parts.pads import PAD_THICKNESS
from bulletuav.vehicle.swarm import Swarm

CRUISE_MARGIN = 1.0
"""Cruise height above the highest pad, m"""
FAR = 1e3
"""Offset that removes a drone from those that it avoids, m"""


@register("policy")
class PadPilot(Policy):
    """Flight to pads by their true positions and velocities, each drone to its own pad."""

    name = "pad_pilot"
    actions = ("velocity",)
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Check the task; see `Policy`.

        Raises:
            ValueError: If the task is not `pad_landing`.
        """
        super().__init__(aviary)
        self._task = require_supported_task(self, PadLanding)
        motion = self._task.pads.motion
        self._turn_rate = motion.speed / motion.radius if motion.speed else 0.0

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command velocities to the pads; see `Policy.act`."""
        velocity, _ = self.plan(swarm)
        return self.encoded(limit_norm(velocity, self.aviary.options.max_speed))

    def plan(self, swarm: Swarm) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities (W, N, 3), m/s, and offsets to the tops of the pads (W, N, 3), m."""
        aviary, scene = self.aviary, self.aviary.scene
        pads = scene.obstacle[:, : self._task.pads.count] + (0.0, 0.0, PAD_THICKNESS / 2)
        velocity, offset = np.zeros((2, *swarm.position.shape))
        for w in np.flatnonzero(aviary.alive.any(axis=1)).tolist():
            flying = np.flatnonzero(aviary.alive[w])
            position = swarm.position[w, flying]
            chosen = self.choose(w, position, pads[w])
            highest = np.maximum(pads[w, :, 2].max(), scene.start[w, flying, 2])
            # Velocities rotate at the rate of the circles
            moving = scene.obstacle_velocity[w, chosen]
            rate = scene.memory["pad_turn"][w] * self._turn_rate
            left = np.stack([-moving[:, 1], moving[:, 0], np.zeros(len(moving))], axis=1)
            ahead = moving + LEAD * rate * left
            target = PadTarget(pads[w, chosen], ahead, highest + CRUISE_MARGIN)
            others = np.repeat(position[None], len(flying), axis=0)
            others[np.arange(len(flying)), np.arange(len(flying))] += FAR
            velocity[w, flying] = approach_pads(position, target) + keep_apart(position, others)
            offset[w, flying] = target.place - position
        return velocity, offset

    def choose(self, w: int, position: np.ndarray, pads: np.ndarray) -> np.ndarray:
        """Return the pad of each flying drone of a world.

        Args:
            w: Index of the world.
            position: (M, 3) positions of the drones, m.
            pads: (P, 3) tops of the pads, m.

        Returns:
            (M,) indices of unclaimed pads.
        """
        free = np.flatnonzero(self.aviary.scene.memory["claimed"][w] == 0)
        chosen: np.ndarray = free[match_pads(position, pads[free])]
        return chosen
