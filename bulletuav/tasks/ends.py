"""Ends and successes that several tasks have in common."""

import numpy as np

from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import end


@end
def collision(collision: bool) -> bool:
    """Tell whether collision shapes touched."""
    return collision


@end
def too_far(distance: float, max_distance: float) -> bool:
    """Tell whether the drone is farther from its goal than `max_distance`, m."""
    return distance > max_distance


@end
def at_goal(distance: float, goal_radius: float) -> bool:
    """Tell whether the drone is within `goal_radius` m of its goal."""
    return distance <= goal_radius


@end
def leaves_arena(outside: bool) -> bool:
    """Tell whether the drone is outside the arena."""
    return outside


def affected_drones(happened: np.ndarray, frame: Frame, scope: str) -> np.ndarray:
    """Tell whose episode is concerned, (W, N) bool.

    Args:
        happened: (W, N) bool, drones to which it happened.
        frame: The decision.
        whom: "drone" for these, "world" for all drones of their worlds.
    """
    if scope == "world":
        happened = np.logical_or.reduce(happened & frame.alive, axis=1, keepdims=True)
        return happened | np.zeros(frame.alive.shape, dtype=bool)
    return happened
