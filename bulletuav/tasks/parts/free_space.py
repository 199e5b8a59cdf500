"""Random starts, goals and obstacles in a box of free space."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Scene, Spawn
from bulletuav.tasks.parts.airspace import (
    LARGE_SWARM,
    ROOM,
    AirspaceOptions,
    clearance,
    require_margin,
)
from bulletuav.tasks.parts.base import Starts
from bulletuav.tasks.parts.draws import get_random_source
from bulletuav.tasks.parts.obstacle_field import ObstacleField
from bulletuav.tasks.parts.places import PlacementRules, draw_places

MAX_GOAL_DRAWS = 1000
"""Maximum number of draws of a further goal; usually one of the first few is suitable"""
MAX_OCCUPANCY = 0.3
"""Maximum fraction of the space from which drones and obstacles exclude others"""
MAX_GROUND_OCCUPANCY = 0.5
"""The same of the ground, for drones that take off.

In a plane more is possible: random placement of discs ends at 55 % of the area, and each excludes
the centres of others from four times its own. This limit is at 12.5 % of the area.
"""


@dataclass(frozen=True)
class FreeSpaceOptions(AirspaceOptions):
    """Options of flights in free space, in addition to those of free airspace (`AirspaceOptions`).

    Starts, and goals, keep 2 d_safe from each other, and d_safe from obstacles.

    Attributes:
        area: Side of the square in which starts, goals and obstacles are, m; more than 256 drones
            have a larger one if they need it.
        altitude_spread: Range of their altitudes, centred at `altitude`, m.
        leg: Minimum distance from a start to its goal, m.
        jitter: Maximum random offset of a start on each axis, m.
    """

    area: float = 200.0
    altitude_spread: float = 40.0
    leg: float = 80.0
    jitter: float = 0.0


class FreeSpace(Starts):
    """A box of free airspace with starts, goals and obstacles at random positions.

    Attributes:
        low: (3,) lower corner, m.
        high: (3,) upper corner, m.
        apart: Minimum distance between starts, and between goals, m.
        leg: Minimum distance from a start, before its jitter, to its goal, m.
        obstacle_distance: (K,) minimum distances of starts and goals from obstacles' centres, m.
    """

    def __init__(self, task: Task[Any], field: ObstacleField) -> None:
        """Set the box and the arena, which is larger by the margin; check that everything fits.

        Args:
            task: The task, with options of free space, whose arena is set.
            field: Its obstacles, which stay in the box.

        Raises:
            ValueError: If not everything fits, or starts could touch the ground.
        """
        self._config, self._field = task.config, field
        config, context = self._config, task.context
        require_margin(config)
        self._context, self._num_drones = context, context.num_drones
        self._set_distances()
        side = self._find_side() / 2
        rise = config.altitude_spread / 2
        self.low = np.array([-side, -side, config.altitude - rise])
        self.high = np.array([side, side, config.altitude + rise])
        if self.low[2] - config.jitter <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low "
                f"for altitude_spread {config.altitude_spread:g} m"
            )
        # Drones that take off are drawn on a plane, as they cannot be above each other
        self._start_high = self.high.copy()
        if config.take_off:
            self._start_high[2] = self.low[2]
        self._rules = PlacementRules(self.obstacle_distance, float(self.apart), self.leg)
        self._check_room()
        field.bounds = (self.low, self.high)
        task.arena_low = self.low - config.margin
        task.arena_high = self.high + config.margin
        task.arena_low[2] = 0.0

    def _set_distances(self) -> None:
        """Set the minimum distances between starts, goals and obstacles."""
        config = self._config
        # Worst case: jitter along the diagonal of its cube
        shift = np.sqrt(3) * config.jitter
        self.apart = 2 * clearance(config, self._context) + 2 * shift
        self.leg = float(config.leg + shift)
        self.obstacle_distance = self._field.radius + self.apart / 2

    def _find_side(self) -> float:
        """Return the side of the square, m: the one given, or what a large swarm needs."""
        config = self._config
        if self._num_drones <= LARGE_SWARM:
            return float(config.area)
        # The limits of `_check_room`
        room = self._occupied_volume() / MAX_OCCUPANCY
        plane = room / (config.altitude_spread + 2 * self.apart)
        if config.take_off:
            plane = max(plane, self._num_drones * np.pi * self.apart**2 / MAX_GROUND_OCCUPANCY)
        return float(max(config.area, ROOM * np.sqrt(plane) - 2 * self.apart))

    def _occupied_volume(self) -> float:
        """Return the volume from which drones and obstacles exclude others, m^3."""
        # Each of them excludes others from a ball around it
        balls = (self._field.radius + self.apart) ** 3
        return float(4 / 3 * np.pi * (balls.sum() + self._num_drones * self.apart**3))

    def _check_room(self) -> None:
        """Check that little of the space is occupied, so that random positions are found fast."""
        config, drones = self._config, self._num_drones
        taken = self._occupied_volume()
        room = float(np.prod(self.high - self.low + 2 * self.apart))
        if taken > MAX_OCCUPANCY * room:
            raise ValueError(
                f"{drones} drones and {config.num_obstacles} obstacles keep others out of "
                f"{taken / room:.0%} of the space, at most {MAX_OCCUPANCY:.0%} is possible: "
                f"widen area or altitude_spread"
            )
        # On the ground, discs instead of balls
        if config.take_off:
            taken = drones * np.pi * self.apart**2
            room = float(np.prod(self.high[:2] - self.low[:2] + 2 * self.apart))
            if taken > MAX_GROUND_OCCUPANCY * room:
                raise ValueError(
                    f"{drones} drones keep others off {taken / room:.0%} of the ground, at most "
                    f"{MAX_GROUND_OCCUPANCY:.0%} is possible with take_off: widen area, or lower "
                    f"d_safe"
                )
        # Some goal must be this far from any start
        if self.leg > 0.5 * config.area:
            raise ValueError(
                f"leg {config.leg:g} m with jitter {config.jitter:g} m is too long for an area of "
                f"{config.area:g} m: at most half of it"
            )

    def draw(self, rng: np.random.Generator) -> Spawn:
        """Draw starts, goals and obstacles; see the base class."""
        config = self._config
        obstacle, velocity = np.empty((2, config.num_obstacles, 3))
        start, goal = np.empty((2, self._num_drones, 3))
        corners = (self.low, self.high, self._start_high)
        numbers = (self._field.velocity_range, self._field.draw_num_moving(rng), config.jitter)
        places = (obstacle, velocity, start, goal)
        draw_places(get_random_source(rng), *corners, self._rules, *numbers, *places)
        return Spawn(start, goal, obstacle=obstacle, obstacle_velocity=velocity)

    def next_goal(
        self, place: np.ndarray, scene: Scene, world: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Draw a goal at least `leg` away, clear of goals and obstacles; see the base class.

        If none of MAX_GOAL_DRAWS is suitable, as obstacles have moved together, the last one is
        returned.
        """
        goals, obstacles = scene.goal[world], scene.obstacle[world]
        for _ in range(MAX_GOAL_DRAWS):
            goal = rng.uniform(self.low, self.high)
            if (
                np.linalg.norm(goal - place) >= self.leg
                and (np.linalg.norm(goal - goals, axis=-1) > self.apart).all()
                and (np.linalg.norm(goal - obstacles, axis=-1) > self.obstacle_distance).all()
            ):
                break
        return goal
