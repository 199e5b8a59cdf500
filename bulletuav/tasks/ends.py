"""Ends and successes that several tasks have in common."""

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
