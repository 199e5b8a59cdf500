"""Policy `straight`, which flies everyone straight at its goal and avoids nobody.

It shows what a scenario does to drones that do not look.
"""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.policies.base import Policy
from bulletuav.policies.landing import touch_down
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

APPROACH = 1.0
"""Speed per distance to the goal, 1/s: slows drones down over the last max_speed metres"""


@register("policy")
class StraightLine(Policy):
    """Flight towards the goal at max_speed, and with the goal where it moves.

    Drones are slower when nearer than a second of flight.
    """

    name = "straight"
    actions = ("velocity", "velocity_increment", "target_position")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the goal itself, or for the velocity towards it; see `Policy.act`."""
        scene = self.aviary.scene
        options = self.aviary.options
        if options.action == "target_position":
            return self.encoded(scene.goal)
        way = scene.goal - swarm.position
        velocity = preferred_velocity(way, scene.goal_velocity, options.max_speed)
        task = self.aviary.task
        return self.encoded(touch_down(velocity, way, scene.goal[..., 2], task))


def preferred_velocity(way: np.ndarray, goal_velocity: np.ndarray, max_speed: float) -> np.ndarray:
    """Compute the velocities that lead straight to the goals, and with them.

    Args:
        way: (W, N, 3) ways to the goals, m.
        goal_velocity: (W, N, 3) velocities of the goals, m/s.
        max_speed: Limit of the speed, m/s.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    return limit_norm(APPROACH * way + goal_velocity, max_speed)
