"""Reward terms of reaching and holding a position."""

import math

from bulletuav.geometry.rotation import Vec3
from bulletuav.registry import register
from bulletuav.tasks.ingredients import reward


@register("reward")
@reward
def alive() -> float:
    """1 per decision."""
    return 1.0


@register("reward")
@reward
def holding(distance: float, goal_radius: float) -> float:
    """1 within `goal_radius` of the goal."""
    return 1.0 if distance <= goal_radius else 0.0


@register("reward")
@reward
def distance(distance: float) -> float:
    """Distance to the goal, m."""
    return distance


@register("reward")
@reward
def speed(velocity: Vec3) -> float:
    """Speed over ground, m/s."""
    return math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)


@register("reward")
@reward
def speed_to_goal(velocity: Vec3, goal_velocity: Vec3) -> float:
    """Speed relative to the goal, m/s."""
    x = velocity[0] - goal_velocity[0]
    y = velocity[1] - goal_velocity[1]
    z = velocity[2] - goal_velocity[2]
    return math.sqrt(x * x + y * y + z * z)
