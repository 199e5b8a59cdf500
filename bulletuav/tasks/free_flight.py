"""Task `free_flight`: drones fly from random starts, in random directions, to random goals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from bulletuav.registry import register
from bulletuav.tasks.frame import TaskContext
from bulletuav.tasks.goal_flight import GOAL_FLIGHT_SHIRKERS, FlightConfig, GoalFlight
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES
from bulletuav.tasks.parts.forward_flight import (
    TURN_MARGIN,
    forward_sizes,
    kept_number,
    tightest_turn,
)
from bulletuav.tasks.parts.free_space import FreeSpace, FreeSpaceOptions
from bulletuav.tasks.parts.presets import UAVCONFLICT
from bulletuav.tasks.parts.restarts import Restarts
from bulletuav.vehicle.airframe import Airframe

DENSE: dict[str, Any] = {"altitude_spread": 4.0, "start_speed": (0.0, 5.0)}
"""Options with which half of few drones encounter another drone"""
MIN_SIDE = 2.5
"""Minimum side of the square in minimum distances of goals, for aircraft that cannot hover"""


@dataclass(frozen=True)
class FreeFlightConfig(FreeSpaceOptions, FlightConfig):
    """Options of `free_flight`, in addition to those of free space (`FreeSpaceOptions`).

    Attributes:
        altitude: Height of the centre of the box above ground, m.
        altitude_spread: Range of altitudes of starts and goals, centred at `altitude`, m.
        leg: Minimum distance from a start to its goal, m.
        heading: Direction of flight at the start, by default random.
        at_goal: Behaviour at the goal: "leave", "land" or "hold", see `FlightConfig`; or "respawn":
            the drone gets another goal, at least `leg` away, so that the traffic lasts until the
            horizon. Every goal counts for the term `goal`, and goals do not end episodes. A drone
            is successful after at least one goal without collision; infos report the number as
            `goals`, and per hour of its flight as `goals_per_hour`. Crashes, bounds and empty
            batteries do not end episodes either: at the beginning of the next decision the drone is
            placed at another start, drawn as the first, with another goal and a full battery. Its
            action in that decision is the one chosen before, and effects of `events` stay. Infos
            count this as `restarts`.
    """

    altitude: float = 70.0
    altitude_spread: float = 10.0
    leg: float = 25.0
    heading: Any = "random"
    at_goal: Literal["leave", "land", "hold", "respawn"] = "leave"  # type: ignore[assignment]


@register("task")
class FreeFlight(GoalFlight[FreeFlightConfig]):
    """Drones fly between random positions of one unstructured airspace.

    Drones start at random positions in a square of 60 m, at heights of 68 to 72 m, and fly in
    random directions at up to 5 m/s. Goals are drawn in the same way. The difficulty sets the size
    of the square, small enough that about half of the drones encounter another drone. At hard and
    extreme, heights are 65 to 75 m, and drones start at 5 to 15 m/s.

    Observation, Box(55) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the nearest active drones, and the nearest
    obstacles. Drones and obstacles are relative to the drone, sorted by distance, and padded with
    zeros. Obstacles are sorted by the distance to their bounding spheres.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - progress 5: decrease of the distance to the goal, m.
    - goal 50: 1 in the decision in which the drone reaches the goal.
    - conflict -200: number of drones whose separation falls below d_safe = 5 m.
    - warning -5: sum over other drones of their proximity, linear from 0 at 10 m to 1 at 5 m.
    - collision -200: 1 on contact.
    - out_of_bounds -50: 1 outside the arena.
    - energy -0.01: squared change of velocity, (m/s)^2.
    - time -0.5: 1 per decision until the goal is reached; if the episode ends otherwise, also 1 per
      remaining decision.
    - obstacle_warning -5: sum over obstacles of their proximity, linear from 0 at d_safe from the
      bounding sphere to 1 at contact.

    End: terminated within 2 m of the goal, on contact, when the battery is empty, or outside the
    arena. Truncated after 500 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset uavconflict: the scenario of UAVConflictGym with its sizes, observation and reward
    constants.
    """

    name = "free_flight"
    has_absent = True
    needs_hover = False
    version = 2
    shirkers = (*GOAL_FLIGHT_SHIRKERS, "pass_closely")
    difficulties: ClassVar = {
        "easy": {**AIRSPACE_DIFFICULTIES["easy"], "area": 50.0, **DENSE},
        "medium": {**AIRSPACE_DIFFICULTIES["medium"], "area": 60.0, **DENSE},
        "hard": {**AIRSPACE_DIFFICULTIES["hard"], "area": 140.0},
        "extreme": {**AIRSPACE_DIFFICULTIES["extreme"], "area": 250.0},
    }
    presets: ClassVar = {
        "uavconflict": {
            **UAVCONFLICT,
            "area": 200.0,
            # A cube of 200 m, above the ground.
            "altitude": 120.0,
            "altitude_spread": 200.0,
            "leg": 0.0,
            "start_speed": (5.0, 15.0),
            "num_obstacles": 0,
            "num_moving": 0,
        }
    }

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return a square whose area grows with the number of drones; see the base class."""
        radius = tightest_turn(airframes)
        room = 4 * radius * max(2.0, math.sqrt(int(values["num_drones"])))
        leg = kept_number(kept, "leg", math.ceil(TURN_MARGIN * radius))
        side = kept_number(kept, "area", math.ceil(max(room, MIN_SIDE * leg)))
        own = {"area": side, "leg": min(leg, side / MIN_SIDE)}
        return {**own, **forward_sizes(airframes, values, math.sqrt(2.0) * side)}

    def __init__(self, config: FreeFlightConfig, context: TaskContext) -> None:
        """Set up the free space.

        Raises:
            ValueError: If drones and obstacles do not fit, or starts could touch the ground.
        """
        super().__init__(config, context)
        self.starts = FreeSpace(self, self.field)
        if self.respawns:
            distances = (self.starts.apart, self.starts.obstacle_distance)
            self.restarts = self.add(Restarts(self, *distances))
