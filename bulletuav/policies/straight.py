"""Policy `straight`: everyone flies straight at its goal and avoids nobody. What a scenario does to the careless."""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.policies.base import Policy
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

APPROACH = 1.0  # 1/s; slows down over the last max_speed metres


class StraightLine(Policy):
    """Towards the goal at max_speed, slower when nearer than a second of flight, and with it where it moves."""

    name = "straight"
    actions = ("velocity", "velocity_increment", "target_position")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """The goal itself, or the velocity towards it."""
        scene, options = self.aviary.scene, self.aviary.options
        if options.action == "target_position":
            return self.encoded(scene.goal)
        return self.encoded(
            preferred_velocity(scene.goal, scene.goal_velocity, swarm.position, options.max_speed)
        )


def preferred_velocity(
    goal: np.ndarray, goal_velocity: np.ndarray, position: np.ndarray, max_speed: float
) -> np.ndarray:
    """(W, N, 3) m/s towards goals (W, N, 3) from positions, and with them, at up to `max_speed`."""
    return limit_norm(APPROACH * (goal - position) + goal_velocity, max_speed)
