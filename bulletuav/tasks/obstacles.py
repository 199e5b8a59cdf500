"""Task `obstacles`: free flight among spheres and boxes, some of which move."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.rotation import dot, minus, vec3
from bulletuav.kernel import kernel
from bulletuav.registry import register
from bulletuav.tasks.base import Rngs
from bulletuav.tasks.families.airspace import REWARD_WEIGHTS, Airspace
from bulletuav.tasks.families.difficulties import UNCERTAINTY
from bulletuav.tasks.families.flight_config import AirspaceConfig, clearance
from bulletuav.tasks.families.places import place_in_turn
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward

GOLDEN_RATIO = (np.sqrt(5) - 1) / 2
"""Its multiples modulo 1 spread sizes evenly over any number of obstacles"""
MAX_OCCUPANCY = 0.3
"""Greatest share of the space that drones and obstacles may keep others out of"""


@dataclass(frozen=True)
class ObstaclesConfig(AirspaceConfig):
    """Options of `obstacles`, beside those of free airspace (`AirspaceConfig`).

    Starts, and goals, keep 2 d_safe from each other, and d_safe from obstacles.

    Attributes:
        area: Side of the square in which starts, goals and obstacles lie, m.
        altitude_spread: Range of their heights about `altitude`, half of it to each side, m.
        leg: Least distance from a start to its goal, m.
        num_obstacles: Number of obstacles; every second one is a cube, the others are spheres.
        num_moving: Number of them that move, reflected at the bounds of their space.
        obstacle_radius: Least and greatest radius of the obstacles' bounding spheres, m. Sizes
            spread between them.
        obstacle_speed: Greatest speed of an obstacle on each axis, m/s.
        jitter: Largest random shift of a start on each axis, m.
        start_speed: Least and greatest speed at the start, m/s: slow enough to stop before an
            obstacle.
    """

    area: float = 200.0
    altitude_spread: float = 40.0
    leg: float = 80.0
    num_obstacles: int = field(default=10, metadata={"most": 10_000})
    num_moving: int = field(default=5, metadata={"least": 0})
    obstacle_radius: tuple[float, float] = (3.0, 10.0)
    obstacle_speed: float = field(default=5.0, metadata={"most": 100.0})
    jitter: float = 0.0
    start_speed: tuple[float, float] = (0.0, 5.0)


@reward
def obstacle_warning(obstacle_nearness: float) -> float:
    """Sum up nearness to obstacles: 0 at d_safe from the bounding sphere, 1 at contact, linear."""
    return obstacle_nearness


@register("task")
class Obstacles(Airspace[ObstaclesConfig]):
    """Flight from random places to random goals among bodies, some of which move.

    Drones, goals and obstacles start at random places in a square of 200 m, between 20 and 60 m
    high. Every second obstacle is a cube, the others are spheres; all can be hit.

    Observation, Box(55) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the nearest living drones, and the nearest
    obstacles. Both come nearest first, relative to the drone, and are zeros where there are fewer.
    Obstacles are sorted by the distance to their bounding spheres.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 20 m/s.
    Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, as in every shared airspace (see `Airspace` for all terms):

    - progress 5: metres nearer to the goal.
    - goal 50: 1 on reaching the goal.
    - conflict -100: other drones that come closer than d_safe = 5 m.
    - warning -5: nearness to other drones, from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: square of the velocity change, (m/s)^2.
    - obstacle_warning -5: for each obstacle, linear from 0 at d_safe from its bounding sphere to
      1 at contact with it.

    End: terminated within 2 m of the goal, on contact, with an empty battery, or outside the
    arena. Truncated after 500 decisions.

    Success: the goal is reached.

    Difficulties (drones, obstacles, of these moving, side of the square); from medium on positions
    are noisy, hard adds wind, extreme makes everything uncertain:

    - easy 4, 10, 0, 200 m.
    - medium 8, 10, 5, 200 m.
    - hard 20, 15, 10, 200 m.
    - extreme 100, 20, 15, 300 m.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.
    """

    name = "obstacles"
    observation = ("position", "velocity", "goal", "neighbours", "obstacles")
    reward: ClassVar = {**REWARD_WEIGHTS, "obstacle_warning": (obstacle_warning, -5.0)}
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, "num_moving": 0, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {
            "num_drones": 20,
            "num_obstacles": 15,
            "num_moving": 10,
            **UNCERTAINTY["hard"],
        },
        "extreme": {
            "num_drones": 100,
            "area": 300.0,
            "num_obstacles": 20,
            "num_moving": 15,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: ObstaclesConfig, context: TaskContext) -> None:
        """Make the obstacles, and check that there is room for all.

        Raises:
            ValueError: There is no room, or starts could touch the ground.
        """
        super().__init__(config, context)
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
        # The space in which everything lies.
        side = config.area / 2
        rise = config.altitude_spread / 2
        self._low = np.array([-side, -side, config.altitude - rise])
        self._high = np.array([side, side, config.altitude + rise])
        if self._low[2] - config.jitter <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low "
                f"for altitude_spread {config.altitude_spread:g} m"
            )
        # Obstacles of all sizes, and how far apart starts, and goals, lie.
        index = np.arange(config.num_obstacles)
        self._radius = smallest + (largest - smallest) * (index * GOLDEN_RATIO % 1)
        self._bodies = tuple(_body(k, radius) for k, radius in enumerate(self._radius.tolist()))
        radius = np.array([body.radius for body in self._bodies])
        self._reach = radius + context.collision_radius
        self._apart = 2 * clearance(config, context) + 2 * config.jitter
        self._check_room()
        self.arena_low = self._low - config.margin
        self.arena_high = self._high + config.margin
        self.arena_low[2] = 0.0

    def _check_room(self) -> None:
        """Refuse crowds: random places are found fast where little of the space is taken."""
        config = self.config
        drones = self.context.num_drones
        balls = (self._radius + self._apart) ** 3
        taken = 4 / 3 * np.pi * (balls.sum() + drones * self._apart**3)
        room = float(np.prod(self._high - self._low + 2 * self._apart))
        if taken > MAX_OCCUPANCY * room:
            raise ValueError(
                f"{drones} drones and {config.num_obstacles} obstacles keep others out of "
                f"{taken / room:.0%} of the space, at most {MAX_OCCUPANCY:.0%} is possible: "
                f"widen area or altitude_spread"
            )
        if config.leg > 0.5 * config.area:
            raise ValueError(
                f"leg {config.leg:g} m is too long for an area of {config.area:g} m: "
                f"at most half of it"
            )

    def obstacles(self) -> Sequence[Obstacle]:
        """List the obstacles, those that move first."""
        return self._bodies

    def _places(
        self, rng: np.random.Generator, obstacle: np.ndarray, start: np.ndarray | None
    ) -> np.ndarray:
        """Draw places (N, 3), clear of each other and of obstacles, m.

        Where `start` (N, 3) is given, each is `leg` or farther from its drone's start.
        """
        places = np.empty((self.context.num_drones, 3))
        keep_off = self._radius + self._apart / 2
        from_start = places[:0] if start is None else start
        rules = (keep_off, self._apart, from_start, self.config.leg)
        placed = 0
        while placed < len(places):
            # Draw many at once, and then go back to what was needed of them
            generator = rng.bit_generator
            state = generator.state
            draws = rng.uniform(self._low, self._high, (2 * len(places), 3))
            used, placed = place_in_turn(places, placed, draws, obstacle, *rules)
            if used < len(draws):
                generator.state = state
                rng.random(3 * used)
        return places

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start with everything at random places, drones in flight towards their goals."""
        config = self.config
        obstacle = rng.uniform(self._low, self._high, (config.num_obstacles, 3))
        velocity = rng.uniform(-config.obstacle_speed, config.obstacle_speed, obstacle.shape)
        velocity[config.num_moving :] = 0
        start = self._places(rng, obstacle, None)
        goal = self._places(rng, obstacle, start)
        start = config.scattered(start, rng)
        return self.launch(start, goal, rng)._replace(obstacle=obstacle, obstacle_velocity=velocity)

    def quantities(self) -> Mapping[str, Any]:
        """Tell, beside the ways to goals, how near obstacles are."""
        return {**super().quantities(), "obstacle_nearness": self._obstacle_nearness}

    def _obstacle_nearness(self, frame: Frame) -> np.ndarray:
        """Sum up over obstacles how deep each drone is within d_safe of them, (W, N)."""
        nearness = np.empty(frame.alive.shape)
        place, d_safe = frame.scene.obstacle, float(frame.d_safe)
        _sum_nearness(frame.after.position, place, self._reach, d_safe, nearness)
        return nearness

    def move_scene(self, scene: Scene, time: np.ndarray, flying: np.ndarray, rngs: Rngs) -> bool:
        """Move obstacles straight on, reflected at the bounds.

        Returns:
            Whether any obstacle can have moved.
        """
        super().move_scene(scene, time, flying, rngs)
        if not self.config.num_moving:
            return False
        place = scene.obstacle[flying] + self.context.period * scene.obstacle_velocity[flying]
        # How far each is beyond a bound, on each axis: it comes back as far, and turns round.
        beyond = np.maximum(place - self._high, 0) + np.minimum(place - self._low, 0)
        scene.obstacle[flying] = place - 2 * beyond
        scene.obstacle_velocity[flying] *= np.where(beyond == 0, 1.0, -1.0)
        return True


@kernel
def _sum_nearness(
    position: np.ndarray, obstacle: np.ndarray, reach: np.ndarray, d_safe: float, out: np.ndarray
) -> None:
    """Write to `out` (W, N) how deep drones are within d_safe of obstacles (W, K, 3), summed up.

    `reach` (K,) is the distance of the middles at which they touch, m.
    """
    for w in range(out.shape[0]):
        for i in range(out.shape[1]):
            out[w, i] = 0.0
            for k in range(obstacle.shape[1]):
                away = minus(vec3(obstacle, w, k), vec3(position, w, i))
                gap = math.sqrt(dot(away, away)) - reach[k]
                out[w, i] += min(max(1.0 - gap / d_safe, 0.0), 1.0)


def _body(index: int, radius: float) -> Obstacle:
    """Make a sphere, or for odd indices a cube, of that bounding radius, m."""
    if index % 2:
        side = 2 * radius / np.sqrt(3)
        return Obstacle("box", (side, side, side))
    return Obstacle("sphere", (radius,))
