"""Flights among random places of a box: starts, goals and obstacles lie anywhere in it."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Spawn
from bulletuav.tasks.parts.airspace import AirspaceOptions, clearance, require_margin
from bulletuav.tasks.parts.base import Starts
from bulletuav.tasks.parts.draws import get_random_source
from bulletuav.tasks.parts.obstacle_field import ObstacleField
from bulletuav.tasks.parts.places import PlacementRules, draw_places

MAX_OCCUPANCY = 0.3
"""Greatest share of the space that drones and obstacles may keep others out of"""


@dataclass(frozen=True)
class FreeSpaceOptions(AirspaceOptions):
    """Options of flights among random places, beside those of free airspace (`AirspaceOptions`).

    Starts, and goals, keep 2 d_safe from each other, and d_safe from obstacles.

    Attributes:
        area: Side of the square in which starts, goals and obstacles lie, m.
        altitude_spread: Range of their heights about `altitude`, half of it to each side, m.
        leg: Least distance from a start to its goal, m.
        jitter: Largest random shift of a start on each axis, m.
    """

    area: float = 200.0
    altitude_spread: float = 40.0
    leg: float = 80.0
    jitter: float = 0.0


class FreeSpace(Starts):
    """A box of free airspace in which starts, goals and obstacles lie at random places.

    Attributes:
        low: (3,) its lower corner, m.
        high: (3,) its upper corner, m.
        apart: Distance that starts, and goals, keep from each other, m.
        leg: Least distance from a start to its goal before it is shifted, m.
    """

    def __init__(self, task: Task[Any], field: ObstacleField) -> None:
        """Lay out the box, and check that there is room for all; the arena is a margin wider.

        Args:
            task: The task, with options of free space, whose arena is set.
            field: Its obstacles, which stay in the box.

        Raises:
            ValueError: There is no room, or starts could touch the ground.
        """
        self._config, self._field = task.config, field
        config, context = self._config, task.context
        require_margin(config)
        self._num_drones = context.num_drones
        # The space in which everything lies.
        side = config.area / 2
        rise = config.altitude_spread / 2
        self.low = np.array([-side, -side, config.altitude - rise])
        self.high = np.array([side, side, config.altitude + rise])
        if self.low[2] - config.jitter <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low "
                f"for altitude_spread {config.altitude_spread:g} m"
            )
        # How far apart starts, and goals, lie.
        # Drones that start on the ground are drawn on a plane: above each other there is no room.
        self._start_high = self.high.copy()
        if config.take_off:
            self._start_high[2] = self.low[2]
        # A shift may be as long as the diagonal of its cube, towards another's or a goal
        shift = np.sqrt(3) * config.jitter
        self.apart = 2 * clearance(config, context) + 2 * shift
        self.leg = float(config.leg + shift)
        self._rules = PlacementRules(field.radius + self.apart / 2, float(self.apart), self.leg)
        self._check_room()
        field.bounds = (self.low, self.high)
        task.arena_low = self.low - config.margin
        task.arena_high = self.high + config.margin
        task.arena_low[2] = 0.0

    def _check_room(self) -> None:
        """Refuse crowds: random places are found fast where little of the space is taken."""
        config, drones = self._config, self._num_drones
        # Each drone and obstacle keeps others out of a ball around it
        balls = (self._field.radius + self.apart) ** 3
        taken = 4 / 3 * np.pi * (balls.sum() + drones * self.apart**3)
        room = float(np.prod(self.high - self.low + 2 * self.apart))
        if taken > MAX_OCCUPANCY * room:
            raise ValueError(
                f"{drones} drones and {config.num_obstacles} obstacles keep others out of "
                f"{taken / room:.0%} of the space, at most {MAX_OCCUPANCY:.0%} is possible: "
                f"widen area or altitude_spread"
            )
        # On the ground there are discs in place of balls
        if config.take_off:
            taken = drones * np.pi * self.apart**2
            room = float(np.prod(self.high[:2] - self.low[:2] + 2 * self.apart))
            if taken > MAX_OCCUPANCY * room:
                raise ValueError(
                    f"{drones} drones keep others off {taken / room:.0%} of the ground, at most "
                    f"{MAX_OCCUPANCY:.0%} is possible with take_off: widen area, or lower d_safe"
                )
        # A goal must be found this far from any start
        if self.leg > 0.5 * config.area:
            raise ValueError(
                f"leg {config.leg:g} m with jitter {config.jitter:g} m is too long for an area of "
                f"{config.area:g} m: at most half of it"
            )

    def draw(self, rng: np.random.Generator) -> Spawn:
        """Draw where everything is."""
        config = self._config
        obstacle, velocity = np.empty((2, config.num_obstacles, 3))
        start, goal = np.empty((2, self._num_drones, 3))
        corners = (self.low, self.high, self._start_high)
        numbers = (config.obstacle_speed, config.num_moving, config.jitter)
        places = (obstacle, velocity, start, goal)
        draw_places(get_random_source(rng), *corners, self._rules, *numbers, *places)
        return Spawn(start, goal, obstacle=obstacle, obstacle_velocity=velocity)
