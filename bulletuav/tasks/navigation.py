"""Task `navigation`: drones fly to goals through a city that they do not sense."""

from dataclasses import dataclass
from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import (
    CITY_REWARD_WEIGHTS,
    GOAL_FLIGHT_SHIRKERS,
    FlightConfig,
    GoalFlight,
)
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.difficulties import URBAN_DIFFICULTIES
from bulletuav.tasks.parts.obstacle_field import CityObstacleOptions
from bulletuav.tasks.parts.presets import URBANMARL_NAVIGATION
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS, CityLegs, UrbanFlightOptions


@dataclass(frozen=True)
class NavigationConfig(UrbanFlightOptions, CityOptions, CityObstacleOptions, FlightConfig):
    """Options of `navigation`: those of urban flights (`UrbanFlightOptions`)."""


@register("task")
class Navigation(GoalFlight[NavigationConfig]):
    """Drones fly through a city to goals, with known positions but without sensing buildings.

    Drones start at rest outdoors at heights of 5 to 12 m. Each goal is outdoors, too, at least 200
    m from the drone's start. The ceiling of 15 m is below most roofs, so drones have to fly along
    the streets.

    Observation, Box(38) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, battery charge, distances to the city's edges, its
    ceiling and the ground up to 60 m (see `room`), and the nearest active drones. Neighbours are
    relative to the drone, sorted by distance, and padded with zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - progress 5: decrease of the distance to the goal, m.
    - goal 300: 1 in the decision in which the drone reaches the goal.
    - conflict -200: number of drones whose separation falls below d_safe = 2 m.
    - warning -5: sum over other drones of their proximity, linear from 0 at 4 m to 1 at 2 m.
    - collision -200: 1 on contact, also with a building.
    - out_of_bounds -50: 1 outside the city's square or above its ceiling.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the goal is reached; if the episode ends otherwise, also 1 per
      remaining decision.

    End: terminated within 2 m of the goal, on contact, when the battery is empty, or outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    name = "navigation"
    has_absent = True
    version = 2
    shirkers = GOAL_FLIGHT_SHIRKERS
    presets: ClassVar = {"urbanmarl": URBANMARL_NAVIGATION}
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600, "difficulty": "easy"}
    difficulties: ClassVar = URBAN_DIFFICULTIES
    baseline = "planner"
    reward: ClassVar = CITY_REWARD_WEIGHTS
    observation = ("position", "velocity", "goal", "battery", "room", "neighbours")

    def __init__(self, config: NavigationConfig, context: TaskContext) -> None:
        """Create the cities, and check that legs fit into them.

        Raises:
            ValueError: If a city has no space to fly, or is too small for a leg.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.city_layouts = add_city(self)
        self.starts = CityLegs(self, self.city_layouts)
