"""Task `default`: a short, complete task in a city.

Copy this file to begin one of your own (see CONTRIBUTING.md).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.families.city_layouts import UrbanConfig
from bulletuav.tasks.families.urban import URBAN_DEFAULTS, UrbanTask
from bulletuav.tasks.frame import Spawn
from bulletuav.tasks.ingredients import end, reward


@dataclass(frozen=True)
class DefaultConfig(UrbanConfig):
    """Options of `default`, beside those of cities (`UrbanConfig`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        goal_radius: Distance from the goal at which it counts as reached, m.
    """

    d_safe: float = 2.0
    goal_radius: float = 5.0


@reward
def speed_made_good(
    distance_before: float, distance: float, max_speed: float, period: float
) -> float:
    """Compute the speed towards the goal over max_speed."""
    return (distance_before - distance) / (max_speed * period)


@reward
def arrival(distance: float, goal_radius: float, collision: bool) -> float:
    """Give 1 on reaching the goal without a crash."""
    return 1.0 if distance <= goal_radius and not collision else 0.0


@end
def arrived(distance: float, goal_radius: float, collision: bool) -> bool:
    """Tell whether the goal is reached without a crash."""
    return distance <= goal_radius and not collision


@register("task")
class Default(UrbanTask[DefaultConfig]):
    """Flight of each drone through a city to its own goal.

    Drones start at rest at random places outdoors, 5 to 25 m high. Goals are such places, too.

    Observation, Box(24) per drone with the defaults, in world axes (east, north, up): velocity,
    direction and distance of the goal, charge of the battery, and 16 ranges of the lidar. Its
    beams are level, each at so many degrees to the left of the drone's nose. A range of 60 m is
    also that of a beam that hits nothing.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s.
    Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the sum of these terms times their weights:

    - progress 1: speed towards the goal over max_speed.
    - goal 10: 1 on reaching the goal.
    - collision -10: 1 on contact of collision shapes.
    - time -0.1: 1 a decision.

    End: terminated within 5 m of the goal, on contact, with an empty battery, and outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached.

    Difficulties (drones, city, irregularity); from medium on positions are noisy, hard adds wind,
    extreme makes everything uncertain, as in the shared airspace:

    - easy 3, urban, 0.
    - medium 5, urban, 0.5.
    - hard 8, dense, 0.5.
    - extreme 16, high_rise, 1.
    """

    name = "default"
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600}
    observation = ("velocity", "goal", "battery", "lidar")
    baseline = "planner"
    reward: ClassVar = {
        "progress": (speed_made_good, 1.0),
        "goal": (arrival, 10.0),
        "collision": -10.0,
        "time": -0.1,
    }
    ends = (arrived, collision, leaves_arena)
    success = arrived

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw a start at rest outdoors, with goals outdoors."""
        layout = self.town.draw(rng)
        goal = self.town.places(rng, layout, self.context.num_drones)
        start = self.town.hovering(rng, layout, self.context.num_drones)
        return start._replace(goal=goal)
