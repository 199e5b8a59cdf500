"""Task `obstacles`: free flight among spheres and boxes, some of which move."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.registry import register
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.families.airspace import (
    REWARD_WEIGHTS,
    UNCERTAINTY,
    Airspace,
    AirspaceConfig,
    clearance,
)
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward

GOLDEN = (np.sqrt(5) - 1) / 2  # spreads sizes evenly over any number of obstacles
FULL = 0.3  # share of the space that drones and obstacles may keep others out of


@dataclass(frozen=True)
class ObstaclesConfig(AirspaceConfig):
    """Options of `obstacles` beside those of every shared airspace, m, m/s.

    Starts, goals and obstacles lie in a square of side `area`, within `altitude_spread` / 2 of `altitude`. Starts, and
    goals, keep 2 d_safe from each other, both d_safe from obstacles; a goal is `leg` or farther from its start. Of the
    `num_obstacles`, `num_moving` move at up to `obstacle_speed` on each axis, reflected at the bounds; their sizes (radius
    of the bounding sphere) spread over `obstacle_radius`, every second is a cube.
    """

    area: float = 200.0
    altitude_spread: float = 40.0
    leg: float = 80.0
    num_obstacles: int = field(default=10, metadata={"most": 10_000})
    num_moving: int = field(default=5, metadata={"least": 0})
    obstacle_radius: tuple[float, float] = (3.0, 10.0)
    obstacle_speed: float = field(default=5.0, metadata={"most": 100.0})
    jitter: float = 0.0
    start_speed: tuple[float, float] = (0.0, 5.0)  # slow enough to stop before an obstacle


@reward
def obstacle_warning(obstacle_nearness: float) -> float:
    """Summed over obstacles: from 0 at d_safe from bounding spheres, linear, to 1 at contact."""
    return obstacle_nearness


@register("task")
class Obstacles(Airspace[ObstaclesConfig]):
    """From anywhere to anywhere among bodies that can be hit, some of which move.

    Observation, per drone, Box(55) with the defaults; `bulletuav tasks obstacles` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`.
    Beside that: obstacle_warning -5 for each obstacle, linear from 0 at d_safe from its bounding sphere to 1 at contact
    with it. Obstacles observed are the nearest by distance to their bounding spheres.

    Difficulty, drones / obstacles / of these moving / area: easy 4, 10, 0, 200 m; medium 8, 10, 5, 200 m;
    hard 20, 15, 10, 200 m; extreme 100, 20, 15, 300 m.
    """

    name = "obstacles"
    observation = ("position", "velocity", "goal", "neighbours", "obstacles")
    reward: ClassVar = {**REWARD_WEIGHTS, "obstacle_warning": (obstacle_warning, -5.0)}
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, "num_moving": 0, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {"num_drones": 20, "num_obstacles": 15, "num_moving": 10, **UNCERTAINTY["hard"]},
        "extreme": {
            "num_drones": 100,
            "area": 300.0,
            "num_obstacles": 20,
            "num_moving": 15,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: ObstaclesConfig, context: TaskContext):
        """Raises ValueError where there is no room for all, or starts could touch the ground."""
        super().__init__(config, context)
        low, high = config.obstacle_radius
        if not 0 < low <= high:
            raise ValueError(
                f"obstacle_radius is {config.obstacle_radius}: from low to high, above 0, is needed"
            )
        if config.num_moving > config.num_obstacles:
            raise ValueError(
                f"num_moving {config.num_moving} of {config.num_obstacles} obstacles: at most all can move"
            )
        side, rise = config.area / 2, config.altitude_spread / 2
        self._low = np.array([-side, -side, config.altitude - rise])
        self._high = np.array([side, side, config.altitude + rise])
        if self._low[2] - config.jitter <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low for altitude_spread {config.altitude_spread:g} m"
            )
        index = np.arange(config.num_obstacles)
        self._radius = low + (high - low) * (index * GOLDEN % 1)
        self._bodies = tuple(_body(k, radius) for k, radius in enumerate(self._radius.tolist()))
        self._apart = 2 * clearance(config, context) + 2 * config.jitter
        self._check_room()
        self.arena_low = self._low - config.margin
        self.arena_high = self._high + config.margin
        self.arena_low[2] = 0.0

    def _check_room(self) -> None:
        """Random places are found fast where little of the space is taken."""
        config = self.config
        balls = (self._radius + self._apart) ** 3
        taken = 4 / 3 * np.pi * (balls.sum() + self.context.num_drones * self._apart**3)
        room = float(np.prod(self._high - self._low + 2 * self._apart))
        if taken > FULL * room:
            raise ValueError(
                f"{self.context.num_drones} drones and {config.num_obstacles} obstacles keep others out of "
                f"{taken / room:.0%} of the space, at most {FULL:.0%} is possible: widen area or altitude_spread"
            )
        if config.leg > 0.5 * config.area:
            raise ValueError(
                f"leg {config.leg:g} m is too long for an area of {config.area:g} m: at most half of it"
            )

    def obstacles(self) -> Sequence[Obstacle]:
        """The bodies, those that move first."""
        return self._bodies

    def _places(
        self, rng: np.random.Generator, obstacle: np.ndarray, start: np.ndarray | None
    ) -> np.ndarray:
        """(N, 3) random places, clear of each other and of obstacles, `leg` from each drone's `start` where it is given."""
        places = np.empty((self.context.num_drones, 3))
        for i in range(len(places)):
            while True:
                place = rng.uniform(self._low, self._high)
                clear = np.all(np.linalg.norm(places[:i] - place, axis=1) > self._apart)
                clear &= np.all(
                    np.linalg.norm(obstacle - place, axis=1) > self._radius + self._apart / 2
                )
                if clear and (start is None or np.linalg.norm(start[i] - place) >= self.config.leg):
                    break
            places[i] = place
        return places

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Everything at random places; drones in flight towards their goals."""
        config = self.config
        obstacle = rng.uniform(self._low, self._high, (config.num_obstacles, 3))
        velocity = rng.uniform(-config.obstacle_speed, config.obstacle_speed, obstacle.shape)
        velocity[config.num_moving :] = 0
        start = self._places(rng, obstacle, None)
        goal = self._places(rng, obstacle, start)
        start = config.scattered(start, rng)
        return self.launch(start, goal, rng)._replace(obstacle=obstacle, obstacle_velocity=velocity)

    def quantities(self) -> Mapping[str, Any]:
        """Tell beside the ways to goals how near obstacles are."""
        return {**super().quantities(), "obstacle_nearness": self._obstacle_nearness}

    def _obstacle_nearness(self, frame: Frame) -> np.ndarray:
        """Sum up over obstacles how deep each drone is within d_safe of them, (W, N)."""
        radius = np.array([obstacle.radius for obstacle in self.obstacles()])
        reach = radius + self.context.collision_radius
        offset = frame.scene.obstacle[:, None] - frame.after.position[:, :, None]
        gap = np.linalg.norm(offset, axis=-1) - reach
        depth: np.ndarray = np.clip(1 - gap / frame.d_safe, 0.0, 1.0).sum(axis=-1)
        return depth

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move obstacles straight on, reflected at the bounds."""
        super().move_scene(scene, time, flying, rngs)
        if not self.config.num_moving:
            return False
        place = scene.obstacle[flying] + self.context.period * scene.obstacle_velocity[flying]
        over = np.maximum(place - self._high, 0) + np.minimum(place - self._low, 0)
        scene.obstacle[flying] = place - 2 * over
        scene.obstacle_velocity[flying] *= np.where(over == 0, 1.0, -1.0)
        return True


def _body(index: int, radius: float) -> Obstacle:
    """A sphere, or every second time a cube, with that bounding radius, m."""
    if index % 2:
        return Obstacle("box", (2 * radius / np.sqrt(3),) * 3)
    return Obstacle("sphere", (radius,))
