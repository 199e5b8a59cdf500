"""Scripted policies that shirk: they show whether a task pays for what it does not want.

`bulletuav.analysis.incentives` compares a task's baseline with them.
"""

import math
from abc import abstractmethod

import numpy as np

from bulletuav.conflict.measures import pair_offsets
from bulletuav.control.actions import limit_norm
from bulletuav.policies.base import Policy
from bulletuav.policies.coverage import Oracle
from bulletuav.policies.coverage_geometry import ring
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

ORBIT = 5.0
"""Least radius of circles about a goal, m"""
TURN = 5.0
"""Acceleration towards the middle of such circles, m/s^2"""
BACK = 1.0
"""Speed per distance from the circle, 1/s"""


class Scripted(Policy):
    """A policy whose velocities follow from positions alone."""

    actions = ("velocity",)
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the velocities of `velocities`; see `Policy.act`."""
        return self.encoded(limit_norm(self.velocities(swarm), self.aviary.options.max_speed))

    @abstractmethod
    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose velocities, (W, N, 3) m/s, which are then cut to max_speed."""


@register("policy")
class Stay(Scripted):
    """Stand still from the start."""

    name = "stay"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose zeros; see `Scripted.velocities`."""
        return np.zeros(swarm.position.shape)


@register("policy")
class Climb(Scripted):
    """Climb straight up."""

    name = "climb"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the fastest way up; see `Scripted.velocities`."""
        up = (0.0, 0.0, self.aviary.options.max_speed)
        return np.full(swarm.position.shape, up)


@register("policy")
class Dive(Scripted):
    """Dive straight into the ground."""

    name = "dive"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the fastest way down; see `Scripted.velocities`."""
        down = (0.0, 0.0, -self.aviary.options.max_speed)
        return np.full(swarm.position.shape, down)


@register("policy")
class Leave(Scripted):
    """Fly to the nearest wall of the arena, and on."""

    name = "leave"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the nearest of the four walls; see `Scripted.velocities`."""
        task = self.aviary.task
        level = swarm.position[..., :2]
        # Distances to the walls in the west, south, east and north.
        gaps = np.concatenate([level - task.arena_low[:2], task.arena_high[:2] - level], axis=-1)
        walls = np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]])
        fastest: np.ndarray = walls[gaps.argmin(axis=-1)] * self.aviary.options.max_speed
        return fastest


@register("policy")
class Crash(Scripted):
    """Fly at the nearest drone, or into the ground where that is nearer."""

    name = "crash"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the fastest way to the nearest body; see `Scripted.velocities`."""
        position = swarm.position
        ways = pair_offsets(position)
        distance = np.linalg.norm(ways, axis=-1)
        alive = self.aviary.alive[:, None] & ~np.eye(position.shape[1], dtype=bool)
        distance = np.where(alive, distance, np.inf)
        nearest = distance.argmin(axis=-1)[..., None]
        to_drone = np.take_along_axis(ways, nearest[..., None], axis=2)[:, :, 0]
        down = np.zeros(position.shape)
        down[..., 2] = -position[..., 2]
        is_ground = np.take_along_axis(distance, nearest, axis=2) >= position[..., 2:]
        way = np.where(is_ground, down, to_drone)
        length = np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
        fastest: np.ndarray = way / length * self.aviary.options.max_speed
        return fastest


@register("policy")
class Circle(Scripted):
    """Circle about the goal, level, without ever reaching it."""

    name = "circle"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Choose the circle's tangent, and the way to it; see `Scripted.velocities`."""
        task, scene = self.aviary.task, self.aviary.scene
        radius = max(ORBIT, 2 * getattr(task.config, "goal_radius", 0.0))
        way = scene.goal - swarm.position
        level = way * (1.0, 1.0, 0.0)
        distance = np.linalg.norm(level, axis=-1, keepdims=True)
        inward = level / np.maximum(distance, 1e-9)
        tangent = np.stack([-inward[..., 1], inward[..., 0], np.zeros(distance.shape[:2])], axis=-1)
        speed = min(math.sqrt(TURN * radius), self.aviary.options.max_speed / 2)
        # Far off it flies in; on the circle along it.
        nearness = np.minimum(radius / np.maximum(distance, 1e-9), 1.0)
        back = BACK * (inward * (distance - radius) + (way - level))
        turning: np.ndarray = nearness * speed * tangent + back + scene.goal_velocity
        return turning


@register("policy")
class Clump(Oracle):
    """Hover all together over the one place from which a drone serves most."""

    name = "clump"

    def places(
        self,
        w: int,
        targets: np.ndarray,
        position: np.ndarray,
        before: np.ndarray | None,
    ) -> np.ndarray:
        """Choose a small ring about the best place; see `Placement.places`."""
        task = self.aviary.task
        tried = self._grid_places(w)
        best = tried[self._served(w, tried, targets).sum(axis=1).argmax()]
        low, high = task.arena_low[:2], task.arena_high[:2]
        return ring(best, len(position), 3 * task.config.d_safe, low, high)
