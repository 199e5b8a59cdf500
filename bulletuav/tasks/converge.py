"""Task `converge`: drones on a circle fly to their antipodes, all through the centre."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.registry import register
from bulletuav.tasks.frame import Spawn, TaskContext
from bulletuav.tasks.goal_flight import GOAL_FLIGHT_SHIRKERS, FlightConfig, GoalFlight
from bulletuav.tasks.parts.airspace import (
    AirspaceOptions,
    circle_arena,
    clearance,
    min_start_distance,
)
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES


@dataclass(frozen=True)
class ConvergeConfig(AirspaceOptions, FlightConfig):
    """Options of `converge`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        radius: Radius of the circle, m.
    """

    radius: float = 80.0


@register("task")
class Converge(GoalFlight[ConvergeConfig]):
    """Drones on a circle fly to their antipodes, so that all paths meet at the centre.

    Drones start evenly spaced on a circle at an altitude of 40 m, in flight towards its centre. The
    goal of each drone is the opposite point of the circle.

    Observation, Box(55) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the nearest active drones, and the nearest
    obstacles. Drones and obstacles are relative to the drone, sorted by distance, and padded with
    zeros.

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

    End: terminated within 2 m of the goal, on contact, when the battery is empty, or outside the
    arena. Truncated after 500 decisions.

    Success: the goal is reached, without conflict or collision in the episode.

    Preset uavconflict: sizes, observation and reward constants of UAVConflictGym.
    """

    name = "converge"
    has_absent = True
    version = 2
    shirkers = (*GOAL_FLIGHT_SHIRKERS, "pass_closely")
    difficulties: ClassVar = {
        "easy": AIRSPACE_DIFFICULTIES["easy"],
        "medium": AIRSPACE_DIFFICULTIES["medium"],
        "hard": AIRSPACE_DIFFICULTIES["hard"],
        "extreme": {"radius": 150.0, **AIRSPACE_DIFFICULTIES["extreme"]},
    }

    def __init__(self, config: ConvergeConfig, context: TaskContext) -> None:
        """Check that drones start separated, and set the arena.

        Raises:
            ValueError: If drones could start in conflict or touch the ground.
        """
        super().__init__(config, context)
        chord = 2 * config.radius * sin(np.pi / max(context.num_drones, 2))
        nearest = min_start_distance(config, chord)
        clear = clearance(config, context)
        if nearest <= clear:
            raise ValueError(
                f"start positions may be in conflict: on a circle of radius {config.radius:g} m "
                f"with jitter {config.jitter:g} m neighbours may be {nearest:.3g} m apart, "
                f"more than {clear:.3g} m (d_safe) is needed"
            )
        self.arena_low, self.arena_high = circle_arena(config, context, config.radius)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts on the circle, in flight towards its centre."""
        drones = self.context.num_drones
        angle = 2 * np.pi * np.arange(drones) / drones
        directions = np.stack([cos(angle), sin(angle), np.zeros(drones)], axis=1)
        place = self.config.radius * directions
        height = np.array([0.0, 0.0, self.config.altitude])
        start = self.config.scattered(place + height, rng)
        return self.launch(start, height - place, rng)
