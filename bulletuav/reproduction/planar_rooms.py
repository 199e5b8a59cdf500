"""Robots in rooms with square obstacles in a plane: rooms of files, flights by ORCA, and results.

Robots are single integrators: they have the velocity that they choose.

References:
    B. Riviere, W. Hoenig, Y. Yue, S.-J. Chung, GLAS: Global-to-Local Safe Autonomy Synthesis for
    Multi-Robot Motion Planning with End-to-End Learning, RA-L 2020: rooms, limits and results as in
    baseline/orca/orca.cpp and results/singleintegrator/stats.py of its repository.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating
from bulletuav.errors import as_sequence, finite, naming, numbers_of, shown
from bulletuav.geometry.rotation import vec3
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import read_yaml
from bulletuav.policies.astar import plan_path
from bulletuav.policies.half_spaces import (
    AvoidanceParameters,
    add_half_space,
    add_obstacle_half_spaces,
    orca_half_space,
)
from bulletuav.policies.linear_program import DEPTH, solve_velocity
from bulletuav.policies.orca import orca_velocities
from bulletuav.policies.planner import PathLimits
from bulletuav.policies.traffic import (
    Buildings,
    ObstacleClearance,
    Traffic,
    find_surfaces,
    tabulate_buildings,
)
from bulletuav.policies.voxels import build_voxels
from bulletuav.reproduction.rooms import RoomPaths, find_nearest_distances

PERIOD = 0.05
"""Duration of a step, s"""
NUM_STEPS = 1000
"""Number of steps of a flight"""
ROBOT_SPEED = 0.5
"""Speed limit, m/s"""
AVOIDED_RADIUS = 0.16
"""Radius of a robot in collision avoidance, m"""
ROBOT_RADIUS = 0.15
"""Radius of a robot in the test of collisions, m"""
SENSING_RANGE = 3.0
"""Distance up to which robots see each other, m"""
NUM_SEEN = 5
"""Number of nearest robots that are avoided"""
AVOIDED_TIME = 1.0
"""Time horizon of collision avoidance, both for robots and for obstacles, s"""
GOAL_DISTANCE = 0.5
"""Distance to the goal at which it is reached, m"""
ARRIVED = 0.05
"""Distance to the goals at which all robots stop, m"""
SLACK = 1e-4
"""Overlap that is no collision, m"""
ALTITUDE, HALF_HEIGHT = 1.0, 1.0
"""Height of the plane, and half the height of the obstacles, m; they have no effect"""
CELL = 0.1
"""Size of a cell of the map for paths, m"""
ROBOT_PATH_LIMITS = PathLimits(ROBOT_SPEED, acceleration=5.0, delay=PERIOD, half_width=0.1)
"""Limits along paths; integrators have no limit of acceleration"""
PARAMETERS = AvoidanceParameters(
    separation=2 * AVOIDED_RADIUS,
    horizon=AVOIDED_TIME,
    braking_time=AVOIDED_TIME,
    recovery_time=PERIOD,
    max_speed=ROBOT_SPEED,
)
"""Parameters of ORCA"""
CLEARANCE = ObstacleClearance(AVOIDED_RADIUS, 0.0, AVOIDED_RADIUS + AVOIDED_TIME * ROBOT_SPEED)
"""Distances to obstacles and walls"""
MAX_ROBOTS = 1000
"""Maximum number of robots or obstacles in a file"""
MAX_LENGTH = 1000.0
"""Maximum length of a room, m"""

RoomPilot = Literal["plain", "orca", "paths"]
"""Pilots of robots: ORCA as published; with the right turn of policy `orca`; and with this turn
along the shortest paths through the room, by A*"""


class PlanarRoom(NamedTuple):
    """A room with robots and unit squares.

    Attributes:
        start: (N, 2) starts, m.
        goal: (N, 2) goals, m.
        square: (K, 2) lower corners of the obstacles, squares of 1 m, m.
        size: (2,) lengths of the room, m; its lower corner is the origin.
    """

    start: np.ndarray
    goal: np.ndarray
    square: np.ndarray
    size: np.ndarray


class RoomFlights(NamedTuple):
    """Results of W rooms with N robots each.

    Attributes:
        reached: (W, N) bool, which robots are near their goals in the end.
        hit_robot: (W, N) bool, which robots overlapped another robot.
        hit_square: (W, N) bool, which robots overlapped an obstacle.
    """

    reached: np.ndarray
    hit_robot: np.ndarray
    hit_square: np.ndarray

    @property
    def collided(self) -> np.ndarray:
        """Which robots overlapped another robot or an obstacle, (W, N) bool."""
        either: np.ndarray = self.hit_robot | self.hit_square
        return either

    @property
    def success(self) -> np.ndarray:
        """Fraction of the robots that reach their goals without collision, (W,)."""
        fraction: np.ndarray = (self.reached & ~self.collided).mean(axis=1)
        return fraction


def read_planar_room(path: Path) -> PlanarRoom:
    """Read a room of the GLAS repository.

    Its starts and goals are relative to the centres of unit cells, so that 0.5 m is added.

    Args:
        path: YAML file with `agents`, each with `start` and `goal`, and `map` with `dimensions` and
            `obstacles`, the lower corners of squares of 1 m.

    Returns:
        The room.

    Raises:
        ValueError: If a value is missing or invalid, or a start or a goal is not in the room or
            within an obstacle.
    """
    with naming(path):
        data = read_yaml(path)
        agents = _entry(data, "agents")
        agents = as_sequence("agents", agents, most=MAX_ROBOTS)
        if not agents:
            raise ValueError("agents is empty: at least one robot is needed")
        ends = [
            [_pair(f"{name} of robot {k}", _entry(one, name)) for name in ("start", "goal")]
            for k, one in enumerate(agents)
        ]
        plan = _entry(data, "map")
        size = _pair("dimensions", _entry(plan, "dimensions"), 1.0)
        squares = as_sequence("obstacles", _entry(plan, "obstacles"), most=MAX_ROBOTS)
        pairs = [_pair(f"obstacle {k}", one) for k, one in enumerate(squares)]
        square = np.array(pairs).reshape(-1, 2)
        start, goal = np.swapaxes(np.array(ends), 0, 1) + 0.5
        for name, places in (("start", start), ("goal", goal)):
            _check_free(name, places, square, size)
    return PlanarRoom(start, goal, square, np.array(size))


def _check_free(
    name: str, places: np.ndarray, square: np.ndarray, size: tuple[float, float]
) -> None:
    """Check that places (N, 2) are in the room and not within its squares.

    Raises:
        ValueError: If one is not.
    """
    for k, place in enumerate(places):
        here = f"{name} of robot {k} is at ({place[0]:g}, {place[1]:g}) m"
        if not ((place >= 0.0) & (place <= size)).all():
            raise ValueError(
                f"{here}: a place in the room of {size[0]:g} m x {size[1]:g} m is needed"
            )
        inside = ((place > square) & (place < square + 1.0)).all(axis=1)
        if inside.any():
            raise ValueError(f"{here}, within obstacle {np.argmax(inside)}: a free place is needed")


def _entry(value: Any, name: str) -> Any:
    """Return an entry of a mapping."""
    if not isinstance(value, dict) or name not in value:
        raise ValueError(f"{name} is missing: a room of the GLAS repository is needed")
    return value[name]


def _pair(name: str, value: Any, least: float = -MAX_LENGTH) -> tuple[float, float]:
    """Return a point of two coordinates, m."""
    pair = numbers_of(f"{name} is {shown(value)}:", value)
    if pair.shape != (2,):
        raise ValueError(f"{name} is {shown(value)}: two coordinates are needed")
    x, y = (finite(name, one, least, MAX_LENGTH) for one in pair.tolist())
    return x, y


def fly_planar_rooms(
    rooms: Sequence[PlanarRoom],
    pilot: RoomPilot = "plain",
    *,
    num_steps: int = NUM_STEPS,
) -> RoomFlights:
    """Fly all robots to their goals, until all have arrived.

    Args:
        rooms: W rooms with the same number of robots.
        pilot: Pilot of all robots.
        num_steps: Maximum number of steps.

    Returns:
        The results.
    """
    position, goal = (np.stack([_raise(room[k]) for room in rooms]) for k in (0, 1))
    velocity = np.zeros_like(position)
    walls = [_walls(room) for room in rooms]
    buildings = tabulate_buildings([Solids(boxes) for boxes in walls])
    paths = _plan_paths(rooms, position, goal) if pilot == "paths" else None
    choose = plain_orca_velocities if pilot == "plain" else orca_velocities
    hit = np.zeros((2, *position.shape[:2]), dtype=bool)
    for _ in range(num_steps):
        hit |= _find_collisions(position, rooms)
        offset = goal - position
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        if (distance <= ARRIVED).all():
            break
        wanted = offset / np.maximum(distance, 1.0)
        if paths is not None:
            wanted, paths = paths.follow(position, velocity, ROBOT_PATH_LIMITS)
        velocity = choose(_find_traffic(position, velocity, buildings), wanted, PARAMETERS)
        position = position + PERIOD * velocity
    hit |= _find_collisions(position, rooms)
    reached = np.linalg.norm(goal - position, axis=-1) <= GOAL_DISTANCE
    return RoomFlights(reached, *hit)


def _raise(place: np.ndarray) -> np.ndarray:
    """Return points (N, 2) of the plane as points (N, 3) in space, m."""
    return np.column_stack([place, np.full(len(place), ALTITUDE)])


def _walls(room: PlanarRoom) -> np.ndarray:
    """Return the obstacles and the four walls of a room as boxes (K + 4, 2, 3), m."""
    (x, y), one = room.size, 1.0
    low = [*room.square, (-one, -one), (x, -one), (0, -one), (0, y)]
    high = [*(room.square + one), (0, y + one), (x + one, y + one), (x, 0), (x, y + one)]
    boxes = np.empty((len(low), 2, 3))
    boxes[:, 0, :2], boxes[:, 1, :2] = low, high
    boxes[:, :, 2] = ALTITUDE - HALF_HEIGHT, ALTITUDE + HALF_HEIGHT
    return boxes


def _find_traffic(position: np.ndarray, velocity: np.ndarray, buildings: Buildings) -> Traffic:
    """Return the nearest robots and the surfaces around each robot."""
    worlds, robots, _ = position.shape
    between = position[:, None] - position[:, :, None]
    square = (between**2).sum(axis=-1)
    square[:, np.arange(robots), np.arange(robots)] = np.inf
    # A stable sort keeps equally distant robots in a fixed order
    nearest = np.argsort(square, axis=-1, kind="stable")[..., :NUM_SEEN]
    near = np.take_along_axis(square, nearest, axis=-1)
    world = np.arange(worlds)[:, None, None]
    anywhere = (np.full(3, -np.inf), np.full(3, np.inf))
    nothing = np.zeros((worlds, robots, 0, 3))
    return Traffic(
        velocity=velocity,
        goal=nothing,
        goal_velocity=nothing,
        offset=np.take_along_axis(between, nearest[..., None], axis=2),
        other_velocity=velocity[world, nearest],
        known=near <= SENSING_RANGE**2,
        sphere=nothing,
        sphere_velocity=nothing,
        sphere_radius=nothing[..., 0],
        surface=find_surfaces(position, anywhere, np.arange(worlds), buildings, CLEARANCE),
    )


@allocating
def plain_orca_velocities(
    traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
) -> np.ndarray:
    """Compute the permitted velocities nearest to the preferred ones, without a right turn.

    As in the paper and in RVO2, and unlike in `orca_velocities`, nothing breaks symmetries.

    Args:
        traffic: The traffic around each robot, with rows of other robots, without spheres.
        preferred: (W, N, 3) preferred velocities, m/s.
        parameters: Parameters of collision avoidance.

    Returns:
        (W, N, 3) velocities, m/s.

    References:
        J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011).
    """
    result = np.empty(preferred.shape)
    rows = np.empty((DEPTH, traffic.known.shape[2] + traffic.surface.shape[2], 4))
    scratch = np.empty_like(rows)
    for w in range(preferred.shape[0]):
        for i in range(preferred.shape[1]):
            own = vec3(traffic.velocity, w, i)
            count = add_obstacle_half_spaces(rows, 0, traffic, parameters, w, i)
            for k in range(traffic.known.shape[2]):
                if traffic.known[w, i, k]:
                    offset = vec3(traffic.offset[w], i, k)
                    other = vec3(traffic.other_velocity[w], i, k)
                    keep = parameters.separation
                    space = orca_half_space(offset, own, other, keep, parameters, 0.5)
                    count = add_half_space(rows, count, space, parameters.max_speed)
            wanted = vec3(preferred, w, i)
            best = solve_velocity(rows, scratch, count, wanted, parameters.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


def _plan_paths(rooms: Sequence[PlanarRoom], start: np.ndarray, goal: np.ndarray) -> RoomPaths:
    """Plan the shortest path of each robot between the obstacles of its room."""
    found = []
    for room, starts, goals in zip(rooms, start, goal, strict=True):
        low = np.array([0.0, 0.0, ALTITUDE - CELL / 2])
        high = np.array([*room.size, ALTITUDE + CELL / 2])
        # A path through free cells is half a cell nearer to obstacles than their centres
        grid = build_voxels(_walls(room), low, high, CELL, AVOIDED_RADIUS + CELL / 2)
        found += [plan_path(grid, one, end) for one, end in zip(starts, goals, strict=True)]
    return RoomPaths.of(found, len(rooms))


def _find_collisions(position: np.ndarray, rooms: Sequence[PlanarRoom]) -> np.ndarray:
    """Return which robots overlap another robot, and which an obstacle: (2, W, N) bool.

    As in the published statistics, walls are ignored.
    """
    place = position[..., :2]
    robot = find_nearest_distances(place) < 2 * ROBOT_RADIUS - SLACK
    square = np.zeros_like(robot)
    for here, room, hit in zip(place, rooms, square, strict=True):
        nearest = np.clip(here[:, None], room.square, room.square + 1.0)
        distance = np.linalg.norm(here[:, None] - nearest, axis=-1)
        hit |= (distance < ROBOT_RADIUS - SLACK).any(axis=1)
    return np.stack([robot, square])
