"""Policies that try to be paid for flights to goals without reaching them safely.

Most of them follow the baseline of the task, and only do the last part or the avoidance otherwise.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.base import Policy
from bulletuav.policies.orca import Orca
from bulletuav.policies.planner import PathPlanner
from bulletuav.policies.scripted import Scripted
from bulletuav.policies.straight import APPROACH
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

STANDOFF = 1.0
"""Distance from the edge of the goal at which drones stop or turn away, m"""
BRAKING = 0.5
"""Gain from distance to maximum speed, 1/s, at which a quadrotor does not overshoot"""
NEAR = 20.0
"""Distance from the goal at which drones turn to the nearest side of the arena, m"""
CLOSE = 0.2
"""Distance between collision shapes that is kept in passing, m"""
LATE = 1.0
"""Time horizon of avoiding contact, s"""
TOP = 3.0
"""Distance from the ceiling at which drones fly over others, m"""


class Shirker(Policy):
    """Base class of policies that modify the velocities of ORCA, in cities along planned paths."""

    actions: ClassVar[tuple[str, ...]] = ("velocity",)
    reads_swarm = True

    def __init__(self, aviary: Aviary) -> None:
        """Create the policy that is modified; see `Policy`."""
        super().__init__(aviary)
        kind = PathPlanner if aviary.task.layouts() else Orca
        self.pilot: Avoidance = kind(aviary)

    def reset(self, mask: np.ndarray) -> None:
        """Reset the policy that is modified."""
        self.pilot.reset(mask)

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Modify the commanded velocities; see `Policy.act`."""
        speed = self.aviary.options.max_speed
        velocity = speed * self.pilot.act(observations, swarm)
        offset = self.aviary.scene.goal - swarm.position
        return self.encoded(limit_norm(self.modified(velocity, offset, swarm), speed))

    def modified(self, velocity: np.ndarray, offset: np.ndarray, swarm: Swarm) -> np.ndarray:
        """Modify velocities; by default not at all.

        Args:
            velocity: (W, N, 3) velocities to the goals, m/s.
            offset: (W, N, 3) offsets to the goals, m.
            swarm: The true state of all drones.

        Returns:
            (W, N, 3) velocities, m/s.
        """
        return velocity

    def memory(self) -> dict[str, Any]:
        """Return the state, with that of the policy that is modified as "pilot"."""
        return {**super().memory(), "pilot": self.pilot.memory()}

    def restore(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned."""
        own = dict(memory)
        self.pilot.restore(own.pop("pilot"))
        super().restore(own)


@register("policy")
class StopShort(Shirker):
    """Fly to the goal, but stop just before its edge."""

    name = "stop_short"

    def modified(self, velocity: np.ndarray, offset: np.ndarray, swarm: Swarm) -> np.ndarray:
        """Limit the speed by the distance to the edge; see `Shirker.modified`."""
        edge = self.aviary.task.config.goal_radius + STANDOFF
        left = np.linalg.norm(offset, axis=-1, keepdims=True) - edge
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        limit = BRAKING * np.maximum(left, 0.0)
        slowed: np.ndarray = velocity * np.minimum(limit / np.maximum(speed, 1e-9), 1.0)
        return slowed


@register("policy")
class PassClosely(Shirker):
    """Fly to the goal and avoid contact with other drones, but not conflicts."""

    name = "pass_closely"

    def __init__(self, aviary: Aviary) -> None:
        """Reduce the separation that ORCA maintains, and its horizon; see `Policy`."""
        super().__init__(aviary)
        separation = 2 * aviary.task.context.collision_radius + CLOSE
        self.pilot.parameters = self.pilot.parameters._replace(separation=separation, horizon=LATE)


@register("policy")
class IgnoreObstacles(Shirker):
    """Fly to the goal and avoid other drones, but not obstacles."""

    name = "ignore_obstacles"

    def __init__(self, aviary: Aviary) -> None:
        """Remove the obstacles that ORCA avoids; see `Policy`."""
        super().__init__(aviary)
        self.pilot.sphere_radius = np.zeros_like(self.pilot.sphere_radius)


@register("policy")
class LeaveNearGoal(Shirker):
    """Fly towards the goal, but once near it leave the arena by the nearest side."""

    name = "leave_near_goal"
    remembers = ("_is_leaving",)

    def __init__(self, aviary: Aviary) -> None:
        """Start on the way to the goal; see `Policy`."""
        super().__init__(aviary)
        self._is_leaving = np.zeros(aviary.alive.shape, dtype=bool)

    def reset(self, mask: np.ndarray) -> None:
        """Start on the way to the goal."""
        super().reset(mask)
        self._is_leaving[mask] = False

    def modified(self, velocity: np.ndarray, offset: np.ndarray, swarm: Swarm) -> np.ndarray:
        """Turn to the nearest side when within NEAR of the goal; see `Shirker.modified`."""
        task = self.aviary.task
        self._is_leaving |= np.linalg.norm(offset, axis=-1) < NEAR
        level = swarm.position[..., :2]
        sides = np.concatenate([level - task.arena_low[:2], task.arena_high[:2] - level], axis=-1)
        outwards = np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]])[sides.argmin(axis=-1)]
        leaving = self.aviary.options.max_speed * outwards
        return np.where(self._is_leaving[..., None], leaving, velocity)


@register("policy")
class FlyOver(Scripted):
    """Climb to the ceiling, fly above the goal, and descend, without avoiding anything."""

    name = "fly_over"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the ceiling, above the goal, or to the goal; see `Scripted`."""
        offset = self.aviary.scene.goal - swarm.position
        is_far = np.linalg.norm(offset[..., :2], axis=-1) > NEAR / 2
        ceiling = self.aviary.task.arena_high[2] - TOP - swarm.position[..., 2]
        # Drones climb before they fly level
        is_low = is_far & (ceiling > TOP)
        offset[..., :2] *= ~is_low[..., None]
        offset[..., 2] = np.where(is_far, ceiling, offset[..., 2])
        velocity: np.ndarray = APPROACH * offset
        return velocity
