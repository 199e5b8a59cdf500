"""Task `navigation`: drones fly to goals through a city that they do not see."""

from typing import ClassVar

from bulletuav.registry import register
from bulletuav.tasks.families.presets import URBANMARL_NAVIGATION
from bulletuav.tasks.families.urban import UrbanFlight, UrbanFlightConfig


@register("task")
class Navigation(UrbanFlight[UrbanFlightConfig]):
    """Flight through a city to goals, in which drones know where they are, but sense no building.

    Drones start at rest outdoors, 5 to 12 m high. Each one's goal lies outdoors, too, 200 m or
    farther away. The ceiling, at 15 m, is below most roofs: the way leads through the streets.

    Observation, Box(38) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, charge of the battery, room to the
    city's edges, its ceiling and the ground up to 60 m (see `room`), and the nearest living
    drones. These come nearest first, relative to the drone, and are zeros where there are fewer.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s.
    Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, as in every shared airspace (see `Airspace` for all terms):

    - progress 5: metres nearer to the goal.
    - goal 50: 1 on reaching the goal.
    - conflict -200: other drones that come closer than d_safe = 2 m.
    - warning -5: nearness to other drones, from 0 at 4 m to 1 at 2 m.
    - collision -200: 1 on contact, also with a building.
    - out_of_bounds -50: 1 outside the city's square or above its ceiling.
    - energy -0.01: square of the velocity change, (m/s)^2.
    - time -0.5: 1 a decision until the goal is reached; on another end also all that are left.

    End: terminated within 2 m of the goal, on contact, with an empty battery, and outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/service.md).
    """

    name = "navigation"
    presets: ClassVar = {"urbanmarl": URBANMARL_NAVIGATION}
    observation = ("position", "velocity", "goal", "battery", "room", "neighbours")
