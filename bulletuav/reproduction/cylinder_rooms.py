"""Quadrotors in rooms with cylinders: rooms of QuadSwarm, flights, and results by its definitions.

References:
    Z. Huang, Z. Yang, R. Krupani, B. Senbaslar, S. Batra, G. S. Sukhatme, Collision Avoidance and
    Navigation for a Quadrotor Swarm Using End-to-end Deep Reinforcement Learning, ICRA 2024;
    gym_art/quadrotor_multi of https://github.com/Zhehui-Huang/quad-swarm-rl, commit 9d7beaf.
"""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from bulletuav.envs.airspace import Airspace
from bulletuav.policies.astar import plan_path
from bulletuav.policies.half_spaces import AvoidanceParameters
from bulletuav.policies.orca import orca_velocities
from bulletuav.policies.planner import PathLimits
from bulletuav.policies.straight import preferred_velocity
from bulletuav.policies.traffic import Traffic
from bulletuav.policies.voxels import Voxels
from bulletuav.reproduction.rooms import RoomPaths, find_nearest_distances

ROOM_LENGTH = 10.0
"""Edge length of the room, m; its centre is the origin, on the floor"""
NUM_CELLS = 8
"""Number of cells of 1 m along each side of the area of cylinders, starts and goals"""
CYLINDER_RADIUS = 0.3
"""Radius of the cylinders, as high as the room, m"""
DRONE_RADIUS = 0.046
"""Radius of a drone: distance of its rotors from its centre, m"""
HEIGHTS = (1.0, 3.0)
"""Range of the heights of starts and goals, m"""
COMMON_HEIGHTS = (1.5, 3.0)
"""Range of the height of a common goal, m"""
MIN_HEIGHT_DIFFERENCE = 0.25
"""Minimum distance of two starts in one cell, m: free of contact"""
MAX_DRAWS = 1000
"""Maximum number of draws of heights"""

TICK_HZ, PHYSICS_HZ = 100, 200
"""Steps and physics substeps per second"""
EPISODE = 15.0
"""Duration of a flight, s"""
GRACE = 1.5
"""Time in which collisions do not count, s"""
REACH_DISTANCES = {"random": 0.5, "common": 1.0}
"""Mean distance to the goal, over `REACH_TICKS`, at which it is reached, m, by rule of the goals"""
REACH_TICKS = 5
"""Number of steps over which the distance is averaged"""
FINAL = 1.0
"""Time at the end over which the distance to the goal is averaged, s"""
SPACING = 20.0
"""Distance between rooms that are flown in one airspace, m"""

DECISION_TICKS = 5
"""Number of steps between two decisions"""
PILOT_SPEED = 1.0
"""Speed limit, m/s: drones stop within the margins"""
DRONE_MARGIN = 0.15
"""Distance between drones in addition to their radii, m: lag and overshoot"""
CYLINDER_MARGIN = 0.08
"""Distance to cylinders in addition to the radii, m"""
WALL_DISTANCE = 0.2
"""Distance to walls and floor, m"""
RULES = AvoidanceParameters(
    separation=2 * DRONE_RADIUS + DRONE_MARGIN,
    horizon=1.0,
    braking_time=0.5,
    recovery_time=0.2,
    max_speed=PILOT_SPEED,
)
"""Parameters of ORCA"""
MAP_CELL = 0.1
"""Size of a cell of the map for paths, m"""
MAP_MARGIN = 0.03
"""Distance of paths to cylinders in addition to the radii, m; aisles are 0.4 m wide"""
CYLINDER_PATH_LIMITS = PathLimits(PILOT_SPEED, acceleration=3.0, delay=0.2, half_width=0.05)
"""Limits along paths"""

GoalRule = Literal["random", "common"]
"""Goals: a random one for each drone, or one for all drones"""
DronePilot = Literal["orca", "paths"]
"""Pilots: policy `orca`; and `orca` along the shortest paths between the cylinders, by A*"""

CylinderDynamics = Literal["rigid_body", "single_integrator"]
"""Dynamics of drones: rigid bodies with lag and downwash, or velocities that are reached without
lag"""


class CylinderRoom(NamedTuple):
    """A room with drones and cylinders.

    Attributes:
        start: (N, 3) starts, m.
        goal: (N, 3) goals, m.
        cylinder: (K, 2) axes of the cylinders, m.
        reach_distance: Distance to a goal at which it is reached, m.
    """

    start: np.ndarray
    goal: np.ndarray
    cylinder: np.ndarray
    reach_distance: float = REACH_DISTANCES["random"]


class CylinderFlights(NamedTuple):
    """Results of W rooms with N drones each.

    Attributes:
        reached: (W, N) bool, which drones were at their goals.
        collided: (W, N) bool, which drones touched a drone or a cylinder after `GRACE`.
        distance: (W, N) mean distance to the goal in the final second, m.
        length: (W, N) length of the flight, m.
    """

    reached: np.ndarray
    collided: np.ndarray
    distance: np.ndarray
    length: np.ndarray

    @property
    def success(self) -> np.ndarray:
        """Fraction of the drones of each room that reach the goal without collision, (W,)."""
        fraction: np.ndarray = (self.reached & ~self.collided).mean(axis=1)
        return fraction


def draw_cylinder_room(
    rng: np.random.Generator, num_drones: int, density: float, goals: GoalRule
) -> CylinderRoom:
    """Draw a room as QuadSwarm does: cylinders, starts and goals in the centres of cells of 1 m.

    A common goal is in the centre of the largest free square, see `find_common_cell`. If there are
    more drones than free cells, cells are used again, at other heights.

    Args:
        rng: Random generator.
        num_drones: Number of drones.
        density: Fraction of cells with a cylinder, at least 0 and below 1.
        goals: Rule of the goals.

    Returns:
        The room.

    Raises:
        ValueError: If the density leaves no free cell.
    """
    if not 0.0 <= density < 1.0:
        raise ValueError(f"density is {density:g}: at least 0, and below 1, is needed")
    axis = np.arange(NUM_CELLS) - (NUM_CELLS - 1) / 2
    cells = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    order = rng.permutation(len(cells))
    count = int(density * len(cells))
    cylinder, free = cells[order[:count]], cells[order[count:]]
    start = _draw_places(rng, free, num_drones)
    if goals == "random":
        return CylinderRoom(start, _draw_places(rng, free, num_drones), cylinder)
    occupied = np.zeros(len(cells), dtype=bool)
    occupied[order[:count]] = True
    row, column = find_common_cell(occupied.reshape(NUM_CELLS, NUM_CELLS).T[::-1])
    goal = np.array([axis[column], -axis[row], rng.uniform(*COMMON_HEIGHTS)])
    goals_of_all = np.tile(goal, (num_drones, 1))
    return CylinderRoom(start, goals_of_all, cylinder, REACH_DISTANCES[goals])


def find_common_cell(occupied: np.ndarray) -> tuple[int, int]:
    """Return the cell of a common goal: the centre of the largest free square of cells.

    Of equally large squares it is the first by row, then column; of even ones, the centre is the
    cell with the larger row and column. As in QuadSwarm's code, cells of the first row and the
    first column count as free if they have a cylinder, and as occupied if not. The centre itself is
    never there.

    Args:
        occupied: (R, C) bool, which cells have a cylinder. Row 0 has the largest y, column 0 the
            smallest x.

    Returns:
        Row and column; (0, 0) if all cells but those of the first row and column are occupied.
    """
    free = ~occupied
    free[0], free[1:, 0] = occupied[0], occupied[1:, 0]
    for size in range(min(free.shape), 0, -1):
        is_square = np.array(sliding_window_view(free, (size, size)).all(axis=(2, 3)))
        if size == 1:
            is_square[0], is_square[:, 0] = False, False
        corners = np.argwhere(is_square)
        if len(corners):
            row, column = corners[0] + size // 2
            return int(row), int(column)
    return 0, 0


def _draw_places(rng: np.random.Generator, free: np.ndarray, num_drones: int) -> np.ndarray:
    """Draw places (N, 3) in free cells, m; each cell is used once before any is used again."""
    rounds = math.ceil(num_drones / len(free))
    chosen = np.concatenate([rng.permutation(len(free)) for _ in range(rounds)])[:num_drones]
    height = rng.uniform(*HEIGHTS, num_drones)
    for k in range(num_drones):
        others = height[:k][chosen[:k] == chosen[k]]
        for _ in range(MAX_DRAWS):
            if (abs(others - height[k]) >= MIN_HEIGHT_DIFFERENCE).all():
                break
            height[k] = rng.uniform(*HEIGHTS)
        else:
            raise ValueError(f"{num_drones} drones do not fit into {len(free)} free cells")
    return np.column_stack([free[chosen], height])


def fly_cylinder_rooms(
    rooms: Sequence[CylinderRoom],
    pilot: DronePilot,
    *,
    duration: float = EPISODE,
    dynamics: CylinderDynamics = "rigid_body",
) -> CylinderFlights:
    """Fly Crazyflies to their goals.

    The rooms are side by side in one airspace. Cylinders have no effect on the dynamics: a drone
    that touches one has collided, and flies on.

    Args:
        rooms: W rooms with the same numbers of drones and of cylinders.
        pilot: Pilot of all drones.
        duration: Duration of the flights, s.
        dynamics: Dynamics of the drones.

    Returns:
        The results.
    """
    start, goal = (np.stack([room[k] for room in rooms]) for k in (0, 1))
    cylinder = np.stack([room.cylinder for room in rooms])
    origin = np.zeros((len(rooms), 1, 3))
    origin[:, 0, 0] = SPACING * np.arange(len(rooms))
    airspace = Airspace(
        (start + origin).reshape(-1, 3),
        "cf2x",
        dynamics=dynamics,
        physics_hz=PHYSICS_HZ,
        decision_hz=TICK_HZ,
        max_speed=PILOT_SPEED,
        rotor_speed="hover" if dynamics == "rigid_body" else 0.0,
    )
    paths = _plan_paths(rooms, start, goal) if pilot == "paths" else None
    ticks = round(duration * TICK_HZ)
    distance = np.empty((ticks, *start.shape[:2]))
    collided = np.zeros(start.shape[:2], dtype=bool)
    length = np.zeros(start.shape[:2])
    position, hit_before = start, collided
    for tick in range(ticks):
        if tick % DECISION_TICKS == 0:
            velocity = airspace.swarm.velocity.reshape(start.shape).copy()
            offset = goal - position
            wanted = preferred_velocity(offset, np.zeros_like(offset), PILOT_SPEED)
            if paths is not None:
                along, paths = paths.follow(position, velocity, CYLINDER_PATH_LIMITS)
                # Straight to the goal on the last leg
                is_last = paths.current >= paths.num_points - 1
                wanted = np.where(is_last[..., None], wanted, along)
            traffic = _find_traffic(position, velocity, cylinder)
            chosen = orca_velocities(traffic, wanted, RULES)
            airspace.command(None, "velocity", chosen.reshape(-1, 3))
        airspace.step()
        moved = airspace.swarm.position.reshape(start.shape) - origin
        length += np.linalg.norm(moved - position, axis=-1)
        position = moved
        distance[tick] = np.linalg.norm(goal - position, axis=-1)
        hit = find_cylinder_collisions(position, cylinder)
        # QuadSwarm counts the beginning of a collision
        if tick + 1 >= GRACE * TICK_HZ:
            collided = collided | (hit & ~hit_before)
        hit_before = hit
    airspace.close()
    window = sliding_window_view(distance, min(REACH_TICKS, ticks), axis=0)
    threshold = np.array([room.reach_distance for room in rooms])[:, None]
    reached = (window.mean(axis=-1) < threshold).any(axis=0)
    final = distance[-round(FINAL * TICK_HZ) :].mean(axis=0)
    return CylinderFlights(reached, collided, final, length)


def find_cylinder_collisions(position: np.ndarray, cylinder: np.ndarray) -> np.ndarray:
    """Return which drones touch another drone or a cylinder.

    Args:
        position: (W, N, 3) positions, m.
        cylinder: (W, K, 2) axes of the cylinders, m.

    Returns:
        (W, N) bool.
    """
    between = position[:, :, None, :2] - cylinder[:, None]
    beside = np.linalg.norm(between, axis=-1) <= CYLINDER_RADIUS + DRONE_RADIUS
    is_near = find_nearest_distances(position) <= 2 * DRONE_RADIUS
    hit: np.ndarray = is_near | beside.any(axis=2)
    return hit


def _find_traffic(position: np.ndarray, velocity: np.ndarray, cylinder: np.ndarray) -> Traffic:
    """Return all drones, cylinders and walls of the room around each drone.

    A cylinder is a sphere at the height of the drone.
    """
    worlds, drones, _ = position.shape
    nothing = np.zeros((worlds, drones, 0, 3))
    sphere = np.zeros((worlds, drones, cylinder.shape[1], 3))
    sphere[..., :2] = cylinder[:, None] - position[:, :, None, :2]
    keep = CYLINDER_RADIUS + DRONE_RADIUS + CYLINDER_MARGIN
    half = ROOM_LENGTH / 2
    low, high = np.array([-half, -half, 0.0]), np.array([half, half, ROOM_LENGTH])
    surface = np.empty((worlds, drones, 6, 4))
    surface[..., :3] = np.concatenate([np.eye(3), -np.eye(3)])
    surface[..., 3] = np.concatenate([position - low, high - position], axis=-1) - WALL_DISTANCE
    return Traffic(
        velocity=velocity,
        goal=nothing,
        goal_velocity=nothing,
        offset=position[:, None] - position[:, :, None],
        other_velocity=np.broadcast_to(velocity[:, None], (worlds, drones, drones, 3)).copy(),
        known=np.broadcast_to(~np.eye(drones, dtype=bool), (worlds, drones, drones)).copy(),
        sphere=sphere,
        sphere_velocity=np.zeros_like(sphere),
        sphere_radius=np.full(sphere.shape[:3], keep),
        surface=surface,
    )


def _plan_paths(rooms: Sequence[CylinderRoom], start: np.ndarray, goal: np.ndarray) -> RoomPaths:
    """Plan paths in the plane, with heights that change evenly along them."""
    found = []
    for room, starts, goals in zip(rooms, start, goal, strict=True):
        grid = _map_room(room.cylinder)
        for one, end in zip(starts, goals, strict=True):
            level = np.array([0.0, 0.0, MAP_CELL / 2])
            path = plan_path(grid, one * (1, 1, 0) + level, end * (1, 1, 0) + level)
            legs = np.linalg.norm(np.diff(path, axis=0), axis=1)
            gone = np.concatenate([[0.0], np.cumsum(legs)])
            path[:, 2] = one[2] + (end[2] - one[2]) * gone / max(gone[-1], MAP_CELL)
            found.append(path)
    return RoomPaths.of(found, len(rooms))


def _map_room(cylinder: np.ndarray) -> Voxels:
    """Return the map of a room: one layer of cells that are free of cylinders and walls."""
    free = round((ROOM_LENGTH - 2 * WALL_DISTANCE) / MAP_CELL)
    origin = np.array([-free * MAP_CELL / 2, -free * MAP_CELL / 2, 0.0]) - MAP_CELL
    occupied = np.ones((free + 2, free + 2, 3), dtype=bool)
    centre = origin[0] + MAP_CELL * (np.arange(free + 2) + 0.5)
    place = np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1)
    apart = np.linalg.norm(place[:, :, None] - cylinder, axis=-1).min(axis=2, initial=np.inf)
    # A path through free cells is half a cell nearer to cylinders than their centres
    blocked = apart < CYLINDER_RADIUS + DRONE_RADIUS + MAP_MARGIN + MAP_CELL / 2
    occupied[1:-1, 1:-1, 1] = blocked[1:-1, 1:-1]
    return Voxels(occupied, origin, MAP_CELL)
