"""Task `navigation`: everyone to its own goal through a city, without touching it or each other."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.physics.solids import Solids
from bulletuav.tasks.base import Setting, Spawn
from bulletuav.tasks.terms.airspace import Airspace, FlightConfig
from bulletuav.tasks.terms.urban import LEVELS, Town, UrbanConfig


@dataclass(frozen=True)
class NavigationConfig(UrbanConfig, FlightConfig):
    """Options of `navigation` beside those of flights to goals and in cities; goals are `leg` m or farther from starts."""

    leg: float = 150.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)


class Navigation(Airspace):
    """Through a city to a goal, knowing where one is but seeing no building.

    Observation, per drone, Box(32) float32, clipped to its bounds (here with the defaults):
      0  position x              m    [-250, 250]
      1  position y              m    [-250, 250]
      2  position z              m    [0, 120]
      3  velocity x              m/s  [-30, 30]
      4  velocity y              m/s  [-30, 30]
      5  velocity z              m/s  [-30, 30]
      6  goal direction x        1    [-1, 1]
      7  goal direction y        1    [-1, 1]
      8  goal direction z        1    [-1, 1]
      9  goal distance           m    [0, 717.217]
     10  charge                  1    [0, 1]
     11  neighbour 1 distance    m    [0, 717.217]
     12  neighbour 1 position x  m    [-500, 500]
     13  neighbour 1 position y  m    [-500, 500]
     14  neighbour 1 position z  m    [-120, 120]
     15  neighbour 1 velocity x  m/s  [-60, 60]
     16  neighbour 1 velocity y  m/s  [-60, 60]
     17  neighbour 1 velocity z  m/s  [-60, 60]
     18  neighbour 2 distance    m    [0, 717.217]
     19  neighbour 2 position x  m    [-500, 500]
     20  neighbour 2 position y  m    [-500, 500]
     21  neighbour 2 position z  m    [-120, 120]
     22  neighbour 2 velocity x  m/s  [-60, 60]
     23  neighbour 2 velocity y  m/s  [-60, 60]
     24  neighbour 2 velocity z  m/s  [-60, 60]
     25  neighbour 3 distance    m    [0, 717.217]
     26  neighbour 3 position x  m    [-500, 500]
     27  neighbour 3 position y  m    [-500, 500]
     28  neighbour 3 position z  m    [-120, 120]
     29  neighbour 3 velocity x  m/s  [-60, 60]
     30  neighbour 3 velocity y  m/s  [-60, 60]
     31  neighbour 3 velocity z  m/s  [-60, 60]
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`; here d_safe is 2 m, episodes are
    truncated after 600 decisions, and the bounds are those of the city and its ceiling. Contact with a building is a
    collision.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1.
    """

    name = "navigation"
    Config = NavigationConfig
    config: NavigationConfig
    defaults: ClassVar = {
        **Airspace.defaults,
        "num_drones": 3,
        "max_speed": 15.0,
        "horizon": 600,
        "difficulty": "easy",
        "battery_capacity": 23.3,
    }
    presets: ClassVar = {}
    difficulties: ClassVar = LEVELS
    observation = ("position", "velocity", "goal", "battery", "neighbours")
    baseline = "planner"

    def __init__(self, config: NavigationConfig, setting: Setting):
        """Raises ValueError where the city leaves no room to fly."""
        super().__init__(config, setting)
        self.town = Town(config, setting)
        self.arena_low, self.arena_high = self.town.low, self.town.high

    def layouts(self) -> Sequence[Solids]:
        """The cities."""
        return self.town.solids

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """At rest outdoors, goals outdoors."""
        layout, count = self.town.draw(rng), self.setting.num_drones
        start, goal = self.town.legs(rng, layout, count, self.config.leg)
        return self.launch(start, goal, rng)._replace(layout=layout)
