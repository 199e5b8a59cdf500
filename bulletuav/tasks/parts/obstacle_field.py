"""Static and moving obstacles, and directions in which drones start."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.errors import as_int, as_sequence, finite, shown
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import dot, minus, point
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Scene, Spawn
from bulletuav.tasks.parts.base import Part, Rngs
from bulletuav.tasks.parts.headings import check_heading, heading_directions, level_attitudes

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
"""Multiples modulo 1 spread sizes evenly over any number of obstacles"""
MAX_SPEED = 100.0
"""Maximum speed of obstacles on each axis, m/s"""
MAX_TRIES = 1000
"""Maximum number of draws of an obstacle until it is clear of starts, goals and buildings"""


@dataclass(frozen=True)
class ObstacleOptions:
    """Options of obstacles and headings.

    Attributes:
        heading: Direction of flight and of the nose at the start: "goal", "random" (in space), an
            angle from east to north, or one angle for each drone, degrees. By default drones that
            start in flight fly towards their goals, and noses point east.
        num_obstacles: Number of obstacles; every second one is a cube, the others are spheres.
        num_moving: Number of moving obstacles, or the minimum and maximum of the number that is
            drawn in each episode. They are reflected at the bounds of their space.
        obstacle_radius: Radius of the obstacles' bounding spheres, or its minimum and maximum, m.
            Sizes are evenly spread in between.
        obstacle_speed: Maximum speed of an obstacle on each axis, or the minimum and maximum of its
            velocity on each axis, m/s. Velocities are drawn in each episode.
    """

    heading: Any = None
    num_obstacles: int = field(default=0, metadata={"least": 0, "most": 10_000})
    num_moving: int | tuple[int, int] = 0
    obstacle_radius: float | tuple[float, float] = (3.0, 10.0)
    obstacle_speed: float | tuple[float, float] = 5.0


@dataclass(frozen=True)
class CityObstacleOptions:
    """Options of obstacles (`ObstacleOptions`) with other defaults in cities.

    Attributes:
        obstacle_radius: Radius of the obstacles' bounding spheres, or its minimum and maximum, m:
            they have to fit into streets.
        obstacle_speed: Maximum speed of an obstacle on each axis, or the minimum and maximum of its
            velocity on each axis, m/s.
    """

    obstacle_radius: float | tuple[float, float] = (0.5, 2.0)
    obstacle_speed: float | tuple[float, float] = 2.0


class ObstacleField(Part):
    """Static and moving obstacles, and the option `heading`.

    Attributes:
        radius: (K,) radii of the obstacles' bounding spheres, m.
        min_distance: (K,) minimum distances of their centres from starts and goals, m.
        bounds: Corners (3,) of the box of their centres, m; None for the task's arena.
        velocity_range: Minimum and maximum velocity of moving obstacles on each axis, m/s.
    """

    def __init__(self, task: Task[Any]) -> None:
        """Create the obstacles of a task.

        Args:
            task: The task, with options of obstacles; its arena and layouts may be set later.

        Raises:
            ValueError: If sizes, numbers or the heading are invalid.
        """
        config: ObstacleOptions = task.config
        self._config, self._task, context = config, task, task.context
        self.bounds: tuple[np.ndarray, np.ndarray] | None = None
        check_heading(config.heading, context.num_drones, task.has_goals)
        smallest, largest = as_range("obstacle_radius", config.obstacle_radius)
        if not 0 < smallest <= largest:
            raise ValueError(
                f"obstacle_radius is {config.obstacle_radius}: from low to high, above 0, is needed"
            )
        self.velocity_range = _velocity_range(config.obstacle_speed)
        fewest, self._max_moving = self._num_moving = _moving_range(config.num_moving)
        if not fewest <= self._max_moving <= config.num_obstacles:
            raise ValueError(
                f"num_moving {shown(config.num_moving)} of {config.num_obstacles} obstacles: "
                f"from low to high is needed, and at most all can move"
            )
        index = np.arange(config.num_obstacles)
        sizes = smallest + (largest - smallest) * (index * GOLDEN_RATIO % 1)
        self._bodies = tuple(_body(k, radius) for k, radius in enumerate(sizes.tolist()))
        self.radius = np.array([body.radius for body in self._bodies])
        self.min_distance = self.radius + max(2 * context.collision_radius, task.config.d_safe)

    def draw_num_moving(self, rng: np.random.Generator) -> int:
        """Draw the number of moving obstacles of an episode."""
        fewest, most = self._num_moving
        return fewest if fewest == most else int(rng.integers(fewest, most, endpoint=True))

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the obstacles, moving ones first."""
        return self._bodies

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners (3,) of the box of the obstacles' centres, m."""
        if self.bounds is not None:
            return self.bounds
        margin = self.radius.max(initial=0.0)
        return self._task.arena_low + margin, self._task.arena_high - margin

    def finish(self, spawn: Spawn, is_given: bool, rng: np.random.Generator) -> Spawn:
        """Apply `heading` to the drones, and draw obstacles clear of all starts and goals.

        Raises:
            ValueError: If obstacles do not fit.
        """
        spawn = self._apply_heading(spawn, is_given, rng)
        if not self._bodies:
            return spawn
        low, high = self.box()
        if (low > high).any():
            raise ValueError(
                f"obstacle_radius is {self._config.obstacle_radius}: the arena has no room for "
                f"obstacles of {self.radius.max():.3g} m; lower it"
            )
        # Obstacles drawn by the task are kept unless they are blocked
        shape = (len(self._bodies), 3)
        was_drawn = len(spawn.obstacle) > 0
        drawn = spawn.obstacle if was_drawn else rng.uniform(low, high, shape)
        obstacle = np.array(drawn, dtype=float)
        velocity = spawn.obstacle_velocity
        if not was_drawn:
            velocity = rng.uniform(*self.velocity_range, shape)
            velocity[self.draw_num_moving(rng) :] = 0.0
        goal = np.broadcast_to(spawn.goal, spawn.position.shape)
        places = np.concatenate([spawn.position, goal], dtype=float)
        tries = np.zeros(len(obstacle), dtype=int)
        k = 0
        while (k := self._find_first_blocked(obstacle, k, places, spawn.layout)) < len(obstacle):
            obstacle[k] = rng.uniform(low, high)
            tries[k] += 1
            if tries[k] == MAX_TRIES:
                raise ValueError(
                    f"num_obstacles is {self._config.num_obstacles}: no place is left for "
                    f"obstacle {k} clear of starts, goals and buildings; lower it, or "
                    f"obstacle_radius"
                )
        return spawn._replace(obstacle=obstacle, obstacle_velocity=velocity)

    def _apply_heading(self, spawn: Spawn, is_given: bool, rng: np.random.Generator) -> Spawn:
        """Rotate velocities and attitudes to the option `heading`.

        Without the option, drones with given positions fly towards their goals.
        """
        heading = self._config.heading
        if heading is None and not (is_given and "goal" in self._task.places):
            return spawn
        place = spawn.position
        direction = heading_directions(
            heading or "goal", np.broadcast_to(spawn.goal, place.shape) - place, rng
        )
        velocity = np.broadcast_to(spawn.velocity, place.shape)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        quaternion = spawn.quaternion if heading is None else level_attitudes(direction)
        return spawn._replace(velocity=direction * speed, quaternion=quaternion)

    def _find_first_blocked(
        self, obstacle: np.ndarray, first: int, places: np.ndarray, layout: int
    ) -> int:
        """Return the index of the first blocked obstacle, from `first` on; K if there is none.

        An obstacle (K, 3), m, is blocked if it is too close to positions (M, 3) or in a building.
        """
        near: int = find_first_near(obstacle, first, self.min_distance, places)
        for k in range(first, near):
            if not self._task.is_free(obstacle[k], float(self.radius[k]), layout):
                return k
        return near

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move obstacles straight, reflected at bounds and reversed at buildings.

        Returns:
            Whether any obstacle may have moved.
        """
        moving = self._max_moving
        if not moving:
            return False
        low, high = self.box()
        before = scene.obstacle[flying, :moving]
        velocity = scene.obstacle_velocity[flying, :moving]
        place = before + self._task.context.period * velocity
        # Reflect the distance beyond a bound, on each axis
        beyond = np.maximum(place - high, 0) + np.minimum(place - low, 0)
        place = place - 2 * beyond
        turned = np.where(beyond == 0, 1.0, -1.0)
        self._reverse_at_buildings(before, place, turned, scene.layout[flying])
        scene.obstacle[flying, :moving] = place
        scene.obstacle_velocity[flying, :moving] *= turned
        return True

    def _reverse_at_buildings(
        self, before: np.ndarray, place: np.ndarray, turned: np.ndarray, layout: np.ndarray
    ) -> None:
        """Keep obstacles that would enter a building in place, and reverse their velocity."""
        if not self._task.layouts():
            return
        for w, k in np.ndindex(place.shape[:2]):
            if not self._task.is_free(place[w, k], float(self.radius[k]), int(layout[w])):
                place[w, k] = before[w, k]
                turned[w, k] = -1.0


@kernel
def find_first_near(
    obstacle: np.ndarray, first: int, min_distance: np.ndarray, places: np.ndarray
) -> int:
    """Return the index of the first obstacle, from `first` on, that is too close to a position.

    Args:
        obstacle: (K, 3) centres of the obstacles, m.
        first: Index of the first obstacle to check.
        min_distance: (K,) distances that they have to exceed, m.
        places: (M, 3) positions, m.

    Returns:
        Index of the obstacle; K if there is none.
    """
    for k in range(first, obstacle.shape[0]):
        for m in range(places.shape[0]):
            away = minus(point(places, m), point(obstacle, k))
            if not math.sqrt(dot(away, away)) > min_distance[k]:
                return k
    return int(obstacle.shape[0])


def find_obstacle_box(task: Task[Any]) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the corners (3,) of the box of a task's obstacles, m; None without an `ObstacleField`.

    Args:
        task: Any task.
    """
    return next((part.box() for part in task.parts if isinstance(part, ObstacleField)), None)


def as_range(name: str, value: Any) -> tuple[float, float]:
    """Return the range of an option: the given pair of numbers, or one number twice.

    Args:
        name: Name of the option.
        value: A number, or minimum and maximum.

    Raises:
        ValueError: If the value is of another type.
    """
    pair = as_sequence(name, value, 2) if isinstance(value, list | tuple | np.ndarray) else ()
    low, high = (finite(name, one) for one in pair or (value, value))
    return low, high


def _velocity_range(obstacle_speed: Any) -> tuple[float, float]:
    """Return the range of the option `obstacle_speed`; a single number is its maximum."""
    low, high = as_range("obstacle_speed", obstacle_speed)
    if not isinstance(obstacle_speed, list | tuple | np.ndarray):
        if high < 0:
            raise ValueError(f"obstacle_speed is {high:g}: it must not be negative")
        low = -high
    if low > high:
        raise ValueError(f"obstacle_speed is {obstacle_speed}: from low to high is needed")
    finite("obstacle_speed", low, -MAX_SPEED)
    finite("obstacle_speed", high, most=MAX_SPEED)
    return low, high


def _moving_range(num_moving: Any) -> tuple[int, int]:
    """Return the range of the option `num_moving`."""
    if isinstance(num_moving, list | tuple | np.ndarray):
        fewest, most = as_sequence("num_moving", num_moving, 2)
    else:
        fewest = most = num_moving
    return as_int("num_moving", fewest, 0), as_int("num_moving", most, 0)


def _body(index: int, radius: float) -> Obstacle:
    """Return a sphere, or a cube for odd indices, with the given bounding radius, m."""
    if index % 2:
        side = 2 * radius / np.sqrt(3)
        return Obstacle("box", (side, side, side))
    return Obstacle("sphere", (radius,))
