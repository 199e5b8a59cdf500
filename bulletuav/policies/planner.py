"""Flight along ways through a known city, found before it starts; policy `planner` flies so to the goals."""

import math
from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import dot, vec3
from bulletuav.geometry.solids import Solids
from bulletuav.kernel import func, kernel
from bulletuav.policies.astar import Voxels, plan, voxels
from bulletuav.policies.base import Policy
from bulletuav.policies.linear_program import along
from bulletuav.policies.potential import make_field, repulsion
from bulletuav.policies.straight import APPROACH
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

VOXEL_SIZE = 4.0  # m; with HALF_WIDTH and a drone of 0.6 m, streets 13 m wide have a way wherever the cells lie
HALF_WIDTH = 2.0  # m, to either side of the way: room for rounding corners, gusts and other drones
ACCELERATION = 5.0  # m/s^2
DELAY = 0.6  # s, from decision to velocity; so a Hummingbird rounds right angles within HALF_WIDTH at up to 20 m/s
NO_WAY = 1e-9  # m: a shorter leg has no direction


class Limits(NamedTuple):
    """How ways are flown: speed, m/s; acceleration at corners and to stop, m/s^2; delay of velocities, s; half width, m."""

    speed: float
    acceleration: float
    delay: float
    half_width: float


class PathFollower(Policy):
    """Along the shortest way between the buildings that stand at the start, found by A*; straight where there is none.

    Obstacles that are no part of the city are not seen. Living drones push each other off as in policy `potential`, but no
    harder than the correction towards the way pulls back at HALF_WIDTH from it: that avoids buildings before drones.
    """

    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def __init__(self, aviary: Aviary):
        super().__init__(aviary)
        self._grids: dict[
            int, tuple[Solids, Voxels]
        ] = {}  # by the id of the solids, kept here lest others get it
        self._way = np.zeros((*aviary.alive.shape, 2, 3))
        self._count = np.zeros(
            aviary.alive.shape, dtype=np.int64
        )  # of waypoints; 0 before there is a plan
        self._next = np.ones(aviary.alive.shape, dtype=np.int64)

    def reset(self, mask: np.ndarray) -> None:
        """Forget the ways of these worlds."""
        self._count[mask] = 0

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """The velocities of `follow` and the push, together limited to max_speed; plans for drones that have no way yet."""
        aviary, speed, goal = self.aviary, float(self.aviary.options.max_speed), self.goals(swarm)
        for w, i in np.argwhere(aviary.alive & (self._count == 0)).tolist():
            self._keep(w, i, self._plan(w, swarm.position[w, i], goal[w, i]))
        limits = Limits(speed, ACCELERATION, DELAY, HALF_WIDTH)
        wanted, self._next = follow(
            swarm.position, swarm.velocity, self._way, self._count, self._next, limits
        )
        field = make_field(aviary, surfaces=0.0)
        push = repulsion(
            swarm.position, aviary.alive, np.zeros((len(aviary.alive), 0, 3)), np.zeros(0), field
        )
        return self.encoded(limit_norm(wanted + limit_norm(push, APPROACH * HALF_WIDTH), speed))

    @abstractmethod
    def goals(self, swarm: Swarm) -> np.ndarray:
        """(W, N, 3) where drones are to fly, m; for those that are to leave their way it sets `_count` to 0."""

    def _plan(self, w: int, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Waypoints (K, 3), m."""
        way = plan(self._grid(w), start, goal)
        return way if len(way) else np.stack([start, goal])

    def _grid(self, w: int) -> Voxels:
        solids, task = self.aviary.solids(w), self.aviary.task
        if id(solids) not in self._grids:
            clearance = HALF_WIDTH + task.context.collision_radius + VOXEL_SIZE / 2
            grid = voxels(solids.bounds, task.arena_low, task.arena_high, VOXEL_SIZE, clearance)
            self._grids[id(solids)] = solids, grid
        return self._grids[id(solids)][1]

    def _keep(self, w: int, i: int, way: np.ndarray) -> None:
        more = len(way) - self._way.shape[2]
        if more > 0:
            self._way = np.pad(self._way, ((0, 0), (0, 0), (0, more), (0, 0)))
        self._way[w, i, : len(way)], self._count[w, i], self._next[w, i] = way, len(way), 1


class Planner(PathFollower):
    """To the goals, which are taken to stand still."""

    name = "planner"

    def goals(self, swarm: Swarm) -> np.ndarray:
        """The task's."""
        return self.aviary.scene.goal


@kernel
def follow(position, velocity, way, count, target, limits):
    """Velocities (W, N, 3), m/s, along ways (W, N, K, 3), m, and the waypoint (W, N) that each drone now flies to.

    Of drones at (W, N, 3), m, m/s, with `count` (W, N) waypoints, that flew to the `target` (W, N); zero where count is 0.
    """
    result, target = np.zeros(position.shape), target.copy()
    for w in range(count.shape[0]):
        for i in range(count.shape[1]):
            if count[w, i] > 0:
                here, moving, points = (
                    vec3(position, w, i),
                    vec3(velocity, w, i),
                    way[w, i, : count[w, i]],
                )
                target[w, i] = next_waypoint(points, target[w, i], here, moving, limits)
                wanted = velocity_along(points, target[w, i], here, limits)
                for axis in range(3):
                    result[w, i, axis] = wanted[axis]
    return result, target


@func
def next_waypoint(points, k, here, velocity, limits):
    """The waypoint to fly to: not the k-th if it is passed within the delay, or nearly reached; the last one stays."""
    while k < len(points) - 1:
        direction, _ = leg(points, k)
        left = dot(along(point(points, k), -1.0, here), direction)
        if left > max(limits.delay * dot(velocity, direction), 0.5 * limits.half_width):
            break
        k += 1
    return k


@func
def velocity_along(points, k, here, limits):
    """Velocity, m/s, from `here` along the leg to waypoint k, and back to it; slower the farther off it than half_width."""
    direction, _ = leg(points, k)
    gap = along(point(points, k), -1.0, here)
    left = dot(gap, direction)
    aside = along(gap, -left, direction)
    speed = braking(left, speed_past(points, k, limits), limits)
    if k == len(points) - 1:
        speed = min(speed, APPROACH * left)
    speed *= limits.half_width / max(limits.half_width, math.sqrt(dot(aside, aside)))
    return along((APPROACH * aside[0], APPROACH * aside[1], APPROACH * aside[2]), speed, direction)


@func
def speed_past(points, k, limits):
    """Speed, m/s, with which waypoint k may be passed so that all later corners can be flown, and the last one stops."""
    speed = 0.0
    for j in range(len(points) - 2, k - 1, -1):
        (before, arrival), (after, departure) = leg(points, j), leg(points, j + 1)
        corner = corner_speed(dot(before, after), min(arrival, departure), limits)
        speed = min(corner, braking(departure, speed, limits))
    return speed


@func
def corner_speed(cosine, length, limits):
    """Speed, m/s, on the arc that rounds a corner between legs of at least `length` m at half_width or less from it.

    The arc that touches both legs has radius r, where r (1 / cos(theta / 2) - 1) is its distance from the corner and
    r tan(theta / 2) that of the points where it touches, at most half a leg.
    """
    half = math.sqrt(min(max(0.5 + 0.5 * cosine, 0.0), 1.0))  # cos(theta / 2)
    radius = min(
        limits.half_width * half / (1.0 - half), 0.5 * length * half / math.sqrt(1.0 - half * half)
    )
    return math.sqrt(limits.acceleration * radius)


@func
def braking(distance, speed, limits):
    """Speed v, m/s, from which `speed` is reached in `distance`, m: v delay + (v^2 - speed^2) / 2 acceleration."""
    reaction = limits.acceleration * limits.delay
    square = reaction * reaction + speed * speed + 2.0 * limits.acceleration * max(distance, 0.0)
    return min(limits.speed, math.sqrt(square) - reaction)


@func
def leg(points, k):
    """Direction and length, m, of the leg that ends at waypoint k; zeros where it has none."""
    way = along(point(points, k), -1.0, point(points, k - 1))
    length = math.sqrt(dot(way, way))
    scale = 1.0 / length if length > NO_WAY else 0.0
    return (scale * way[0], scale * way[1], scale * way[2]), length


@func
def point(points, k):
    """points[k] (3,) as a tuple."""
    return points[k, 0], points[k, 1], points[k, 2]
