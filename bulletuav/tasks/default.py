"""Task `default`: a short, complete task in a city.

Copy this file to write your own task (see CONTRIBUTING.md).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Spawn, TaskContext
from bulletuav.tasks.given import PLACES
from bulletuav.tasks.goal_flight import GOAL_FLIGHT_SHIRKERS
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.difficulties import URBAN_DIFFICULTIES
from bulletuav.tasks.parts.obstacle_field import (
    CityObstacleOptions,
    ObstacleField,
    ObstacleOptions,
)
from bulletuav.tasks.parts.presets import URBANMARL_DEFAULT
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS, StreetOptions


@dataclass(frozen=True)
class DefaultConfig(StreetOptions, CityOptions, CityObstacleOptions, ObstacleOptions, TaskConfig):
    """Options of `default`, in addition to those of streets (`StreetOptions`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        goal_radius: Distance from the goal within which it is reached, m.
    """

    d_safe: float = 2.0
    goal_radius: float = 5.0


@reward
def speed_made_good(
    distance_before: float, distance: float, max_speed: float, period: float
) -> float:
    """Speed towards the goal divided by max_speed."""
    return (distance_before - distance) / (max_speed * period)


@reward
def arrival(distance: float, goal_radius: float, collision: bool) -> float:
    """1 on reaching the goal without collision."""
    return 1.0 if distance <= goal_radius and not collision else 0.0


@reward
def time(
    distance: float,
    goal_radius: float,
    collision: bool,
    outside: bool,
    depleted: bool,
    time: float,
    duration: float,
    period: float,
) -> float:
    """1 per decision until the goal is reached; an early end also costs all remaining decisions."""
    if collision or outside or depleted:
        return 1.0 + (duration - time) / period
    return 0.0 if distance <= goal_radius else 1.0


@end
def arrived(distance: float, goal_radius: float, collision: bool) -> bool:
    """Return True if the drone is at its goal without collision."""
    return distance <= goal_radius and not collision


@register("task")
class Default(Task[DefaultConfig]):
    """Drones fly through a city, each to its own goal.

    Drones start at rest at random positions outdoors, at heights of 5 to 12 m. Goals are drawn in
    the same way. The ceiling of 15 m is below most roofs, so drones have to fly along the streets.

    Observation, Box(30) per drone with the defaults, in world axes (east, north, up): velocity,
    direction and distance of the goal, battery charge, distances to the city's edges, its ceiling
    and the ground (see `room`), and 16 ranges of the lidar. Its beams are horizontal and labelled
    by their angle to the left of the drone's nose, in degrees. Ranges and distances are at most 60
    m, the value of a beam without a hit.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - progress 1: speed towards the goal divided by max_speed.
    - goal 10: 1 in the decision in which the drone reaches the goal.
    - conflict -50: number of drones whose separation falls below d_safe = 2 m.
    - collision -10: 1 on contact of collision shapes.
    - time -0.1: 1 per decision until the goal is reached; if the episode ends otherwise, also 1 per
      remaining decision.

    End: terminated within 5 m of the goal, on contact, when the battery is empty, or outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    name = "default"
    presets: ClassVar = {"urbanmarl": URBANMARL_DEFAULT}
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600}
    difficulties: ClassVar = URBAN_DIFFICULTIES
    observation = ("velocity", "goal", "battery", "room", "lidar")
    baseline = "planner"
    shirkers = GOAL_FLIGHT_SHIRKERS
    places: ClassVar[tuple[str, ...]] = PLACES
    reward: ClassVar = {
        "progress": (speed_made_good, 1.0),
        "goal": (arrival, 10.0),
        "conflict": -50.0,
        "collision": -10.0,
        "time": (time, -0.1),
    }
    training_weights: ClassVar = {
        "progress": 0.15,
        "goal": 3.0,
        "conflict": -4.0,
        "collision": -4.0,
        "time": -0.01,
    }
    ends = (arrived, collision, leaves_arena)
    success = arrived

    def __init__(self, config: DefaultConfig, context: TaskContext) -> None:
        """Create obstacles and cities.

        Raises:
            ValueError: If a city has no space to fly.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.safety = self.add(Safety(context.num_drones))
        self.city_layouts = add_city(self)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts at rest and goals, all outdoors."""
        layout = self.city_layouts.draw(rng)
        goal = self.city_layouts.places(rng, layout, self.context.num_drones)
        start = self.city_layouts.hovering(rng, layout, self.context.num_drones)
        return start._replace(goal=goal)
