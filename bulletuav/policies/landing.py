"""The last metres of a landing, for policies that brake for their goals."""

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig

DESCENT = 0.5
"""m/s, at which drones go down onto the ground at least: slower ones never touch it"""
NEAR = 1.0
"""m, how far aside of the goal they do so at most"""
LOW = 5.0
"""m, how high above it"""


def touch_down(
    velocity: np.ndarray, way: np.ndarray, goal_height: np.ndarray, task: Task[TaskConfig]
) -> np.ndarray:
    """Have drones that are close above goals on the ground go down to touch it.

    Args:
        velocity: (W, N, 3) that they would fly otherwise, m/s.
        way: (W, N, 3) to their goals, m.
        goal_height: (W, N) of the goals above the ground, m.
        task: The task, which tells whether drones may touch the ground.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    if not task.lands:
        return velocity
    is_down = goal_height <= np.array(task.context.standing_height)
    is_near = (way[..., 0] ** 2 + way[..., 1] ** 2 <= NEAR**2) & (way[..., 2] >= -LOW)
    result: np.ndarray = velocity.copy()
    fall = np.minimum(velocity[..., 2], -DESCENT)
    result[..., 2] = np.where(is_down & is_near, fall, velocity[..., 2])
    return result
