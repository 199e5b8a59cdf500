"""Task `lidar_navigation`: everyone to its own goal through a city that it sees by its range finder alone."""

from dataclasses import dataclass
from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.families.airspace import REWARD_WEIGHTS
from bulletuav.tasks.families.urban import URBAN_DIFFICULTIES, UrbanFlight, UrbanFlightConfig
from bulletuav.tasks.frame import TaskContext

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


@register("task")
class LidarNavigation(UrbanFlight[LidarNavigationConfig]):
    """Through a city to a goal, seeing what is near by a range finder; nothing tells where one is.

    Observation, per drone, Box(24) with the defaults; `bulletuav tasks lidar_navigation` lists each number:
    World axes (east, north, up). Beams are level, at so many degrees to the left of the drone's nose; 60 m is also the range
    of what is not hit.

    Action, reward, end and what is uncertain: as in every flight through a city, see `UrbanFlight`, and in every shared
    airspace, see `Airspace`. Beside that: proximity -1, linear from 0 where the shortest range is 5 m to 1 at 0 m; from
    medium on ranges are noisy: 0.1 m, then 0.3 m with 1 % and 0.5 m with 5 % of the beams lost.
    """

    name = "lidar_navigation"
    difficulties: ClassVar = {
        difficulty: {
            **options,
            "randomization": {**options.get("randomization", {}), **RANGES[difficulty]},
        }
        for difficulty, options in URBAN_DIFFICULTIES.items()
    }
    observation = ("velocity", "goal", "battery", "lidar")
    required_sensors = ("lidar",)
    reward: ClassVar = {**REWARD_WEIGHTS, "proximity": -1.0}

    def __init__(self, config: LidarNavigationConfig, context: TaskContext):
        """Raises ValueError where the city leaves no room to fly."""
        super().__init__(config, context)
        if config.proximity_range == 0:
            raise ValueError(
                "proximity_range is 0 m: it must be above 0; to leave the term out, weigh it by 0"
            )
