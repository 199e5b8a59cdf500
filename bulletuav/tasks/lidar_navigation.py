"""Task `lidar_navigation`: drones fly to goals through a city that they sense by lidar alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import (
    CITY_REWARD_WEIGHTS,
    GOAL_FLIGHT_SHIRKERS,
    TRAINING_WEIGHTS,
    FlightConfig,
    GoalFlight,
)
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.difficulties import URBAN_DIFFICULTIES
from bulletuav.tasks.parts.obstacle_field import CityObstacleOptions
from bulletuav.tasks.parts.presets import URBANMARL_LIDAR_NAVIGATION
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS, CityLegs, UrbanFlightOptions

RANGE_UNCERTAINTY: dict[str, dict[str, float]] = {
    "easy": {},
    "medium": {"lidar_noise": 0.1},
    "hard": {"lidar_noise": 0.3, "lidar_dropout": 0.01},
    "extreme": {"lidar_noise": 0.5, "lidar_dropout": 0.05},
}
"""Uncertainty of ranges by difficulty: noise, m, and fraction of beams lost"""


@dataclass(frozen=True)
class LidarNavigationConfig(UrbanFlightOptions, CityOptions, CityObstacleOptions, FlightConfig):
    """Options of `lidar_navigation`, in addition to those of urban flights (`UrbanFlightOptions`).

    Attributes:
        proximity_range: Shortest range below which the term `proximity` applies, m; above 0.
    """

    proximity_range: float = 5.0


@register("task")
class LidarNavigation(GoalFlight[LidarNavigationConfig]):
    """Drones fly through a city to goals with a lidar, without measuring their position.

    Drones start at rest outdoors at heights of 5 to 12 m. Each goal is outdoors, too, at least 200
    m from the drone's start. The ceiling of 15 m is below most roofs, so drones have to fly along
    the streets.

    Observation, Box(30) per drone with the defaults, in world axes (east, north, up): velocity,
    direction and distance of the goal, battery charge, distances to the city's edges, its ceiling
    and the ground (see `room`), and 16 ranges of the lidar. Its beams are horizontal and labelled
    by their angle to the left of the drone's nose, in degrees. Ranges and distances are at most 60
    m, the value of a beam without a hit.

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
    - proximity -1: linear in the shortest lidar range: 0 for 5 m, 1 for 0 m.
    - distance 0: distance to the goal, m.

    End: terminated within 2 m of the goal, on contact, when the battery is empty, or outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    name = "lidar_navigation"
    has_absent = True
    version = 2
    shirkers = GOAL_FLIGHT_SHIRKERS
    presets: ClassVar = {"urbanmarl": URBANMARL_LIDAR_NAVIGATION}
    difficulties: ClassVar = {
        difficulty: {
            **options,
            "randomization": {**options.get("randomization", {}), **RANGE_UNCERTAINTY[difficulty]},
        }
        for difficulty, options in URBAN_DIFFICULTIES.items()
    }
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600, "difficulty": "easy"}
    baseline = "planner"
    observation = ("velocity", "goal", "battery", "room", "lidar")
    required_sensors = ("lidar",)
    reward: ClassVar = {**CITY_REWARD_WEIGHTS, "proximity": -1.0, "distance": 0.0}
    training_weights: ClassVar[Mapping[str, float]] = {**TRAINING_WEIGHTS, "proximity": -0.02}

    def __init__(self, config: LidarNavigationConfig, context: TaskContext) -> None:
        """Create the cities, and check legs and the range of the term `proximity`.

        Raises:
            ValueError: If a city has no space to fly or is too small for a leg, or the range is 0.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.city_layouts = add_city(self)
        self.starts = CityLegs(self, self.city_layouts)
        if config.proximity_range == 0:
            raise ValueError(
                "proximity_range is 0 m: it must be above 0; to disable the term, set weight 0"
            )
