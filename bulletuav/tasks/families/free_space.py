"""Flights among random places of a box: starts, goals and obstacles lie anywhere in it."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from bulletuav.tasks.families.airspace import Airspace
from bulletuav.tasks.families.draws import source_of
from bulletuav.tasks.families.flight_config import AirspaceConfig, clearance
from bulletuav.tasks.families.places import Rules, draw_places
from bulletuav.tasks.frame import Spawn, TaskContext

MAX_OCCUPANCY = 0.3
"""Greatest share of the space that drones and obstacles may keep others out of"""


@dataclass(frozen=True)
class FreeSpaceConfig(AirspaceConfig):
    """Options of flights among random places, beside those of free airspace (`AirspaceConfig`).

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


FreeSpaceConfigT = TypeVar("FreeSpaceConfigT", bound=FreeSpaceConfig)


class FreeSpace(Airspace[FreeSpaceConfigT], Generic[FreeSpaceConfigT]):
    """Base of flights in which starts, goals and obstacles lie at random places of a box."""

    def __init__(self, config: FreeSpaceConfigT, context: TaskContext) -> None:
        """Lay out the box, and check that there is room for all.

        Raises:
            ValueError: There is no room, or starts could touch the ground.
        """
        super().__init__(config, context)
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
        # How far apart starts, and goals, lie.
        # Drones that start on the ground are drawn on a plane: above each other there is no room.
        self._start_high = self._high.copy()
        if config.take_off:
            self._start_high[2] = self._low[2]
        # A shift may be as long as the diagonal of its cube, towards another's or a goal
        shift = np.sqrt(3) * config.jitter
        self._apart = 2 * clearance(config, context) + 2 * shift
        keep_off = self.obstacle_radius + self._apart / 2
        self._leg = float(config.leg + shift)
        self._rules = Rules(keep_off, float(self._apart), self._leg)
        self._check_room()
        self.arena_low = self._low - config.margin
        self.arena_high = self._high + config.margin
        self.arena_low[2] = 0.0

    def _check_room(self) -> None:
        """Refuse crowds: random places are found fast where little of the space is taken."""
        config = self.config
        drones = self.context.num_drones
        # Each drone and obstacle keeps others out of a ball around it
        balls = (self.obstacle_radius + self._apart) ** 3
        taken = 4 / 3 * np.pi * (balls.sum() + drones * self._apart**3)
        room = float(np.prod(self._high - self._low + 2 * self._apart))
        if taken > MAX_OCCUPANCY * room:
            raise ValueError(
                f"{drones} drones and {config.num_obstacles} obstacles keep others out of "
                f"{taken / room:.0%} of the space, at most {MAX_OCCUPANCY:.0%} is possible: "
                f"widen area or altitude_spread"
            )
        # On the ground there are discs in place of balls
        if config.take_off:
            taken = drones * np.pi * self._apart**2
            room = float(np.prod(self._high[:2] - self._low[:2] + 2 * self._apart))
            if taken > MAX_OCCUPANCY * room:
                raise ValueError(
                    f"{drones} drones keep others off {taken / room:.0%} of the ground, at most "
                    f"{MAX_OCCUPANCY:.0%} is possible with take_off: widen area, or lower d_safe"
                )
        # A goal must be found this far from any start
        if self._leg > 0.5 * config.area:
            raise ValueError(
                f"leg {config.leg:g} m with jitter {config.jitter:g} m is too long for an area of "
                f"{config.area:g} m: at most half of it"
            )

    def obstacle_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Tell the box in which everything lies, (3,) each, m."""
        return self._low, self._high

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start with everything at random places."""
        config, corners = self.config, (self._low, self._high, self._start_high)
        obstacle, velocity = np.empty((2, config.num_obstacles, 3))
        start, goal = np.empty((2, self.context.num_drones, 3))
        numbers = (config.obstacle_speed, config.num_moving, config.jitter)
        places = (obstacle, velocity, start, goal)
        draw_places(source_of(rng), *corners, self._rules, *numbers, *places)
        return self.launch(start, goal, rng, obstacle=obstacle, obstacle_velocity=velocity)
