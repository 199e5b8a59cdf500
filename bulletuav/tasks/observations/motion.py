"""Observation blocks of the drone's own motion and its goal.

Positions and velocities are as measured by the drone (see `Frame`); without randomization they are
exact. World axes are east, north, up.
"""

from typing import Any

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.control.actions import Action
from bulletuav.geometry.rotation import Quat4, Vec3, heading, to_body
from bulletuav.registry import register
from bulletuav.sensors.base import Label, vector_labels
from bulletuav.sensors.imu import MAX_BODY_RATE
from bulletuav.tasks.ingredients import block


def _in_arena(name: str, task: Any) -> tuple[Label, ...]:
    return vector_labels(name, "m", task.arena_low, task.arena_high)


def _across_arena(name: str, task: Any) -> tuple[Label, ...]:
    size = task.arena_high - task.arena_low
    return vector_labels(name, "m", -size, size)


def _speeds(name: str, task: Any) -> tuple[Label, ...]:
    bound = np.full(3, 2 * task.context.max_speed)
    return vector_labels(name, "m/s", -bound, bound)


@register("observation")
@block(lambda task: _in_arena("position", task))
def position(known_position: Vec3) -> Vec3:
    """Own position, world axes."""
    return known_position


@register("observation")
@block(tuple(Label(f"quaternion {k}", "1", 0.0 if k == "w" else -1.0, 1.0) for k in "xyzw"))
def attitude(quaternion: Quat4) -> Quat4:
    """Own attitude: quaternion body to world, with the sign for which w >= 0."""
    x, y, z, w = quaternion
    if w < 0.0:
        return -x, -y, -z, -w
    return x, y, z, w


@register("observation")
@block(lambda task: _speeds("velocity", task))
def velocity(known_velocity: Vec3) -> Vec3:
    """Own velocity, world axes."""
    return known_velocity


@register("observation")
@block(lambda task: _speeds("body velocity", task))
def body_velocity(quaternion: Quat4, known_velocity: Vec3) -> Vec3:
    """Own velocity, body axes."""
    return to_body(quaternion, known_velocity)


@register("observation")
@block(vector_labels("rates", "rad/s", [-MAX_BODY_RATE] * 3, [MAX_BODY_RATE] * 3))
def rates(rates: Vec3) -> Vec3:
    """Own angular velocity, body axes."""
    return rates


@register("observation")
@block(lambda task: _in_arena("goal", task))
def goal_position(goal: Vec3) -> Vec3:
    """Goal position, world axes."""
    return goal


@register("observation")
@block(lambda task: _across_arena("goal offset", task))
def goal_offset(goal: Vec3, known_position: Vec3) -> Vec3:
    """Vector from the drone to its goal, world axes."""
    return (goal[0] - known_position[0], goal[1] - known_position[1], goal[2] - known_position[2])


@register("observation")
@block(lambda task: _across_arena("body goal offset", task))
def body_goal_offset(quaternion: Quat4, goal: Vec3, known_position: Vec3) -> Vec3:
    """Vector from the drone to its goal, body axes."""
    x, y, z = known_position
    return to_body(quaternion, (goal[0] - x, goal[1] - y, goal[2] - z))


def _goal_ahead_labels(task: Any) -> tuple[Label, ...]:
    size = task.arena_high - task.arena_low
    level = float(np.linalg.norm(size[:2]))
    return vector_labels("goal ahead", "m", (-level, -level, -size[2]), (level, level, size[2]))


@register("observation")
@block(_goal_ahead_labels)
def goal_ahead(quaternion: Quat4, goal: Vec3, known_position: Vec3) -> Vec3:
    """Vector from the drone to its goal: along its heading, to the left of it, and up.

    The axes are level, so that it does not change while an aircraft banks.
    """
    yaw = heading(quaternion)
    c, s = cos(yaw), sin(yaw)
    x, y = goal[0] - known_position[0], goal[1] - known_position[1]
    return c * x + s * y, c * y - s * x, goal[2] - known_position[2]


@register("observation")
@block(vector_labels("body up", "1", [-1.0] * 3, [1.0] * 3))
def body_up(quaternion: Quat4) -> Vec3:
    """Upward unit vector of the world, body axes: the attitude without the heading."""
    return to_body(quaternion, (0.0, 0.0, 1.0))


@register("observation")
@block(lambda task: _speeds("goal velocity", task))
def goal_velocity(goal_velocity: Vec3) -> Vec3:
    """Goal velocity, world axes."""
    return goal_velocity


def _goal_labels(task: Any) -> tuple[Label, ...]:
    furthest = float(np.linalg.norm(task.arena_high - task.arena_low))
    direction = vector_labels("goal direction", "1", -np.ones(3), np.ones(3))
    return (*direction, Label("goal distance", "m", 0.0, furthest))


@register("observation")
@block(_goal_labels)
def goal(goal: Vec3, known_position: Vec3, known_distance: float) -> Quat4:
    """Direction to the goal (unit vector, world axes) and distance."""
    length = max(known_distance, 1e-9)
    return (
        (goal[0] - known_position[0]) / length,
        (goal[1] - known_position[1]) / length,
        (goal[2] - known_position[2]) / length,
        known_distance,
    )


@register("observation")
@block([Label("alive", "1", 0.0, 1.0)])
def alive(present: bool) -> float:
    """1 while the drone flies, else 0."""
    return 1.0 if present else 0.0


@register("observation")
@block(
    lambda task: tuple(
        Label(f"is drone {k}", "1", 0.0, 1.0) for k in range(task.context.num_drones)
    )
)
def identity(i: int, out: np.ndarray) -> None:
    """One-hot encoding of the drone's index."""
    for k in range(len(out)):
        out[k] = 1.0 if k == i else 0.0


def _action_labels(action: Action) -> tuple[Label, ...]:
    bounds = zip(action.low.min(axis=0), action.high.max(axis=0), strict=True)
    return tuple(
        Label(f"action {k}", "1", float(low), float(high)) for k, (low, high) in enumerate(bounds)
    )


@register("observation")
@block(_action_labels)
def last_action(action: np.ndarray, out: np.ndarray) -> None:
    """Last action of the drone, zeros at the start."""
    for k in range(len(out)):
        out[k] = action[k]
