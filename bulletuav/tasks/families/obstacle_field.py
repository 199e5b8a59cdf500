"""Obstacles that stand or move among the drones of any flight."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import dot, minus, point
from bulletuav.tasks.base import Rngs, Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.families.headings import check_heading, facing, headed
from bulletuav.tasks.frame import Scene, Spawn, TaskContext
from bulletuav.tasks.given import Given

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
"""Its multiples modulo 1 spread sizes evenly over any number of obstacles"""
MAX_TRIES = 1000
"""How often an obstacle is drawn anew until it keeps clear of starts, goals and buildings"""


@dataclass(frozen=True)
class ObstacleConfig(TaskConfig):
    """Options of obstacles and headings, beside those of every task.

    Attributes:
        heading: Direction of flight at the start, and of the noses: "goal", "random" (in space),
            an angle from east to north, or one for each drone, degrees. When left out, drones that
            start in flight fly towards their goals, and noses point east.
        num_obstacles: Number of obstacles; every second one is a cube, the others are spheres.
        num_moving: Number of them that move, reflected at the bounds of their space.
        obstacle_radius: Least and greatest radius of the obstacles' bounding spheres, m. Sizes
            spread between them.
        obstacle_speed: Greatest speed of an obstacle on each axis, m/s.
    """

    heading: Any = None
    num_obstacles: int = field(default=0, metadata={"least": 0, "most": 10_000})
    num_moving: int = field(default=0, metadata={"least": 0})
    obstacle_radius: tuple[float, float] = (3.0, 10.0)
    obstacle_speed: float = field(default=5.0, metadata={"most": 100.0})


ObstacleConfigT = TypeVar("ObstacleConfigT", bound=ObstacleConfig)


class ObstacleTask(Task[ObstacleConfigT], Generic[ObstacleConfigT]):
    """Base of tasks with obstacles among the drones, which stand or move.

    Attributes:
        obstacle_radius: (K,) radius of the obstacles' bounding spheres, m.
        keep_off: (K,) how far from their middles starts and goals are, m.
    """

    def __init__(self, config: ObstacleConfigT, context: TaskContext) -> None:
        """Make the obstacles.

        Raises:
            ValueError: Their sizes or numbers cannot be, or the heading.
        """
        super().__init__(config, context)
        check_heading(config.heading, context.num_drones, self.has_goals)
        smallest, largest = config.obstacle_radius
        if not 0 < smallest <= largest:
            raise ValueError(
                f"obstacle_radius is {config.obstacle_radius}: from low to high, above 0, is needed"
            )
        if config.num_moving > config.num_obstacles:
            raise ValueError(
                f"num_moving {config.num_moving} of {config.num_obstacles} obstacles: "
                f"at most all can move"
            )
        # Obstacles of all sizes, and how far off starts and goals are.
        index = np.arange(config.num_obstacles)
        sizes = smallest + (largest - smallest) * (index * GOLDEN_RATIO % 1)
        self._bodies = tuple(_body(k, radius) for k, radius in enumerate(sizes.tolist()))
        self.obstacle_radius = np.array([body.radius for body in self._bodies])
        self.keep_off = self.obstacle_radius + max(2 * context.collision_radius, config.d_safe)

    def obstacles(self) -> Sequence[Obstacle]:
        """List the obstacles, those that move first."""
        return self._bodies

    def obstacle_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Tell the box in which the obstacles' middles are, (3,) each, m; by default the arena."""
        reach = self.obstacle_radius.max(initial=0.0)
        return self.arena_low + reach, self.arena_high - reach

    def finish(
        self,
        spawn: Spawn,
        given: Given,
        rng: np.random.Generator,
    ) -> Spawn:
        """Put given places into a start, turn drones, and draw obstacles clear of all places.

        Raises:
            ValueError: There is no room for them.
        """
        spawn = super().finish(spawn, given, rng)
        spawn = self._turned(spawn, not given.is_empty, rng)
        if not self._bodies:
            return spawn
        low, high = self.obstacle_bounds()
        if (low > high).any():
            raise ValueError(
                f"obstacle_radius is {self.config.obstacle_radius}: the arena has no room for "
                f"obstacles of {self.obstacle_radius.max():.3g} m; lower it"
            )
        # Those that the task has drawn stay, unless they are in the way.
        shape = (len(self._bodies), 3)
        was_drawn = len(spawn.obstacle) > 0
        drawn = spawn.obstacle if was_drawn else rng.uniform(low, high, shape)
        obstacle = np.array(drawn, dtype=float)
        velocity = spawn.obstacle_velocity
        if not was_drawn:
            fastest = self.config.obstacle_speed
            velocity = rng.uniform(-fastest, fastest, shape)
            velocity[self.config.num_moving :] = 0.0
        # In the way is who is too near to a start, a goal or a building
        goal = np.broadcast_to(spawn.goal, spawn.position.shape)
        places = np.concatenate([spawn.position, goal], dtype=float)
        tries = np.zeros(len(obstacle), dtype=int)
        k = 0
        while (k := self._first_in_the_way(obstacle, k, places, spawn.layout)) < len(obstacle):
            # Drawn anew, one by one; those before it stay
            obstacle[k] = rng.uniform(low, high)
            tries[k] += 1
            if tries[k] == MAX_TRIES:
                raise ValueError(
                    f"num_obstacles is {self.config.num_obstacles}: no place is left for "
                    f"obstacle {k} clear of starts, goals and buildings; lower it, or "
                    f"obstacle_radius"
                )
        return spawn._replace(obstacle=obstacle, obstacle_velocity=velocity)

    def _turned(
        self,
        spawn: Spawn,
        is_given: bool,
        rng: np.random.Generator,
    ) -> Spawn:
        """Turn velocities and noses as `heading` says.

        Where it says nothing and places are given, drones fly towards their goals.
        """
        heading = self.config.heading
        if heading is None and not (is_given and "goal" in self.places):
            return spawn
        place = spawn.position
        direction = headed(heading or "goal", np.broadcast_to(spawn.goal, place.shape) - place, rng)
        velocity = np.broadcast_to(spawn.velocity, place.shape)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        quaternion = spawn.quaternion if heading is None else facing(direction)
        return spawn._replace(velocity=direction * speed, quaternion=quaternion)

    def _first_in_the_way(
        self,
        obstacle: np.ndarray,
        first: int,
        places: np.ndarray,
        layout: int,
    ) -> int:
        """Find the first of the obstacles (K, 3) m, from `first` on, that has to be elsewhere.

        It is too near to places (M, 3) or in what stands; K where none is.
        """
        near: int = first_near(obstacle, first, self.keep_off, places)
        for k in range(first, near):
            if not self.is_free(obstacle[k], float(self.obstacle_radius[k]), layout):
                return k
        return near

    def move_scene(
        self,
        scene: Scene,
        time: np.ndarray,
        flying: np.ndarray,
        rngs: Rngs,
    ) -> bool:
        """Move obstacles straight on, reflected at the bounds; where buildings are, turned back.

        Returns:
            Whether any obstacle can have moved.
        """
        super().move_scene(scene, time, flying, rngs)
        moving = self.config.num_moving
        if not moving:
            return False
        low, high = self.obstacle_bounds()
        before = scene.obstacle[flying, :moving]
        place = before + self.context.period * scene.obstacle_velocity[flying, :moving]
        # How far each is beyond a bound, on each axis: it comes back as far, and turns round.
        beyond = np.maximum(place - high, 0) + np.minimum(place - low, 0)
        place = place - 2 * beyond
        turned = np.where(beyond == 0, 1.0, -1.0)
        self._turn_back(before, place, turned, scene.layout[flying])
        scene.obstacle[flying, :moving] = place
        scene.obstacle_velocity[flying, :moving] *= turned
        return True

    def _turn_back(
        self,
        before: np.ndarray,
        place: np.ndarray,
        turned: np.ndarray,
        layout: np.ndarray,
    ) -> None:
        """Let obstacles that would enter a building stay where they were, and turn round."""
        if not self.layouts():
            return
        for w, k in np.ndindex(place.shape[:2]):
            if not self.is_free(place[w, k], float(self.obstacle_radius[k]), int(layout[w])):
                place[w, k] = before[w, k]
                turned[w, k] = -1.0


@kernel
def first_near(
    obstacle: np.ndarray,
    first: int,
    keep_off: np.ndarray,
    places: np.ndarray,
) -> int:
    """Find the first of the obstacles (K, 3), from `first` on, that does not keep off places.

    Args:
        obstacle: (K, 3) their middles, m.
        first: Index of the first that is looked at.
        keep_off: (K,) distances that they have to exceed, m.
        places: (M, 3) m.

    Returns:
        Its index; K where none is.
    """
    for k in range(first, obstacle.shape[0]):
        for m in range(places.shape[0]):
            away = minus(point(places, m), point(obstacle, k))
            if not math.sqrt(dot(away, away)) > keep_off[k]:
                return k
    return int(obstacle.shape[0])


def _body(index: int, radius: float) -> Obstacle:
    """Make a sphere, or for odd indices a cube, of that bounding radius, m."""
    if index % 2:
        side = 2 * radius / np.sqrt(3)
        return Obstacle("box", (side, side, side))
    return Obstacle("sphere", (radius,))
