"""Flight along ways through a known city, found before it starts; policy `planner` does so.

A way is a row of waypoints, and leg k is the segment that ends at waypoint k.
"""

import math
from abc import abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import Vec3, dot, plus, vec3
from bulletuav.geometry.solids import Solids
from bulletuav.policies.astar import plan
from bulletuav.policies.base import Policy
from bulletuav.policies.landing import touch_down
from bulletuav.policies.potential import make_field, repulsion
from bulletuav.policies.straight import APPROACH
from bulletuav.policies.voxels import Voxels, voxels
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

VOXEL_SIZE = 4.0
"""Size of the cells of the map, m; with HALF_WIDTH and a drone of 0.6 m, streets 13 m wide have a
way wherever the cells lie"""
HALF_WIDTH = 2.0
"""Room to either side of the way, m: for rounding corners, gusts and other drones"""
ACCELERATION = 5.0
"""Acceleration at corners and to stop, m/s^2"""
DELAY = 0.6
"""Time from decision to velocity, s; so a Hummingbird rounds right angles within HALF_WIDTH at up
to 20 m/s"""
NO_WAY = 1e-9
"""Length below which a leg has no direction, m"""


class Limits(NamedTuple):
    """Limits that ways are flown by.

    Attributes:
        speed: Greatest speed, m/s.
        acceleration: Greatest acceleration at corners and to stop, m/s^2.
        delay: Time until a commanded velocity is reached, s.
        half_width: Greatest distance from the way, m.
    """

    speed: float
    acceleration: float
    delay: float
    half_width: float


class PathFollower(Policy):
    """Flight along the shortest way between the buildings, found by A*.

    Buildings are those that stand at the start; obstacles that are no part of the city are not
    seen. Where there is no way, flight is straight.

    Living drones push each other off as in policy `potential`, but no harder than the correction
    towards the way pulls back at HALF_WIDTH from it: that avoids buildings before drones.
    """

    actions = ("velocity", "velocity_increment")
    reads_swarm = True
    remembers: ClassVar[tuple[str, ...]] = ("_way", "_count", "_next")

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`."""
        super().__init__(aviary)
        shape = aviary.alive.shape
        # Maps by the id of the solids, which are kept here lest others get it.
        self._grids: dict[int, tuple[Solids, Voxels]] = {}
        # Waypoints, m; how many there are, 0 before there is a plan; and the one flown to.
        self._way = np.zeros((*shape, 2, 3))
        self._count = np.zeros(shape, dtype=np.int64)
        self._next = np.ones(shape, dtype=np.int64)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the ways of the worlds of `mask` (W,)."""
        self._count[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Add the velocities of `follow` and the push from drones; see `Policy.act`.

        Together they are limited to max_speed. Drones that have no way yet are given one first.
        """
        aviary = self.aviary
        speed = float(aviary.options.max_speed)
        goal = self.goals(swarm)
        without_way = aviary.alive & (self._count == 0)
        for w, i in np.argwhere(without_way).tolist():
            way = self._plan(w, swarm.position[w, i], goal[w, i])
            self._keep(w, i, way)
        # Along the ways.
        limits = Limits(speed, ACCELERATION, DELAY, HALF_WIDTH)
        wanted, self._next = follow(
            swarm.position, swarm.velocity, self._way, self._count, self._next, limits
        )
        # Away from other drones.
        no_balls = np.zeros((len(aviary.alive), 0, 3))
        field = make_field(aviary, surfaces=0.0)
        push = repulsion(swarm.position, aviary.alive, no_balls, np.zeros(0), field)
        push = limit_norm(push, APPROACH * HALF_WIDTH)
        flown = limit_norm(wanted + push, speed)
        way = aviary.scene.goal - swarm.position
        return self.encoded(touch_down(flown, way, aviary.scene.goal[..., 2], aviary.task))

    @abstractmethod
    def goals(self, swarm: Swarm) -> np.ndarray:
        """Choose where drones are to fly; for those that are to leave their way set `_count` to 0.

        Args:
            swarm: The true state of all drones.

        Returns:
            (W, N, 3) places, m.
        """

    def _plan(self, w: int, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Find waypoints (K, 3), m."""
        way = plan(self._grid(w), start, goal)
        return way if len(way) else np.stack([start, goal])

    def _grid(self, w: int) -> Voxels:
        """Make the map of a world, or give the one that was made."""
        solids = self.aviary.solids(w)
        task = self.aviary.task
        if id(solids) not in self._grids:
            # Free cells are clear of everything by HALF_WIDTH and the drone's radius.
            clearance = HALF_WIDTH + task.context.collision_radius + VOXEL_SIZE / 2
            grid = voxels(
                bounds=solids.bounds,
                low=task.arena_low,
                high=task.arena_high,
                size=VOXEL_SIZE,
                clearance=clearance,
            )
            self._grids[id(solids)] = solids, grid
        return self._grids[id(solids)][1]

    def _keep(self, w: int, i: int, way: np.ndarray) -> None:
        """Keep the way of a drone, which flies to its second point."""
        # Room for a longer way than any before.
        more = len(way) - self._way.shape[2]
        if more > 0:
            worlds, drones, _, axes = self._way.shape
            room = np.zeros((worlds, drones, more, axes))
            self._way = np.concatenate([self._way, room], axis=2)
        self._way[w, i, : len(way)] = way
        self._count[w, i] = len(way)
        self._next[w, i] = 1


@register("policy")
class Planner(PathFollower):
    """Flight to the task's goals, which are taken to stand still, or to jump to another place."""

    name = "planner"
    remembers = (*PathFollower.remembers, "_goal")

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly; see `Policy`."""
        super().__init__(aviary)
        self._goal = aviary.scene.goal.copy()

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Give the task's goals (W, N, 3), m; ways to those that jumped are made anew."""
        goal, options = self.aviary.scene.goal, self.aviary.options
        step = options.max_speed / options.decision_hz
        self._count[np.linalg.norm(goal - self._goal, axis=-1) > step] = 0
        self._goal = goal.copy()
        return goal


@allocating
def follow(
    position: np.ndarray,
    velocity: np.ndarray,
    way: np.ndarray,
    count: np.ndarray,
    target: np.ndarray,
    limits: Limits,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute velocities along ways.

    Args:
        position: (W, N, 3) positions of the drones, m.
        velocity: (W, N, 3) their velocities, m/s.
        way: (W, N, K, 3) waypoints, m.
        count: (W, N) how many waypoints each drone has; 0 for none.
        target: (W, N) the waypoint that each drone flew to.
        limits: How ways are flown.

    Returns:
        (W, N, 3) velocities, m/s, zero where `count` is 0; and (W, N) the waypoint that each drone
        now flies to.
    """
    result = np.zeros(position.shape)
    target = target.copy()
    for w in range(count.shape[0]):
        for i in range(count.shape[1]):
            if count[w, i] > 0:
                # The leg to fly, then the velocity along it.
                here = vec3(position, w, i)
                moving = vec3(velocity, w, i)
                points = way[w, i, : count[w, i]]
                target[w, i] = next_waypoint(points, target[w, i], here, moving, limits)
                wanted = velocity_along(points, target[w, i], here, limits)
                for axis in range(3):
                    result[w, i, axis] = wanted[axis]
    return result, target


@func
def next_waypoint(points: np.ndarray, k: int, here: Vec3, velocity: Vec3, limits: Limits) -> int:
    """Choose the waypoint to fly to.

    It is the k-th, or the first after it that is neither passed within the delay nor nearly
    reached; the last one stays.

    Args:
        points: (K, 3) waypoints, m.
        k: The one that the drone flew to.
        here: Position of the drone, m.
        velocity: Velocity of the drone, m/s.
        limits: How ways are flown.
    """
    while k < len(points) - 1:
        direction, _ = leg(points, k)
        # How far the waypoint is along its leg, and how far the drone gets in the delay.
        gap = plus(point(points, k), -1.0, here)
        left = dot(gap, direction)
        flown_by_then = limits.delay * dot(velocity, direction)
        if left > max(flown_by_then, 0.5 * limits.half_width):
            break
        k += 1
    return k


@func
def velocity_along(points: np.ndarray, k: int, here: Vec3, limits: Limits) -> Vec3:
    """Compute the velocity along the leg to waypoint k, and back to that leg.

    A drone is slower the farther it is off the leg, beyond half_width.

    Args:
        points: (K, 3) waypoints, m.
        k: The waypoint.
        here: Position of the drone, m.
        limits: How ways are flown.

    Returns:
        The velocity, m/s.
    """
    direction, _ = leg(points, k)
    gap = plus(point(points, k), -1.0, here)
    # How far the waypoint is along the leg, and the way back to the leg.
    left = dot(gap, direction)
    aside = plus(gap, -left, direction)
    # Not faster than the corners ahead allow, nor than policy `straight` at the end.
    speed = braking(left, speed_past(points, k, limits), limits)
    if k == len(points) - 1:
        speed = min(speed, APPROACH * left)
    # Slower off the way, and back to it.
    off_way = math.sqrt(dot(aside, aside))
    speed *= limits.half_width / max(limits.half_width, off_way)
    back = (
        APPROACH * aside[0],
        APPROACH * aside[1],
        APPROACH * aside[2],
    )
    return plus(back, speed, direction)


@func
def speed_past(points: np.ndarray, k: int, limits: Limits) -> float:
    """Compute the speed with which waypoint k may be passed.

    All later corners can then be flown, and the last waypoint stops the drone.

    Args:
        points: (K, 3) waypoints, m.
        k: The waypoint.
        limits: How ways are flown.

    Returns:
        The speed, m/s.
    """
    speed = 0.0
    # From the end of the way back to the waypoint.
    for j in range(len(points) - 2, k - 1, -1):
        before, arrival = leg(points, j)
        after, departure = leg(points, j + 1)
        corner = corner_speed(dot(before, after), min(arrival, departure), limits)
        speed = min(corner, braking(departure, speed, limits))
    return speed


@func
def corner_speed(cosine: float, length: float, limits: Limits) -> float:
    """Compute the speed on the arc that rounds a corner between two legs.

    The arc that touches both legs has radius r, where r (1 / cos(theta / 2) - 1) is its distance
    from the corner, at most half_width, and r tan(theta / 2) that of the points where it touches,
    at most half a leg.

    Args:
        cosine: Cosine of the angle theta between the legs' directions.
        length: Length of the shorter leg, m.
        limits: How ways are flown.

    Returns:
        The speed, m/s.
    """
    half = math.sqrt(min(max(0.5 + 0.5 * cosine, 0.0), 1.0))  # cos(theta / 2)
    by_width = limits.half_width * half / (1.0 - half)
    by_length = 0.5 * length * half / math.sqrt(1.0 - half * half)
    radius = min(by_width, by_length)
    return math.sqrt(limits.acceleration * radius)


@func
def braking(distance: float, speed: float, limits: Limits) -> float:
    """Compute the speed from which another one is reached in a distance.

    It is v where distance = v delay + (v^2 - speed^2) / (2 acceleration), within the limit.

    Args:
        distance: The distance, m.
        speed: Speed to be reached, m/s.
        limits: How ways are flown.

    Returns:
        The speed v, m/s.
    """
    ahead = max(distance, 0.0)
    reaction = limits.acceleration * limits.delay
    square = reaction * reaction + speed * speed + 2.0 * limits.acceleration * ahead
    return min(limits.speed, math.sqrt(square) - reaction)


@func
def leg(points: np.ndarray, k: int) -> tuple[Vec3, float]:
    """Compute direction and length, m, of the leg that ends at waypoint k.

    The direction is zero where the leg is too short to have one.
    """
    way = plus(point(points, k), -1.0, point(points, k - 1))
    length = math.sqrt(dot(way, way))
    # Waypoints may fall together
    scale = 1.0 / length if length > NO_WAY else 0.0
    direction = (
        scale * way[0],
        scale * way[1],
        scale * way[2],
    )
    return direction, length


@func
def point(points: np.ndarray, k: int) -> Vec3:
    """Give points[k] (3,) as a tuple."""
    return points[k, 0], points[k, 1], points[k, 2]
