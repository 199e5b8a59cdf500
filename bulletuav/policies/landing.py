"""Touchdown: the last metres of a landing."""

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig

DESCENT = 0.5
"""Minimum descent speed near the ground, m/s; slower drones never make contact"""
NEAR = 1.0
"""Maximum horizontal distance to the goal for touchdown, m"""
LOW = 5.0
"""Maximum height above the goal for touchdown, m"""


def touch_down(
    velocity: np.ndarray, goal_offset: np.ndarray, goal_height: np.ndarray, task: Task[TaskConfig]
) -> np.ndarray:
    """Enforce a minimum descent speed for drones close above a goal on the ground.

    Args:
        velocity: (W, N, 3) commanded velocities, m/s.
        goal_offset: (W, N, 3) offsets to the goals, m.
        goal_height: (W, N) heights of the goals above ground, m.
        task: The task; velocities change only if its drones land.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    if not task.lands:
        return velocity
    is_down = goal_height <= np.array(task.context.standing_height)
    is_near = (goal_offset[..., 0] ** 2 + goal_offset[..., 1] ** 2 <= NEAR**2) & (
        goal_offset[..., 2] >= -LOW
    )
    result: np.ndarray = velocity.copy()
    fall = np.minimum(velocity[..., 2], -DESCENT)
    result[..., 2] = np.where(is_down & is_near, fall, velocity[..., 2])
    return result
