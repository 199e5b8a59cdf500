"""Scripted policies that exploit a task: they show whether a task rewards unwanted behaviour.

`bulletuav.analysis.incentives` compares them with the baseline of a task.
"""

import math
from abc import abstractmethod

import numpy as np

from bulletuav.conflict.measures import pair_offsets
from bulletuav.control.actions import limit_norm
from bulletuav.policies.base import Policy
from bulletuav.policies.coverage import Oracle
from bulletuav.policies.coverage_geometry import assign_optimally, grid_positions, ring_positions
from bulletuav.policies.straight import APPROACH
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

ORBIT = 5.0
"""Minimum radius of circles around a goal, m"""
TURN = 5.0
"""Centripetal acceleration of the circles, m/s^2"""
BACK = 1.0
"""Gain from distance to the circle to correction speed, 1/s"""


class Scripted(Policy):
    """Base class of policies whose velocities depend on positions only."""

    actions = ("velocity",)
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing: the policy is stateless."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Command the velocities of `velocities`; see `Policy.act`."""
        return self.encoded(limit_norm(self.velocities(swarm), self.aviary.options.max_speed))

    @abstractmethod
    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return the velocities, (W, N, 3) m/s, which are then limited to max_speed."""


@register("policy")
class StayPolicy(Scripted):
    """Stay in place from the start."""

    name = "stay"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return zeros; see `Scripted.velocities`."""
        return np.zeros(swarm.position.shape)


@register("policy")
class Climb(Scripted):
    """Climb vertically at full speed."""

    name = "climb"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return upward velocities; see `Scripted.velocities`."""
        up = (0.0, 0.0, self.aviary.options.max_speed)
        return np.full(swarm.position.shape, up)


@register("policy")
class Dive(Scripted):
    """Dive vertically into the ground at full speed."""

    name = "dive"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return downward velocities; see `Scripted.velocities`."""
        down = (0.0, 0.0, -self.aviary.options.max_speed)
        return np.full(swarm.position.shape, down)


@register("policy")
class LeavePolicy(Scripted):
    """Fly out of the arena through the nearest wall."""

    name = "leave"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the nearest of the four walls; see `Scripted.velocities`."""
        task = self.aviary.task
        level = swarm.position[..., :2]
        # Distances to the west, south, east and north walls.
        distances = np.concatenate(
            [level - task.arena_low[:2], task.arena_high[:2] - level], axis=-1
        )
        walls = np.array([[-1.0, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]])
        fastest: np.ndarray = walls[distances.argmin(axis=-1)] * self.aviary.options.max_speed
        return fastest


@register("policy")
class Crash(Scripted):
    """Fly into the nearest drone, or into the ground if the ground is nearer."""

    name = "crash"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the nearest body; see `Scripted.velocities`."""
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
    """Circle horizontally around the goal without reaching it."""

    name = "circle"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return tangential velocities plus a correction; see `Scripted.velocities`."""
        task, scene = self.aviary.task, self.aviary.scene
        radius = max(ORBIT, 2 * getattr(task.config, "goal_radius", 0.0))
        way = scene.goal - swarm.position
        level = way * (1.0, 1.0, 0.0)
        distance = np.linalg.norm(level, axis=-1, keepdims=True)
        inward = level / np.maximum(distance, 1e-9)
        tangent = np.stack([-inward[..., 1], inward[..., 0], np.zeros(distance.shape[:2])], axis=-1)
        speed = min(math.sqrt(TURN * radius), self.aviary.options.max_speed / 2)
        # Far away fly to the circle; on the circle follow its tangent.
        nearness = np.minimum(radius / np.maximum(distance, 1e-9), 1.0)
        back = BACK * (inward * (distance - radius) + (way - level))
        turning: np.ndarray = nearness * speed * tangent + back + scene.goal_velocity
        return turning


@register("policy")
class Spread(Scripted):
    """Fly straight to evenly spaced places at half the height of the arena, and stay there."""

    name = "spread"

    def velocities(self, swarm: Swarm) -> np.ndarray:
        """Return velocities to the places; see `Scripted.velocities`."""
        low, high = self.aviary.task.arena_low, self.aviary.task.arena_high
        places = grid_positions(swarm.position.shape[1], low[:2], high[:2])
        goal = np.full(swarm.position.shape, 0.5 * (low[2] + high[2]))
        for w, here in enumerate(swarm.position):
            goal[w, :, :2] = assign_optimally(places, here[:, :2])
        velocity: np.ndarray = APPROACH * (goal - swarm.position)
        return velocity


@register("policy")
class Clump(Oracle):
    """Hover with all drones above the single position with the highest service quality."""

    name = "clump"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Return a small ring around the best position; see `Placement.places`."""
        task = self.aviary.task
        candidates = self._grid_places(w)
        best = candidates[self._service_quality(w, candidates, targets).sum(axis=1).argmax()]
        low, high = task.arena_low[:2], task.arena_high[:2]
        return ring_positions(best, len(position), 3 * task.config.d_safe, low, high)
