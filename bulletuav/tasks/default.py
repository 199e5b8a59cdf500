"""Task `default`: a short, complete task in a city. Copy this file to begin one of your own (see CONTRIBUTING.md)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.families.urban import DEFAULTS, UrbanConfig, UrbanTask
from bulletuav.tasks.frame import Spawn
from bulletuav.tasks.ingredients import end, reward


@dataclass(frozen=True)
class DefaultConfig(UrbanConfig):
    """Options of `default` beside those of cities, m: `goal_radius` about a goal counts as reached."""

    d_safe: float = 2.0
    goal_radius: float = 5.0


@reward
def speed_made_good(
    distance_before: float, distance: float, max_speed: float, period: float
) -> float:
    """Speed towards the goal over max_speed."""
    return (distance_before - distance) / (max_speed * period)


@reward
def arrival(distance: float, goal_radius: float, collision: bool) -> float:
    """1 on reaching the goal."""
    return 1.0 if distance <= goal_radius and not collision else 0.0


@end
def arrived(distance: float, goal_radius: float, collision: bool) -> bool:
    """Tell whether the goal is reached, without a crash."""
    return distance <= goal_radius and not collision


@register("task")
class Default(UrbanTask[DefaultConfig]):
    """Fly through a city to a goal.

    Observation, per drone, Box(24) with the defaults; `bulletuav tasks default` lists each number:
    World axes (east, north, up). Beams are level, at so many degrees to the left of the drone's nose; 60 m is also the range
    of what is not hit.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed;
    10 decisions a second.

    Reward, per decision: progress 1, of what max_speed would make good; goal 10 on reaching it; collision -10; time -0.1
    (weights by name).

    End: terminated within 5 m of the goal, on contact of collision shapes, with an empty battery, and outside the city's
    square or above its ceiling; truncated after 600 decisions. Success: goal reached.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on positions are
    noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "default"
    defaults: ClassVar = {**DEFAULTS, "horizon": 600}
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
        """The start of one world: at rest outdoors, goals outdoors."""
        layout = self.town.draw(rng)
        goal = self.town.places(rng, layout, self.context.num_drones)
        return self.town.hovering(rng, layout, self.context.num_drones)._replace(goal=goal)
