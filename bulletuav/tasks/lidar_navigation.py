"""Task `lidar_navigation`: everyone to its own goal through a city that it sees by its range finder alone."""

from dataclasses import dataclass
from typing import ClassVar

from bulletuav.tasks.base import TaskContext
from bulletuav.tasks.families.airspace import REWARD_WEIGHTS
from bulletuav.tasks.families.urban import URBAN_DIFFICULTIES, UrbanFlight, UrbanFlightConfig

RANGES: dict[str, dict[str, float]] = {
    "easy": {},
    "medium": {"lidar_noise": 0.1},
    "hard": {"lidar_noise": 0.3, "lidar_dropout": 0.01},
    "extreme": {"lidar_noise": 0.5, "lidar_dropout": 0.05},
}
"""What a difficulty makes uncertain about ranges"""


@dataclass(frozen=True)
class LidarNavigationConfig(UrbanFlightConfig):
    """Options of `lidar_navigation` beside those of flights in cities; `proximity` begins at `proximity_range` m."""

    proximity_range: float = 5.0


class LidarNavigation(UrbanFlight):
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

    Action, reward, end and what is uncertain: as in every flight through a city, see `UrbanFlight`, and in every shared
    airspace, see `Airspace`. Beside that: proximity -1, linear from 0 where the shortest range is 5 m to 1 at 0 m; from
    medium on ranges are noisy: 0.1 m, then 0.3 m with 1 % and 0.5 m with 5 % of the beams lost.
    """

    name = "lidar_navigation"
    Config = LidarNavigationConfig
    config: LidarNavigationConfig
    difficulties: ClassVar = {
        difficulty: {
            **options,
            "randomization": {**options.get("randomization", {}), **RANGES[difficulty]},
        }
        for difficulty, options in URBAN_DIFFICULTIES.items()
    }
    observation = ("velocity", "goal", "battery", "lidar")
    senses = ("lidar",)
    reward_weights: ClassVar = {**REWARD_WEIGHTS, "proximity": -1.0}

    def __init__(self, config: LidarNavigationConfig, context: TaskContext):
        """Raises ValueError where the city leaves no room to fly."""
        super().__init__(config, context)
        if config.proximity_range == 0:
            raise ValueError(
                "proximity_range is 0 m: it must be above 0; to leave the term out, weigh it by 0"
            )
