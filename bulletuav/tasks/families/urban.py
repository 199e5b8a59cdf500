"""Tasks in cities, and flights to goals through them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from bulletuav.geometry.solids import Solids
from bulletuav.tasks.base import Task
from bulletuav.tasks.families.airspace import Airspace
from bulletuav.tasks.families.city_layouts import CityLayouts, UrbanConfig
from bulletuav.tasks.families.difficulties import URBAN_DIFFICULTIES
from bulletuav.tasks.families.flight_config import FlightConfig
from bulletuav.tasks.frame import Spawn, TaskContext

URBAN_DEFAULTS: dict[str, Any] = {
    "num_drones": 3,
    "airframe": "hummingbird",
    "action": "velocity",
    "decision_hz": 10,
    "max_speed": 15.0,
    "battery_capacity": 23.3,
}
"""Common options of tasks in cities, unless a task says otherwise"""


def check_share(name: str, value: float) -> None:
    """Refuse what is not a share that can be reached.

    Args:
        name: Name of the option.
        value: Its value.

    Raises:
        ValueError: It is not above 0 and at most 1.
    """
    if not 0 < value <= 1:
        raise ValueError(f"{name} is {value:g}: a share above 0 and at most 1 is needed")


UrbanConfigT = TypeVar("UrbanConfigT", bound=UrbanConfig)


class UrbanTask(Task[UrbanConfigT], Generic[UrbanConfigT]):
    """Base of tasks in a city; the arena is the city's square, up to the ceiling.

    Attributes:
        town: Cities of the task, and places in them.
    """

    difficulties: ClassVar = URBAN_DIFFICULTIES

    def __init__(self, config: UrbanConfigT, context: TaskContext) -> None:
        """Make the cities.

        Raises:
            ValueError: They leave no room to fly.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        self.town = CityLayouts(config, context)
        self.arena_low = self.town.low
        self.arena_high = self.town.high

    def layouts(self) -> Sequence[Solids]:
        """List the buildings of each city."""
        return self.town.solids


@dataclass(frozen=True)
class UrbanFlightConfig(UrbanConfig, FlightConfig):
    """Options of flights to goals in cities, beside those of cities and of all flights.

    Attributes:
        leg: Least distance from a drone's start to its goal, m.
        d_safe: Separation below which two drones are in conflict, m.
        start_speed: Least and greatest speed at the start, m/s.
    """

    leg: float = 150.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)


UrbanFlightConfigT = TypeVar("UrbanFlightConfigT", bound=UrbanFlightConfig)


class UrbanFlight(
    UrbanTask[UrbanFlightConfigT], Airspace[UrbanFlightConfigT], Generic[UrbanFlightConfigT]
):
    """Base of flights to goals through a city; a task adds what drones observe.

    It is an `Airspace`, with these differences. Starts, at rest, and goals lie outdoors. d_safe
    is 2 m. Contact with a building is a collision. Episodes are truncated after 600 decisions.

    Difficulties (drones, city, irregularity):

    - easy 3, urban, 0.
    - medium 5, urban, 0.5.
    - hard 8, dense, 0.5.
    - extreme 16, high_rise, 1.
    """

    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600, "difficulty": "easy"}
    presets: ClassVar = {}
    baseline = "planner"

    def __init__(self, config: UrbanFlightConfigT, context: TaskContext) -> None:
        """Make the cities, and check that legs fit into them.

        Raises:
            ValueError: A city leaves no room to fly, or is too small for a leg.
            FileNotFoundError: The city's file is not there.
        """
        super().__init__(config, context)
        self.town.require(config.leg)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start at rest outdoors, with goals outdoors."""
        layout = self.town.draw(rng)
        start, goal = self.town.legs(rng, layout, self.context.num_drones, self.config.leg)
        return self.launch(start, goal, rng)._replace(layout=layout)
