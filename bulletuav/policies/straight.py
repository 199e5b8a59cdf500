"""Policy `straight`: everyone flies straight at its goal and avoids nobody. What a scenario does to the careless."""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.physics.swarm import Swarm
from bulletuav.policies.base import Policy
from bulletuav.tasks.terms.observations import Observation

APPROACH = 1.0  # 1/s; slows down over the last max_speed metres


class StraightLine(Policy):
    """Towards the goal at max_speed, slower when nearer than a second of flight, and with it where it moves."""

    name = "straight"
    actions = ("velocity", "target_position")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """The goal itself, or the velocity towards it."""
        goal, encode = self.aviary.scene.goal, self.aviary.action.encode
        assert encode is not None  # all actions in `actions` have one
        if self.aviary.options.action == "target_position":
            return encode(goal)
        wanted = APPROACH * (goal - swarm.position) + self.aviary.scene.goal_velocity
        return encode(limit_norm(wanted, self.aviary.options.max_speed))
