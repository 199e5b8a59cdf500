"""Task `navigation`: drones fly to goals through a city that they do not see."""

from bulletuav.registry import register
from bulletuav.tasks.families.urban import UrbanFlight, UrbanFlightConfig


@register("task")
class Navigation(UrbanFlight[UrbanFlightConfig]):
    """Flight through a city to goals, in which drones know where they are, but sense no building.

    Drones start at rest outdoors, 5 to 25 m high. Each one's goal lies outdoors, too, 150 m or
    farther away.

    Observation, Box(32) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, charge of the battery, and the nearest living
    drones. These come nearest first, relative to the drone, and are zeros where there are fewer.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: velocity over max_speed = 15 m/s.
    Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, as in every shared airspace (see `Airspace` for all terms):

    - progress 5: metres nearer to the goal.
    - goal 50: 1 on reaching the goal.
    - conflict -100: other drones that come closer than d_safe = 2 m.
    - warning -5: nearness to other drones, from 0 at 4 m to 1 at 2 m.
    - collision -200: 1 on contact, also with a building.
    - out_of_bounds -50: 1 outside the city's square or above its ceiling.
    - energy -0.01: square of the velocity change, (m/s)^2.

    End: terminated within 2 m of the goal, on contact, with an empty battery, and outside the
    city's square or above its ceiling. Truncated after 600 decisions.

    Success: the goal is reached.

    Difficulties (drones, city, irregularity); from medium on positions are noisy, hard adds wind,
    extreme makes everything uncertain, as in the shared airspace:

    - easy 3, urban, 0.
    - medium 5, urban, 0.5.
    - hard 8, dense, 0.5.
    - extreme 16, high_rise, 1.
    """

    name = "navigation"
    observation = ("position", "velocity", "goal", "battery", "neighbours")
