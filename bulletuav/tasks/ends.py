"""Termination and success conditions shared by several tasks."""

import numpy as np

from bulletuav.tasks.frame import Frame
from bulletuav.tasks.ingredients import end


@end
def collision(collision: bool) -> bool:
    """Return True if the collision shape touched anything."""
    return collision


@end
def too_far(distance: float, max_distance: float) -> bool:
    """Return True if the drone is farther than `max_distance`, m, from its goal."""
    return distance > max_distance


@end
def at_goal(distance: float, goal_radius: float) -> bool:
    """Return True if the drone is within `goal_radius`, m, of its goal."""
    return distance <= goal_radius


@end
def held(held: float, min_held: float) -> bool:
    """Return True if the drone was in place for long enough; see `Holding`."""
    return held >= min_held


@end
def leaves_arena(outside: bool) -> bool:
    """Return True if the drone is outside the arena."""
    return outside


def affected_drones(happened: np.ndarray, frame: Frame, scope: str) -> np.ndarray:
    """Return which drones an event ends: those where it happened, or all drones of their worlds.

    Args:
        happened: (W, N) bool, drones to which the event happened.
        frame: The decision.
        scope: "drone" for these drones, "world" for all drones of their worlds.

    Returns:
        (W, N) bool.
    """
    if scope == "world":
        happened = np.logical_or.reduce(happened & frame.alive, axis=1, keepdims=True)
        return happened | np.zeros(frame.alive.shape, dtype=bool)
    return happened
