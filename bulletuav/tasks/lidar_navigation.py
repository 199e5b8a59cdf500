"""Task `lidar_navigation`: everyone to its own goal through a city that it sees by its range finder alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.physics.solids import Solids
from bulletuav.tasks.base import Setting, Spawn
from bulletuav.tasks.terms.airspace import REWARD_WEIGHTS, Airspace, FlightConfig
from bulletuav.tasks.terms.urban import LEVELS, Town, UrbanConfig

RANGES: dict[str, dict[str, float]] = {
    "easy": {},
    "medium": {"lidar_noise": 0.1},
    "hard": {"lidar_noise": 0.3, "lidar_dropout": 0.01},
    "extreme": {"lidar_noise": 0.5, "lidar_dropout": 0.05},
}
"""What a difficulty makes uncertain about ranges"""


@dataclass(frozen=True)
class LidarNavigationConfig(UrbanConfig, FlightConfig):
    """Options of `lidar_navigation` beside those of flights to goals and in cities, m.

    A goal is `leg` or farther from its start; the term `proximity` begins at a range of `proximity_range`.
    """

    leg: float = 150.0
    proximity_range: float = 5.0
    d_safe: float = 2.0
    start_speed: tuple[float, float] = (0.0, 0.0)


class LidarNavigation(Airspace):
    """Through a city to a goal, seeing what is near by a range finder; nothing tells where one is.

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

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`; here d_safe is 2 m, episodes are
    truncated after 600 decisions, and the bounds are those of the city and its ceiling. Contact with a building is a
    collision.
    Beside that: proximity -1, linear from 0 where the shortest range is 5 m to 1 at 0 m.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1; from medium on ranges are noisy: 0.1 m, then 0.3 m with 1 % and 0.5 m with 5 % of the beams lost.
    """

    name = "lidar_navigation"
    Config = LidarNavigationConfig
    config: LidarNavigationConfig
    defaults: ClassVar = {
        **Airspace.defaults,
        "num_drones": 3,
        "max_speed": 15.0,
        "horizon": 600,
        "difficulty": "easy",
        "battery_capacity": 23.3,
    }
    presets: ClassVar = {}
    difficulties: ClassVar = {
        level: {**options, "randomization": {**options.get("randomization", {}), **RANGES[level]}}
        for level, options in LEVELS.items()
    }
    observation = ("velocity", "goal", "battery", "lidar")
    baseline = "planner"
    senses = ("lidar",)
    reward_weights: ClassVar = {**REWARD_WEIGHTS, "proximity": -1.0}

    def __init__(self, config: LidarNavigationConfig, setting: Setting):
        """Raises ValueError where the city leaves no room to fly."""
        super().__init__(config, setting)
        if config.proximity_range == 0:
            raise ValueError("proximity_range is 0 m: it must be above 0; to leave the term out, weigh it by 0")
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
