"""Task `navigation`: everyone to its own goal through a city, without touching it or each other."""

from bulletuav.registry import register
from bulletuav.tasks.families.urban import UrbanFlight, UrbanFlightConfig


@register("task")
class Navigation(UrbanFlight[UrbanFlightConfig]):
    """Through a city to a goal, knowing where one is but seeing no building.

    Observation, per drone, Box(32) with the defaults; `bulletuav tasks navigation` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every flight through a city, see `UrbanFlight`, and in every shared
    airspace, see `Airspace`.
    """

    name = "navigation"
    observation = ("position", "velocity", "goal", "battery", "neighbours")
