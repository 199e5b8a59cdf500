"""Policy `straight`: flies straight to the goal without collision avoidance.

The policy shows the difficulty of a scenario for drones without collision avoidance.
"""

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.control.setpoint import SetpointLevel
from bulletuav.policies.base import Policy
from bulletuav.policies.landing import touch_down
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

APPROACH = 1.0
"""Gain from distance to speed, 1/s: drones decelerate over the last max_speed metres"""


@register("policy")
class StraightLine(Policy):
    """Flight to the goal at max_speed, plus the velocity of a moving goal.

    Drones slow down within one second of flight from the goal.
    """

    name = "straight"
    actions = ("velocity", "velocity_increment", "target_position")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the goal position, or the velocity to the goal; see `Policy.act`."""
        scene = self.aviary.scene
        options = self.aviary.options
        to_goal = self.aviary.action.levels == SetpointLevel.POSITION
        if to_goal.all():
            return self.encoded(scene.goal)
        goal_offset = scene.goal - swarm.position
        velocity = preferred_velocity(goal_offset, scene.goal_velocity, options.max_speed)
        velocity = touch_down(velocity, goal_offset, scene.goal[..., 2], self.aviary.task)
        if to_goal.any():
            velocity = np.where(to_goal[:, None], scene.goal, velocity)
        return self.encoded(velocity)


def preferred_velocity(
    goal_offset: np.ndarray, goal_velocity: np.ndarray, max_speed: float
) -> np.ndarray:
    """Compute preferred velocities: straight to the goals, plus the velocities of the goals.

    Args:
        goal_offset: (W, N, 3) offsets to the goals, m.
        goal_velocity: (W, N, 3) velocities of the goals, m/s.
        max_speed: Speed limit, m/s.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    return limit_norm(APPROACH * goal_offset + goal_velocity, max_speed)
