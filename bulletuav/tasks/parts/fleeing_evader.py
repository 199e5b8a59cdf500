"""Scripted evader, which flees from the nearest drone along a path above the terrain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from bulletuav.city.heightfield import Heightfield
from bulletuav.city.model import City
from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Scene
from bulletuav.tasks.parts.base import Part, Rngs
from bulletuav.tasks.parts.city_layouts import CityLayouts

BODY = Obstacle("sphere", (0.3,), (0.75, 0.2, 0.15, 1.0))
"""Body of the evader"""
CELL = 1.0
"""Side of the cells of the raster of the evader's lowest heights, m"""
MAX_SLOPE = 0.5
"""Maximum slope of the evader's path; it climbs before a steeper obstacle"""
EDGE = 15.0
"""Distance from the edge of the arena at which the evader is deflected as much as it flees, m"""
MIN_EDGE = 5.0
"""Minimum distance of the evader from the edge, m"""
WEAVE_TIME = 2.0
"""Correlation time of the evader's deviations from straight flight, s"""


@dataclass(frozen=True)
class EvaderOptions:
    """Options of the evader.

    Attributes:
        evader_speed: Horizontal speed of the evader, m/s; below max_speed.
        evader_weave: Standard deviation of the evader's course from straight flight away, rad. The
            deviation changes at random within about 2 s.
        evader_acceleration: Maximum lateral acceleration of the evader, m/s^2.
        evader_height: Minimum and maximum height of the evader's path above terrain and treetops,
            m, drawn for each episode. It is higher before slopes and trees that are steep.
    """

    evader_speed: float = 3.0
    evader_weave: float = 0.3
    evader_acceleration: float = 3.0
    evader_height: tuple[float, float] = (4.0, 8.0)


class FleeingEvader(Part):
    """A body that flees from the nearest drone, at constant horizontal speed above the terrain.

    Its course is straight away from the nearest drone that flies, deflected at the edge of the
    arena by the inverse square of the distance, plus a random deviation (an Ornstein-Uhlenbeck
    process). It turns to this course with limited lateral acceleration. Its height follows the
    terrain. It is the goal of all drones, and their only target.

    The memory of each world is "threat" (3,), position of the nearest drone, m; "course" (), course
    of the evader, rad; "weave" (), deviation of the course, rad; and "evader_height" (), m.
    """

    def __init__(self, task: Task[Any], city_layouts: CityLayouts) -> None:
        """Check the options, and compute the evader's lowest heights.

        Args:
            task: The task, with options of the evader; its targets are set.
            city_layouts: Its terrain.

        Raises:
            ValueError: If the evader is not slower than the drones, or could touch the terrain.
        """
        config, context = task.config, task.context
        if not 0 < config.evader_speed < context.max_speed:
            raise ValueError(
                f"evader_speed is {config.evader_speed:g} m/s: a speed above 0 and below max_speed "
                f"{context.max_speed:g} m/s is needed"
            )
        if config.evader_acceleration == 0:
            raise ValueError("evader_acceleration is 0 m/s^2: it must be above 0, for turns")
        low, high = config.evader_height
        lowest = 2 * BODY.radius + MAX_SLOPE * CELL
        if not lowest <= low <= high:
            raise ValueError(
                f"evader_height is {config.evader_height}: from low to high, at least {lowest:g} m "
                f"above terrain and trees, is needed"
            )
        self._config, self._period = config, context.period
        self._surfaces = [find_path_heights(city) for city in city_layouts.cities]
        task.num_targets, task.target_radius = 1, BODY.radius
        top = max(float(surface.corners.max()) for surface in self._surfaces)
        self.highest = top + high + BODY.radius

    def obstacles(self) -> Sequence[Obstacle]:
        """Return the evader's body."""
        return (BODY,)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the arrays; see the class."""
        return {"threat": (3,), "course": (), "weave": (), "evader_height": ()}

    def draw_height(self, rng: np.random.Generator) -> float:
        """Draw the height of the path above its lowest heights, m."""
        return float(rng.uniform(*self._config.evader_height))

    def place(self, layout: np.ndarray, plan: np.ndarray, height: np.ndarray) -> np.ndarray:
        """Return positions (W, 3) of evaders, m.

        Args:
            layout: (W,) index of each world's city.
            plan: (W, 2) x and y, m.
            height: (W,) heights above the lowest heights of paths, m.
        """
        lowest = np.empty(len(plan))
        for k in np.unique(layout).tolist():
            lowest[layout == k] = self._surfaces[k].height(plan[layout == k])
        return np.column_stack([plan, lowest + height])

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move the evaders of flying worlds, and the goals with them; see `Part.move_scene`."""
        w = np.flatnonzero(flying)
        if not len(w):
            return False
        config, dt, memory = self._config, self._period, scene.memory
        normal = np.array([rngs[k].standard_normal() for k in w.tolist()])
        kept = dt / WEAVE_TIME
        memory["weave"][w] *= 1 - kept
        memory["weave"][w] += config.evader_weave * np.sqrt(2 * kept) * normal
        before, layout = scene.obstacle[w, 0], scene.layout[w]
        sides = np.array([self._surfaces[k].sides for k in layout.tolist()])
        away = before[:, :2] - memory["threat"][w, :2]
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        for sign in (-1.0, 1.0):
            left = np.maximum(sides / 2 - sign * before[:, :2], MIN_EDGE)
            away -= sign * (EDGE / left) ** 2
        wanted = atan2(away[:, 1], away[:, 0]) + memory["weave"][w]
        course = memory["course"][w]
        turn = wanted - course
        turn = atan2(sin(turn), cos(turn))
        most = config.evader_acceleration * dt / config.evader_speed
        course = course + np.clip(turn, -most, most)
        memory["course"][w] = atan2(sin(course), cos(course))
        step = dt * config.evader_speed * np.stack([cos(course), sin(course)], axis=1)
        most_plan = sides / 2 - MIN_EDGE
        plan = np.clip(before[:, :2] + step, -most_plan, most_plan)
        after = self.place(layout, plan, memory["evader_height"][w])
        velocity = (after - before) / dt
        scene.obstacle[w, 0], scene.obstacle_velocity[w, 0] = after, velocity
        scene.goal[w], scene.goal_velocity[w] = after[:, None], velocity[:, None]
        return True

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Find the nearest drone of each world that flies."""
        distance = np.where(frame.alive, frame.distance, np.inf)
        nearest = distance.argmin(axis=1)
        w = np.flatnonzero(frame.alive.any(axis=1))
        frame.scene.memory["threat"][w] = frame.after.position[w, nearest[w]]


@lru_cache(32)
def find_path_heights(city: City) -> Heightfield:
    """Return the lowest heights of a path that touches neither terrain nor trees.

    They are at least the heights of all roofs, treetops and of the ground at the corners of a
    raster, with the least slopes up to MAX_SLOPE: the maximum of cones around these points, along
    the eight directions of the raster.

    Args:
        city: The terrain or city.
    """
    counts = np.ceil(city.sides / CELL).astype(int) + 1
    x, y = (
        np.linspace(-side / 2, side / 2, count)
        for side, count in zip(city.sides, counts.tolist(), strict=True)
    )
    place = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    height = city.roof(place)
    steps = [(1, 0), (0, 1), (1, 1), (1, -1)]
    while True:
        padded = np.pad(height, 1, constant_values=-np.inf)
        raised = height
        for i, j in steps:
            drop = MAX_SLOPE * CELL * np.sqrt(i * i + j * j)
            for sign in (-1, 1):
                rows = slice(1 + sign * i, 1 + sign * i + height.shape[0])
                columns = slice(1 + sign * j, 1 + sign * j + height.shape[1])
                raised = np.maximum(raised, padded[rows, columns] - drop)
        if (raised <= height).all():
            height.setflags(write=False)
            return Heightfield(height, city.sides)
        height = raised
