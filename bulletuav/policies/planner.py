"""Flight along precomputed paths through a known city; policy `planner`.

A path is a sequence of waypoints; leg k is the segment that ends at waypoint k.
"""

import math
from abc import abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.control.actions import limit_norm
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, vec3
from bulletuav.geometry.solids import Solids
from bulletuav.policies.astar import plan_path
from bulletuav.policies.half_spaces import AvoidanceParameters, horizontal_right
from bulletuav.policies.orca import Orca
from bulletuav.policies.straight import APPROACH
from bulletuav.policies.traffic import FACES, Traffic
from bulletuav.policies.voxels import Voxels, build_voxels
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

VOXEL_SIZE = 4.0
"""Size of the voxels, m; with HALF_WIDTH and drones of 0.6 m, streets 13 m wide are passable for
any alignment of the grid"""
HALF_WIDTH = 2.0
"""Free width on either side of a path, m: for rounded corners, gusts and other drones"""
NARROW = 0.5
"""Scale of VOXEL_SIZE and HALF_WIDTH for paths through narrow streets"""
DETOUR = 1.5
"""Length of a path through wide streets over that through narrow ones up to which it is flown"""
ACCELERATION = 5.0
"""Acceleration in corners and for braking, m/s^2"""
DELAY = 0.6
"""Time from a decision until the velocity is reached, s; a Hummingbird then rounds right angles
within HALF_WIDTH at up to 20 m/s"""
MIN_LEG_LENGTH = 1e-9
"""Minimum length of a leg that has a direction, m"""


class PathLimits(NamedTuple):
    """Limits for flight along paths.

    Attributes:
        speed: Maximum speed, m/s.
        acceleration: Maximum acceleration in corners and for braking, m/s^2.
        delay: Time until a commanded velocity is reached, s.
        half_width: Maximum distance from the path, m.
    """

    speed: float
    acceleration: float
    delay: float
    half_width: float


class PathFollower(Orca):
    """Flight along the shortest path between the buildings, found by A*.

    The map contains the buildings at the start of the episode. If there is no path, the drone flies
    straight. The velocity along the path is the preferred velocity of policy `orca`, which avoids
    other drones and obstacles.
    """

    remembers: ClassVar[tuple[str, ...]] = ("_path", "_count", "_next", "_half_width")

    def __init__(self, aviary: Aviary) -> None:
        """Allocate maps and paths; see `Policy`."""
        super().__init__(aviary)
        shape = aviary.alive.shape
        # Maps by the id of the solids, which keeping them alive keeps unique, and by scale.
        self._grids: dict[tuple[int, float], tuple[Solids, Voxels]] = {}
        # Waypoints, m; their number, 0 before planning; and the index of the current one.
        self._path = np.zeros((*shape, 2, 3))
        self._count = np.zeros(shape, dtype=np.int64)
        self._next = np.ones(shape, dtype=np.int64)
        # Free width on either side of each path, m.
        self._half_width = np.full(shape, HALF_WIDTH)

    def reset(self, mask: np.ndarray) -> None:
        """Drop the paths of the worlds in `mask` (W,)."""
        self._count[mask] = 0

    def preferred(self, traffic: Traffic, swarm: Swarm) -> np.ndarray:
        """Return the velocities of `follow_paths`; drones without a path get one first."""
        aviary = self.aviary
        goal = self.goals(swarm)
        without_path = aviary.alive & (self._count == 0)
        for w, i in np.argwhere(without_path).tolist():
            path, self._half_width[w, i] = self._plan(w, swarm.position[w, i], goal[w, i])
            self._store_path(w, i, path)
        speed, period = float(aviary.options.max_speed), 1.0 / aviary.options.decision_hz
        limits = PathLimits(speed, ACCELERATION, max(DELAY, period), HALF_WIDTH)
        paths = (self._path, self._count, self._next, self._half_width)
        wanted, self._next = follow_paths(swarm.position, swarm.velocity, *paths, limits)
        return limit_norm(wanted, limits.speed)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Compute `orca_velocities` that near buildings stay on the path to keep clear of them."""
        paths = (self._path, self._count, self._next, self._half_width)
        tube = tube_surfaces(self.aviary.swarm.position, *paths)
        bounds, walls = np.split(traffic.surface, [FACES], axis=2)
        # Far from buildings, at least one decision away, drones need space to pass each other
        period = 1 / self.aviary.options.decision_hz
        distance = walls[..., 3].min(axis=2, initial=np.inf)
        is_near = distance < max(parameters.separation, period * parameters.max_speed)
        tube[..., 3] = np.where(is_near[..., None], tube[..., 3], np.inf)
        # Starts may be nearer to walls than paths are; paths turn after less than BRAKING
        walls[..., 3] += self.clearance.margin
        walls[..., 3] *= parameters.braking_time / max(DELAY, period)
        traffic = traffic._replace(surface=np.concatenate([bounds, walls, tube], axis=2))
        velocity = super().avoid(traffic, preferred, parameters)
        # If no velocity is permitted, other drones must not push any drone into a wall
        surface = np.concatenate([bounds, walls], axis=2)
        for k in range(surface.shape[2]):
            normal, distance = surface[:, :, k, :3], surface[:, :, k, 3]
            fastest = -distance / parameters.braking_time
            missing = np.maximum(fastest - (normal * velocity).sum(axis=-1), 0.0)
            velocity = velocity + missing[..., None] * normal
        return limit_norm(velocity, parameters.max_speed)

    @abstractmethod
    def goals(self, swarm: Swarm) -> np.ndarray:
        """Choose the destinations; set `_count` to 0 for drones that need a new path.

        Args:
            swarm: The true state of all drones.

        Returns:
            (W, N, 3) destinations, m.
        """

    def _plan(self, w: int, start: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
        """Plan a path, through wide streets unless they are a long detour.

        Returns:
            (K, 3) waypoints, m, a straight segment if there is no path; and the free width on
            either side, m.
        """
        wide = plan_path(self._voxel_map(w), start, goal)
        # No path through narrow streets is shorter than the straight line
        if path_length(wide) <= DETOUR * math.dist(start, goal):
            return wide, HALF_WIDTH
        narrow = plan_path(self._voxel_map(w, NARROW), start, goal)
        if len(narrow) and path_length(wide) > DETOUR * path_length(narrow):
            return narrow, NARROW * HALF_WIDTH
        return (wide if len(wide) else np.stack([start, goal])), HALF_WIDTH

    def _voxel_map(self, w: int, scale: float = 1.0) -> Voxels:
        """Return the voxel map of a world at a scale, and build it on first use."""
        solids = self.aviary.solids(w)
        task = self.aviary.task
        key = id(solids), scale
        if key not in self._grids:
            # Free cells have a clearance of half_width plus the radius of a drone.
            clearance = scale * (HALF_WIDTH + VOXEL_SIZE / 2) + task.context.collision_radius
            grid = build_voxels(
                bounds=solids.bounds,
                low=task.arena_low,
                high=task.arena_high,
                size=scale * VOXEL_SIZE,
                clearance=clearance,
            )
            self._grids[key] = solids, grid
        return self._grids[key][1]

    def _store_path(self, w: int, i: int, path: np.ndarray) -> None:
        """Store the path of a drone, which flies to its second waypoint first."""
        # Enlarge the buffer for longer paths.
        more = len(path) - self._path.shape[2]
        if more > 0:
            worlds, drones, _, axes = self._path.shape
            padding = np.zeros((worlds, drones, more, axes))
            self._path = np.concatenate([self._path, padding], axis=2)
        self._path[w, i, : len(path)] = path
        self._count[w, i] = len(path)
        self._next[w, i] = 1


def path_length(path: np.ndarray) -> float:
    """Return the length of a path (K, 3), m; infinite for an empty one."""
    if not len(path):
        return math.inf
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


@register("policy")
class PathPlanner(PathFollower):
    """Flight to the goals of the task, which may be static or jump."""

    name = "planner"
    remembers = (*PathFollower.remembers, "_goal")

    def __init__(self, aviary: Aviary) -> None:
        """Store the current goals; see `Policy`."""
        super().__init__(aviary)
        self._goal = aviary.scene.goal.copy()

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Return the goals of the task (W, N, 3), m; replan for goals that jumped."""
        goal, options = self.aviary.scene.goal, self.aviary.options
        step = options.max_speed / options.decision_hz
        self._count[np.linalg.norm(goal - self._goal, axis=-1) > step] = 0
        self._goal = goal.copy()
        return goal


@allocating
def follow_paths(
    position: np.ndarray,
    velocity: np.ndarray,
    path: np.ndarray,
    count: np.ndarray,
    target: np.ndarray,
    half_width: np.ndarray,
    limits: PathLimits,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute velocities along paths.

    Args:
        position: (W, N, 3) positions of the drones, m.
        velocity: (W, N, 3) velocities of the drones, m/s.
        path: (W, N, K, 3) waypoints, m.
        count: (W, N) number of waypoints of each drone; 0 for no path.
        target: (W, N) index of the current waypoint of each drone.
        half_width: (W, N) free width on either side of each path, m; replaces that of the limits.
        limits: Limits for flight along paths.

    Returns:
        (W, N, 3) velocities, m/s, zero where `count` is 0; and (W, N) indices of the new current
        waypoints.
    """
    result = np.zeros(position.shape)
    target = target.copy()
    for w in range(count.shape[0]):
        for i in range(count.shape[1]):
            if count[w, i] > 0:
                here = vec3(position, w, i)
                moving = vec3(velocity, w, i)
                points = path[w, i, : count[w, i]]
                narrow = PathLimits(
                    limits.speed, limits.acceleration, limits.delay, half_width[w, i]
                )
                target[w, i] = next_waypoint(points, target[w, i], here, moving, narrow)
                wanted = velocity_along(points, target[w, i], here, narrow)
                for axis in range(3):
                    result[w, i, axis] = wanted[axis]
    return result, target


@allocating
def tube_surfaces(
    position: np.ndarray,
    path: np.ndarray,
    count: np.ndarray,
    target: np.ndarray,
    half_width: np.ndarray,
) -> np.ndarray:
    """Compute the sides of a square tube around the current leg of each drone, and its rear end.

    Args:
        position: (W, N, 3) positions of the drones, m.
        path: (W, N, K, 3) waypoints, m.
        count: (W, N) number of waypoints of each drone; 0 for no path.
        target: (W, N) index of the current waypoint of each drone.
        half_width: (W, N) distance of the sides and of the end from the leg, m.

    Returns:
        (W, N, 5, 4) surfaces, as in `Traffic`: unit normal into the tube, and the distance that
        the drone may move against it, m, negative outside the tube; infinite without a leg.
    """
    result = np.zeros((*count.shape, 5, 4))
    result[..., 3] = np.inf
    for w in range(count.shape[0]):
        for i in range(count.shape[1]):
            points = path[w, i, : count[w, i]]
            k = target[w, i]
            if count[w, i] == 0:
                continue
            direction, length = leg_direction(points, k)
            if length <= MIN_LEG_LENGTH:
                continue
            offset = plus(vec3(position, w, i), -1.0, waypoint_at(points, k - 1))
            for axis in range(3):
                result[w, i, 4, axis] = direction[axis]
            result[w, i, 4, 3] = half_width[w, i] + dot(offset, direction)
            right = horizontal_right(direction)
            for row, normal in enumerate((right, cross(right, direction))):
                deviation = dot(offset, normal)
                for axis in range(3):
                    result[w, i, 2 * row, axis] = normal[axis]
                    result[w, i, 2 * row + 1, axis] = -normal[axis]
                result[w, i, 2 * row, 3] = half_width[w, i] + deviation
                result[w, i, 2 * row + 1, 3] = half_width[w, i] - deviation
    return result


@func
def next_waypoint(
    points: np.ndarray, k: int, here: Vec3, velocity: Vec3, limits: PathLimits
) -> int:
    """Return the index of the waypoint to fly to.

    This is the first waypoint from k on that is neither passed within the delay nor nearly reached,
    at most the last one.

    Args:
        points: (K, 3) waypoints, m.
        k: Index of the current waypoint.
        here: Position of the drone, m.
        velocity: Velocity of the drone, m/s.
        limits: Limits for flight along paths.
    """
    while k < len(points) - 1:
        direction, _ = leg_direction(points, k)
        # Remaining distance along the leg, and distance flown within the delay.
        offset = plus(waypoint_at(points, k), -1.0, here)
        remaining = dot(offset, direction)
        flown_by_then = limits.delay * dot(velocity, direction)
        if remaining > max(flown_by_then, 0.5 * limits.half_width):
            break
        k += 1
    return k


@func
def velocity_along(points: np.ndarray, k: int, here: Vec3, limits: PathLimits) -> Vec3:
    """Compute the velocity along the leg to waypoint k, with a correction towards the leg.

    Beyond half_width, the speed decreases with the distance from the leg.

    Args:
        points: (K, 3) waypoints, m.
        k: Index of the waypoint.
        here: Position of the drone, m.
        limits: Limits for flight along paths.

    Returns:
        The velocity, m/s.
    """
    direction, _ = leg_direction(points, k)
    offset = plus(waypoint_at(points, k), -1.0, here)
    # Remaining distance along the leg, and offset to the leg.
    remaining = dot(offset, direction)
    aside = plus(offset, -remaining, direction)
    # Limited by the corners ahead, and at the end by the approach of policy `straight`.
    speed = braking_speed(remaining, max_passing_speed(points, k, limits), limits)
    if k == len(points) - 1:
        speed = min(speed, APPROACH * remaining)
    # Slow down away from the path, and return to it.
    deviation = math.sqrt(dot(aside, aside))
    speed *= limits.half_width / max(limits.half_width, deviation)
    back = (
        APPROACH * aside[0],
        APPROACH * aside[1],
        APPROACH * aside[2],
    )
    return plus(back, speed, direction)


@func
def max_passing_speed(points: np.ndarray, k: int, limits: PathLimits) -> float:
    """Compute the maximum speed at waypoint k.

    At this speed, all later corners can be flown and the drone can stop at the last waypoint.

    Args:
        points: (K, 3) waypoints, m.
        k: Index of the waypoint.
        limits: Limits for flight along paths.

    Returns:
        The speed, m/s.
    """
    speed = 0.0
    # Backward pass from the end of the path.
    for j in range(len(points) - 2, k - 1, -1):
        before, arrival = leg_direction(points, j)
        after, departure = leg_direction(points, j + 1)
        corner = corner_speed(dot(before, after), min(arrival, departure), limits)
        speed = min(corner, braking_speed(departure, speed, limits))
    return speed


@func
def corner_speed(cosine: float, length: float, limits: PathLimits) -> float:
    """Compute the speed on the arc that rounds a corner between two legs.

    The arc that is tangent to both legs has radius r. Its distance from the corner is r (1 /
    cos(theta / 2) - 1), at most half_width. Its tangent points are r tan(theta / 2) from the
    corner, at most half a leg.

    Args:
        cosine: Cosine of the angle theta between the directions of the legs.
        length: Length of the shorter leg, m.
        limits: Limits for flight along paths.

    Returns:
        The speed, m/s.
    """
    half = math.sqrt(min(max(0.5 + 0.5 * cosine, 0.0), 1.0))  # cos(theta / 2)
    by_width = limits.half_width * half / (1.0 - half)
    by_length = 0.5 * length * half / math.sqrt(1.0 - half * half)
    radius = min(by_width, by_length)
    return math.sqrt(limits.acceleration * radius)


@func
def braking_speed(distance: float, speed: float, limits: PathLimits) -> float:
    """Compute the maximum speed from which a lower speed is reached within a distance.

    The speed v satisfies distance = v delay + (v^2 - speed^2) / (2 acceleration), and is limited to
    the maximum speed.

    Args:
        distance: Distance, m.
        speed: Speed at the end of the distance, m/s.
        limits: Limits for flight along paths.

    Returns:
        The speed v, m/s.
    """
    ahead = max(distance, 0.0)
    reaction = limits.acceleration * limits.delay
    square = reaction * reaction + speed * speed + 2.0 * limits.acceleration * ahead
    return min(limits.speed, math.sqrt(square) - reaction)


@func
def leg_direction(points: np.ndarray, k: int) -> tuple[Vec3, float]:
    """Compute direction and length, m, of the leg that ends at waypoint k.

    The direction is zero if the leg is too short.
    """
    segment = plus(waypoint_at(points, k), -1.0, waypoint_at(points, k - 1))
    length = math.sqrt(dot(segment, segment))
    # Waypoints may coincide
    scale = 1.0 / length if length > MIN_LEG_LENGTH else 0.0
    direction = (
        scale * segment[0],
        scale * segment[1],
        scale * segment[2],
    )
    return direction, length


@func
def waypoint_at(points: np.ndarray, k: int) -> Vec3:
    """Return points[k] (3,) as a tuple."""
    return points[k, 0], points[k, 1], points[k, 2]
