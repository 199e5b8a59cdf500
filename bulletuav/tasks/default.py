"""Task `default`: a short, complete task in a city. Copy this file to begin one of your own (see CONTRIBUTING.md)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from bulletuav.tasks.base import Frame, Spawn, StepResult
from bulletuav.tasks.families.urban import DEFAULTS, UrbanConfig, UrbanTask


@dataclass(frozen=True)
class DefaultConfig(UrbanConfig):
    """Options of `default` beside those of cities, m: `goal_radius` about a goal counts as reached."""

    d_safe: float = 2.0
    goal_radius: float = 5.0
    weights: Mapping[str, float] = field(default_factory=dict)


class Default(UrbanTask):
    """Fly through a city to a goal.

    Observation, per drone, Box(24) float32, clipped to its bounds (here with the defaults):
      0  velocity x        m/s  [-30, 30]
      1  velocity y        m/s  [-30, 30]
      2  velocity z        m/s  [-30, 30]
      3  goal direction x  1    [-1, 1]
      4  goal direction y  1    [-1, 1]
      5  goal direction z  1    [-1, 1]
      6  goal distance     m    [0, 717.217]
      7  charge            1    [0, 1]
      8  beam 0            m    [0, 60]
      9  beam 22.5         m    [0, 60]
     10  beam 45           m    [0, 60]
     11  beam 67.5         m    [0, 60]
     12  beam 90           m    [0, 60]
     13  beam 112.5        m    [0, 60]
     14  beam 135          m    [0, 60]
     15  beam 157.5        m    [0, 60]
     16  beam 180          m    [0, 60]
     17  beam 202.5        m    [0, 60]
     18  beam 225          m    [0, 60]
     19  beam 247.5        m    [0, 60]
     20  beam 270          m    [0, 60]
     21  beam 292.5        m    [0, 60]
     22  beam 315          m    [0, 60]
     23  beam 337.5        m    [0, 60]
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
    Config = DefaultConfig
    config: DefaultConfig
    defaults: ClassVar = {**DEFAULTS, "horizon": 600}
    observation = ("velocity", "goal", "battery", "lidar")
    baseline = "planner"
    reward_weights: ClassVar = {"progress": 1.0, "goal": 10.0, "collision": -10.0, "time": -0.1}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """The start of one world: at rest outdoors, goals outdoors."""
        layout = self.town.draw(rng)
        goal = self.town.places(rng, layout, self.context.num_drones)
        return self.town.hovering(rng, layout, self.context.num_drones)._replace(goal=goal)

    def evaluate_step(self, frame: Frame) -> StepResult:
        """Terms of the reward, whose episode ends, and who succeeded, after a decision."""
        reached = (frame.distance <= self.config.goal_radius) & ~frame.collision
        terms = {
            "progress": (frame.distance_before - frame.distance)
            / (self.context.max_speed * self.context.period),
            "goal": reached.astype(float),
            "collision": frame.collision.astype(float),
            "time": np.ones(frame.alive.shape),
        }
        return StepResult(terms, reached | frame.collision | self.outside(frame), reached)
