"""Objects of AirSim's scene: vehicles, obstacles, added bodies, ground and buildings.

Obstacles are named "Obstacle0", "Obstacle1", ... in the order of `Airspace`, and bodies that
`add_body` added follow them. Poses of objects are north, east, down of the origin of the airspace.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.airsim_values import attitude_from_airsim, check_number
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.errors import shown
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

MIN_HEIGHT = -100.0
"""Height below which obstacles and bodies are parked, not in the world, m"""
MAX_PATTERN, MAX_WILDCARDS = 100, 3
"""Maximum length of a pattern of names, and maximum number of its `*`, `+` and `?`, so that no
pattern takes long"""
PATTERN = re.compile(r"([\w .*+?^$\-\[\]]|\\[wds])*", re.ASCII)
"""Patterns that clients may send: letters, digits, classes of characters, and wildcards"""
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class SceneObject(NamedTuple):
    """An object of the scene.

    Attributes:
        position: (3,) centre, east, north, up, m.
        quaternion: (4,) attitude, body to world.
        half: (3,) half extents of its box, m; zero for ground and buildings.
        label: Segmentation label.
    """

    position: np.ndarray
    quaternion: Any
    half: np.ndarray
    label: int

    @property
    def corners(self) -> np.ndarray:
        """Corners (8, 3) of the box in the world, m."""
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        corners: np.ndarray = self.position + rotate_vectors(
            np.array(self.quaternion), signs * self.half
        )
        return corners


def list_objects(world: AirsimWorld) -> dict[str, SceneObject]:
    """Return the objects that are in the world by their names."""
    return {name: one for name, one in _all_objects(world) if one.position[2] > MIN_HEIGHT}


def _all_objects(world: AirsimWorld) -> Iterator[tuple[str, SceneObject]]:
    """Yield all objects, also those that are not in the world."""
    airspace = world.airspace
    for i, name in enumerate(world.vehicles):
        half = np.full(3, airspace.airframes[i].collision_radius)
        pose = (airspace.swarm.position[i], airspace.swarm.quaternion[i])
        yield name, SceneObject(*pose, half, DRONE)
    contents, state = airspace.scene_contents, airspace.world.state
    for k, obstacle in enumerate(contents.obstacles):
        pose = (state.obstacle[0, k], state.obstacle_turn[0, k])
        half = np.array(obstacle.shape.half)
        yield f"Obstacle{k}", SceneObject(*pose, half, OBSTACLE)
    bodies = airspace.world.engine.scenery.bodies
    for b, reach in enumerate(bodies.reach.tolist()):
        pose = (bodies.position[0, b], bodies.quaternion[0, b])
        name = f"Obstacle{len(contents.obstacles) + b}"
        yield name, SceneObject(*pose, np.full(3, reach), OBSTACLE)
    yield "Ground", SceneObject(np.zeros(3), UPRIGHT, np.zeros(3), LAND)
    if contents.layouts:
        yield "Building", SceneObject(np.zeros(3), UPRIGHT, np.zeros(3), BUILDING)


def match_names(names: Iterable[str], pattern: str, flags: int = 0) -> list[str]:
    """Return the names that match a regular expression as a whole, as in AirSim.

    Args:
        names: The names.
        pattern: Regular expression.
        flags: Flags of `re`.

    Raises:
        ValueError: If the pattern is not one of those that clients may send.
    """
    wildcards = sum(pattern.count(sign) for sign in "*+?")
    if len(pattern) <= MAX_PATTERN and PATTERN.fullmatch(pattern) and wildcards <= MAX_WILDCARDS:
        try:
            compiled = re.compile(pattern, flags)
        except re.error:
            pass
        else:
            return [name for name in names if compiled.fullmatch(name)]
    raise ValueError(
        f"name_regex is {shown(pattern)}: at most {MAX_PATTERN} letters, digits, classes in "
        f"brackets and {MAX_WILDCARDS} of *, + and ? are possible"
    )


def match_wildcards(name: str, patterns: Iterable[str]) -> bool:
    """Return True if a name matches one of several patterns with `*` and `?`."""
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def move_object(world: AirsimWorld, name: str, position: np.ndarray, attitude: np.ndarray) -> bool:
    """Set the pose of an object, which then stands still.

    Args:
        world: The vehicles.
        name: Name of the object.
        position: (3,) position, north, east, down of the origin, m; NaN leaves it unchanged.
        attitude: (4,) quaternion x, y, z, w (FRD to NED); NaN leaves it unchanged.

    Returns:
        Whether there is such an object, and it can be moved.

    Raises:
        ValueError: If the object would overlap a drone, or a vehicle another object.
    """
    found = list_objects(world).get(name)
    if found is None or found.label not in (DRONE, OBSTACLE):
        return False
    if name in world.vehicles:
        i, vehicle = world.vehicle(name)
        east, north, up = vehicle.start.tolist()
        world.place(i, position - np.array((north, east, -up)), attitude)
        return True
    north, east, down = position.tolist()
    target = np.array((east, north, -down))
    target = np.where(np.isfinite(target), target, found.position)
    turn = found.quaternion
    if np.isfinite(attitude).all():
        turn = attitude_from_airsim(attitude)
    k, count = int(name.removeprefix("Obstacle")), len(world.airspace.scene_contents.obstacles)
    if k < count:
        world.airspace.place_obstacle(k, target.tolist(), turn.tolist())
    else:
        world.airspace.move_body(FIRST_OBSTACLE - k, target.tolist(), turn.tolist())
    return True


def is_visible(world: AirsimWorld, start: Any, end: Any, viewer: int | None = None) -> bool:
    """Return True if nothing is between two points.

    Args:
        world: The vehicles.
        start: (3,) east, north, up, m.
        end: (3,) east, north, up, m.
        viewer: Index of a vehicle that does not hide the end; None if all vehicles do.
    """
    airspace = world.airspace
    others = airspace.world.state.alive.copy()
    if viewer is not None:
        others[0, viewer] = False
    starts, ends = (np.array([point], dtype=float) for point in (start, end))
    drones = (airspace.world.state.swarm, others)
    (fraction,) = airspace.world.engine.cast_rays(starts, ends, np.zeros(1, dtype=int), drones)
    return bool(fraction >= 1.0)


def compute_extents(world: AirsimWorld) -> tuple[np.ndarray, np.ndarray]:
    """Return the low and the high corner (3,) of a box around all objects, m."""
    points = [one.corners for one in list_objects(world).values()]
    points += [one.bounds.reshape(-1, 3) for one in world.airspace.scene_contents.layouts]
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)


def read_geo_point(world: AirsimWorld, value: Any) -> np.ndarray:
    """Convert a GeoPoint of a call to east, north, up of the origin, (3,), m.

    Raises:
        ValueError: If the value is not a map of latitude, longitude and altitude.
    """
    names = ("latitude", "longitude", "altitude")
    if not isinstance(value, Mapping):
        raise ValueError(f"point is {shown(value)}: a map of {', '.join(names)} is needed")
    bounds = zip(names, (90.0, 180.0, 1e6), strict=True)
    return world.origin.to_local(
        [check_number(name, value.get(name), bound) for name, bound in bounds]
    )
