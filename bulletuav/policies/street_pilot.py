"""Policy `street_pilot`: navigates through streets by its range finder only.

The policy builds an occupancy map from its beams, assumes that unobserved cells are free, follows
the shortest path, and replans as the map grows.

References:
    S. Koenig, Y. Smirnov, Sensor-based planning with the freespace assumption (1997).
"""

import math

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.policies.astar import plan_path
from bulletuav.policies.base import Policy
from bulletuav.policies.over_roofs import ABOVE_GOAL, LEVEL
from bulletuav.policies.planner import ACCELERATION, DELAY, HALF_WIDTH, PathLimits, follow_paths
from bulletuav.policies.readings import (
    cruise_height_difference,
    decode_goal_offset,
    require_blocks,
    unpack_blocks,
)
from bulletuav.policies.straight import APPROACH
from bulletuav.policies.street_map import CELL, inflate, level_beams, update_maps
from bulletuav.policies.voxels import Voxels
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

MARGIN = 60.0
"""Extent of a map beyond start and goal, m"""
PLAN_EVERY = 5
"""Number of decisions between plans"""
WAYPOINTS = 8
"""Maximum number of waypoints of a plan that are stored"""
SPEED = 10.0
"""Maximum speed, m/s: a Hummingbird then stops within half the width of a street, before a wall
that appears behind a corner"""
TRUST = 0.2
"""Correction gain of dead reckoning: fraction of the difference to the observed position"""
BERTH = 3.0
"""Range below which an obstacle repels the drone, m"""
PUSH = 1.5
"""Gain from missing distance to repulsive speed, 1/s"""


@register("policy")
class StreetPilot(Policy):
    """Level flight below the ceiling along the shortest path in the drone's own map.

    A drone climbs first, then crosses the city, then descends to its goal. Its position relative to
    the goal is dead reckoned from the observed velocity, and corrected by the observed direction
    and distance of the goal. Other drones appear in the map like walls, and fade.
    """

    name = "street_pilot"
    actions = ("velocity", "velocity_increment")
    reads_swarm = False
    remembers = (
        "_evidence",
        "_place",
        "_goal",
        "_low",
        "_high",
        "_path",
        "_count",
        "_next",
        "_age",
    )

    def __init__(self, aviary: Aviary) -> None:
        """Find the observation blocks and allocate the maps; see `Policy`.

        Raises:
            ValueError: If the action type is not supported, or a required block is not observed.
        """
        super().__init__(aviary)
        require_blocks(self.name, aviary, ("goal", "velocity", "room", "lidar"))
        self._chosen, self._directions = level_beams(aviary)
        shape = aviary.alive.shape
        task = aviary.task
        side = float((task.arena_high - task.arena_low)[:2].max())
        cells = math.ceil((side + 2 * MARGIN) / CELL)
        self._evidence = np.zeros((*shape, cells, cells), dtype=np.int8)
        self._occupied = np.ones((cells + 2, cells + 2, 3), dtype=bool)
        # Position and goal relative to the origin of each map, m; known bounds of the airspace.
        self._place = np.zeros((*shape, 2))
        self._goal = np.zeros((*shape, 2))
        self._low = np.zeros((*shape, 2))
        self._high = np.zeros((*shape, 2))
        self._path = np.zeros((*shape, WAYPOINTS, 3))
        self._count = np.zeros(shape, dtype=np.int64)
        self._next = np.ones(shape, dtype=np.int64)
        self._age = np.zeros(len(aviary.alive), dtype=np.int64)

    def reset(self, mask: np.ndarray) -> None:
        """Clear the maps of the worlds in `mask` (W,)."""
        self._evidence[mask] = 0
        self._age[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Update the map, plan, and follow the path; see `Policy.act`."""
        seen = unpack_blocks(self.aviary, observations)
        offset = decode_goal_offset(seen["goal"])
        rise = cruise_height_difference(offset, seen["room"])
        self._update_position(offset[..., :2], seen)
        # Obstacles at other heights are ignored.
        is_level = np.abs(rise) < LEVEL
        far = np.linalg.norm(offset[..., :2], axis=-1) > ABOVE_GOAL
        ranges = seen["lidar"][..., self._chosen]
        reach = self.aviary.task.context.max_range
        # Ranges are stored as float32, so subtract a tolerance from the maximum range.
        alive = self.aviary.alive
        update_maps(
            self._evidence,
            self._place,
            ranges,
            self._directions,
            reach - 1e-3,
            alive & is_level & far,
        )
        # Planning is expensive, so it runs every few decisions
        is_due = alive & (self._age % PLAN_EVERY == 0)[:, None]
        for w, i in np.argwhere(is_due).tolist():
            self._plan(w, i)
        self._age += 1
        # Follow the path, with repulsion from near obstacles and height control
        wanted = self._path_velocity(seen["velocity"])
        wanted[far & ~is_level, :2] = 0.0
        wanted[..., :2] += self._push(ranges, offset)
        wanted = limit_norm(wanted, min(SPEED, float(self.aviary.options.max_speed)))
        wanted[..., 2] = APPROACH * np.where(far, rise, offset[..., 2])
        return self.encoded(limit_norm(wanted, float(self.aviary.options.max_speed)))

    def _update_position(self, offset: np.ndarray, seen: dict[str, np.ndarray]) -> None:
        """Update the positions by dead reckoning, and from offsets to the goal (W, N, 2), m."""
        is_new = self._age == 0
        # The map extends MARGIN beyond start and goal.
        corner = np.minimum(0.0, offset) - MARGIN
        self._place[is_new] = -corner[is_new]
        self._goal[is_new] = (offset - corner)[is_new]
        self._low[is_new] = -np.inf
        self._high[is_new] = np.inf
        old = ~is_new
        moved = self._place + seen["velocity"][..., :2] * self.aviary.task.context.period
        moved += TRUST * (self._goal - offset - moved)
        self._place[old] = moved[old]
        # Bounds of the airspace, once within range.
        room = seen["room"]
        reach = self.aviary.task.context.max_range - 1e-3
        for axis in range(2):
            here = self._place[..., axis]
            high, low = room[..., axis], room[..., axis + 3]
            is_near = high < reach
            self._high[..., axis][is_near] = (here + high)[is_near]
            is_near = low < reach
            self._low[..., axis][is_near] = (here - low)[is_near]

    def _plan(self, w: int, i: int) -> None:
        """Plan the path of a drone; clear a map without a path."""
        inflate(self._evidence[w, i], self._occupied, self._low[w, i], self._high[w, i])
        origin = np.array([-CELL, -CELL, -1.5 * CELL])
        start, goal = np.append(self._place[w, i], 0.0), np.append(self._goal[w, i], 0.0)
        path = plan_path(Voxels(self._occupied, origin, CELL), start, goal)
        if not len(path):
            self._evidence[w, i] = 0
            path = np.stack([start, goal])
        path = path[:WAYPOINTS]
        path[:, 2] = 0.0
        self._path[w, i, : len(path)] = path
        self._count[w, i] = len(path)
        self._next[w, i] = 1

    def _path_velocity(self, velocity: np.ndarray) -> np.ndarray:
        """Return horizontal velocities (W, N, 3) along the paths, m/s."""
        speed = min(SPEED, float(self.aviary.options.max_speed))
        limits = PathLimits(speed, ACCELERATION, DELAY, HALF_WIDTH)
        zero = np.zeros((*self._count.shape, 1))
        place = np.concatenate([self._place, zero], axis=-1)
        level = np.concatenate([velocity[..., :2], zero], axis=-1)
        half_width = np.full(self._count.shape, HALF_WIDTH)
        paths = (self._path, self._count, self._next, half_width)
        wanted, self._next = follow_paths(place, level, *paths, limits)
        return wanted

    def _push(self, ranges: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """Return repulsive velocities (W, N, 2) from near obstacles, m/s; fading at the goal."""
        flat = np.linalg.norm(offset[..., :2], axis=-1, keepdims=True)
        berth = np.clip(flat - ABOVE_GOAL, 0.0, BERTH)
        nearness = PUSH * np.maximum(berth - ranges, 0.0)
        push: np.ndarray = -(nearness[..., None] * self._directions).sum(axis=-2)
        return push
