"""Task `converge`: drones on a circle fly to their antipodes, all through the centre."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.registry import register
from bulletuav.tasks.frame import Spawn, TaskContext
from bulletuav.tasks.goal_flight import GOAL_FLIGHT_SHIRKERS, FlightConfig, GoalFlight
from bulletuav.tasks.parts.airspace import (
    LARGE_SWARM,
    ROOM,
    AirspaceOptions,
    circle_arena,
    clearance,
    min_start_distance,
)
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES
from bulletuav.tasks.parts.forward_flight import (
    TURN_MARGIN,
    forward_sizes,
    kept_number,
    tightest_turn,
)
from bulletuav.vehicle.airframe import Airframe


@dataclass(frozen=True)
class ConvergeConfig(AirspaceOptions, FlightConfig):
    """Options of `converge`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        radius: Radius of the circle, m. If more than 256 drones do not fit on it, they start on
            larger circles above each other.
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
    needs_hover = False
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
        clear = clearance(config, context)
        self._radius, self._on_circle, self._rise = config.radius, context.num_drones, 0.0
        if context.num_drones > LARGE_SWARM:
            self._stack_circles(clear)
        chord = 2 * self._radius * sin(np.pi / max(self._on_circle, 2))
        nearest = min_start_distance(config, chord)
        if nearest <= clear:
            raise ValueError(
                f"start positions may be in conflict: on a circle of radius {config.radius:g} m "
                f"with jitter {config.jitter:g} m neighbours may be {nearest:.3g} m apart, "
                f"more than {clear:.3g} m (d_safe) is needed"
            )
        self.arena_low, self.arena_high = circle_arena(config, context, self._radius)
        circles = -(-context.num_drones // self._on_circle)
        self.arena_high[2] += (circles - 1) * self._rise

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return a circle with a turn radius or more between starts; see the base class."""
        radius = tightest_turn(airframes)
        room = int(values["num_drones"]) * radius / (2 * math.pi)
        usual = math.ceil(max(2 * TURN_MARGIN * radius, room))
        circle = kept_number(kept, "radius", usual)
        return {"radius": circle, **forward_sizes(airframes, values, 2 * circle)}

    def _stack_circles(self, clear: float) -> None:
        """Set radius, drones and vertical distance of circles if one circle is too small.

        The radius grows by the cube root of the number of drones, so that the swarm keeps its form.

        Args:
            clear: Minimum distance between starts, m.
        """
        config, drones = self.config, self.context.num_drones
        chord = ROOM * (clear + 2 * np.sqrt(2) * config.jitter)
        room = int(2 * np.pi * config.radius / chord)
        if not 0 < room < drones:
            return
        self._radius = config.radius * (drones / room) ** (1 / 3)
        circles = -(-drones // int(2 * np.pi * self._radius / chord))
        self._on_circle = -(-drones // circles)
        self._rise = ROOM * (clear + 2 * config.jitter)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts on the circle, in flight towards its centre."""
        drones = self.context.num_drones
        number = np.arange(drones)
        angle = 2 * np.pi * (number % self._on_circle) / self._on_circle
        directions = np.stack([cos(angle), sin(angle), np.zeros(drones)], axis=1)
        place = self._radius * directions
        height = np.zeros((drones, 3))
        height[:, 2] = self.config.altitude + self._rise * (number // self._on_circle)
        start = self.config.scattered(place + height, rng)
        return self.launch(start, height - place, rng)
