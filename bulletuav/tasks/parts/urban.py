"""Starts, goals and options of flights through cities."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Scene, Spawn
from bulletuav.tasks.parts.base import Starts
from bulletuav.tasks.parts.city_layouts import CityLayouts

URBAN_DEFAULTS: dict[str, Any] = {
    "num_drones": 3,
    "airframe": "hummingbird",
    "action": "velocity",
    "decision_hz": 10,
    "max_speed": 15.0,
    "battery_capacity": 23.3,
}
"""Environment options of tasks in cities, unless a task sets others"""


def check_fraction(name: str, value: float) -> None:
    """Check that an option is a fraction above 0 and at most 1.

    Args:
        name: Name of the option.
        value: Its value.

    Raises:
        ValueError: If the value is out of range.
    """
    if not 0 < value <= 1:
        raise ValueError(f"{name} is {value:g}: a fraction above 0 and at most 1 is needed")


@dataclass(frozen=True)
class StreetOptions:
    """Heights of tasks in the streets of a city, below most of its roofs.

    Seven of ten houses of an urban city are higher than 12.5 m, which is 2.5 m below the ceiling.
    Straight lines of 200 m or more at that height miss all of them in 7 % of flights, most of them
    along a street. Below a ceiling of 30 m it would be half of the flights.

    Attributes:
        height: Minimum and maximum height of starts and goals, m. They are outdoors.
        ceiling: Maximum height of the airspace, m.
    """

    height: tuple[float, float] = (5.0, 12.0)
    ceiling: float = 15.0


@dataclass(frozen=True)
class UrbanFlightOptions(StreetOptions):
    """Options of flights to goals in cities, in addition to those of cities and of all flights.

    Attributes:
        leg: Minimum distance from a drone's start to its goal, m.
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Minimum and maximum speed at the start, m/s.
        at_goal: Behaviour at the goal: "leave", "land" or "hold", see `FlightConfig`; or "respawn":
            the drone gets another goal outdoors, at a distance of `leg` if possible. Every goal
            counts for the term `goal`, and goals do not end episodes. A drone is successful after
            at least one goal without collision; infos report the number as `goals`, and per hour of
            its flight as `goals_per_hour`.
    """

    leg: float = 200.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)
    at_goal: Literal["leave", "land", "hold", "respawn"] = "leave"


class CityLegs(Starts):
    """Starts, at rest, and goals outdoors in a city, at least the option `leg` apart."""

    def __init__(self, task: Task[Any], city_layouts: CityLayouts) -> None:
        """Check that legs fit into the cities.

        Args:
            task: The task, with options of flights through cities.
            city_layouts: Its cities.

        Raises:
            ValueError: If a city is too small for a leg.
        """
        self._city_layouts, self._num_drones = city_layouts, task.context.num_drones
        self._leg = float(task.config.leg)
        city_layouts.require(self._leg)

    def draw(self, rng: np.random.Generator) -> Spawn:
        """Draw starts and goals; see the base class."""
        layout = self._city_layouts.draw(rng)
        start, goal = self._city_layouts.legs(rng, layout, self._num_drones, self._leg)
        return Spawn(start, goal, layout=layout)

    def next_goal(
        self, place: np.ndarray, scene: Scene, world: int, rng: np.random.Generator
    ) -> np.ndarray:
        """Draw the next goal of a drone; see the base class."""
        return self._city_layouts.draw_goal(rng, int(scene.layout[world]), place, self._leg)
