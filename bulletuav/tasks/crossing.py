"""Task `crossing`: two teams cross one airspace at right angles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.frame import Spawn, TaskContext
from bulletuav.tasks.goal_flight import (
    GOAL_FLIGHT_SHIRKERS,
    REWARD_WEIGHTS,
    FlightConfig,
    GoalFlight,
)
from bulletuav.tasks.parts.airspace import (
    LARGE_SWARM,
    ROOM,
    AirspaceOptions,
    clearance,
    require_margin,
)
from bulletuav.tasks.parts.difficulties import AIRSPACE_DIFFICULTIES
from bulletuav.tasks.parts.forward_flight import (
    TURN_MARGIN,
    forward_sizes,
    kept_number,
    tightest_turn,
)
from bulletuav.tasks.parts.teams import team_sizes
from bulletuav.vehicle.airframe import Airframe

MAX_RANKS = 100
"""Maximum number of ranks of a team's formation"""
MAX_DEPTH = 1000.0
"""Maximum depth of the formations of a large swarm, m"""


@dataclass(frozen=True)
class CrossingConfig(AirspaceOptions, FlightConfig):
    """Options of `crossing`, in addition to those of free airspace (`AirspaceOptions`).

    Attributes:
        half_length: Distance of a team's first rank from the centre at the start, m; larger for
            teams of more than 256 drones whose formations are too wide for it.
        altitude_spread: Range of the drones' altitudes, centred at `altitude`, m.
        lanes: Number of columns of a team's formation; teams that would have more than 100 ranks,
            or ranks over 1 km in more than 256 drones, have more columns.
        lane_spacing: Distance between columns, and between ranks, m.
        teams: Number of drones that fly north, and east; by default half each, north the larger
            half.
    """

    half_length: float = 100.0
    altitude_spread: float = 6.0
    lanes: int = field(default=10, metadata={"most": 10_000})
    lane_spacing: float = 15.0
    teams: tuple[int, int] | None = None


def _num_lanes(lanes: int, num_drones: int, largest: int, spacing: float) -> int:
    """Return the number of columns of a formation, more than wanted if it would be too deep.

    Args:
        lanes: Number that is wanted.
        num_drones: Number of all drones.
        largest: Number of drones of the larger team.
        spacing: Distance between ranks, m.
    """
    most = MAX_RANKS
    if num_drones > LARGE_SWARM and most * spacing > MAX_DEPTH:
        most = max(1, int(MAX_DEPTH / spacing))
    return max(lanes, -(-largest // most))


@register("task")
class Crossing(GoalFlight[CrossingConfig]):
    """Two teams cross one airspace at right angles.

    The first half of the drones flies north, from (0, -100) to (0, 100) m. The others fly east,
    from (-100, 0) to (100, 0) m. Teams start in formation, in flight, at an altitude of 40 m. Each
    drone has its own lane, with its goal straight ahead.

    Observation, Box(55) per drone with the defaults, in world axes (east, north, up): position,
    velocity, direction and distance of the goal, the nearest active drones, and the nearest
    obstacles. Drones and obstacles are relative to the drone, sorted by distance, and padded with
    zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 20 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms (see `GoalFlight` for all terms):

    - progress 5: decrease of the distance to the goal, m.
    - goal 50: 1 in the decision in which the drone reaches the goal.
    - conflict -500: number of drones whose separation falls below d_safe = 5 m.
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

    name = "crossing"
    has_absent = True
    needs_hover = False
    version = 2
    shirkers = (*GOAL_FLIGHT_SHIRKERS, "pass_closely")
    team_names = ("north", "east")
    # At -200, drones in conflict earn nine tenths of the pay of safe ones
    reward: ClassVar = {**REWARD_WEIGHTS, "conflict": -500.0}
    difficulties: ClassVar = {
        "easy": {"lane_spacing": 20.0, "altitude_spread": 2.0, **AIRSPACE_DIFFICULTIES["easy"]},
        "medium": AIRSPACE_DIFFICULTIES["medium"],
        "hard": {"lane_spacing": 12.0, "altitude_spread": 4.0, **AIRSPACE_DIFFICULTIES["hard"]},
        "extreme": {
            "lane_spacing": 12.0,
            "altitude_spread": 4.0,
            **AIRSPACE_DIFFICULTIES["extreme"],
        },
    }

    def __init__(self, config: CrossingConfig, context: TaskContext) -> None:
        """Check that the teams start separated, and set the arena.

        Raises:
            ValueError: If drones could start in conflict, outside the arena, or touching the
                ground.
        """
        super().__init__(config, context)
        require_margin(config)
        clear = clearance(config, context)
        if config.lane_spacing - 2 * config.jitter <= clear:
            raise ValueError(
                f"start positions may be in conflict: lane_spacing {config.lane_spacing:g} m "
                f"less twice jitter {config.jitter:g} m must exceed {clear:.3g} m (d_safe)"
            )
        drones = context.num_drones
        usual = ((drones + 1) // 2, drones // 2)
        self._num_north, east = team_sizes(config.teams, drones, usual)
        self.team[self._num_north :] = 1
        largest = max(self._num_north, east)
        self._lanes = _num_lanes(config.lanes, drones, largest, config.lane_spacing)
        self._half_length = config.half_length
        if self._lanes > config.lanes or drones > LARGE_SWARM:
            needed = min(largest, self._lanes) * config.lane_spacing / 2 + config.jitter + clear
            self._half_length = max(config.half_length, ROOM * needed)
        self._start, self._goal = self._places()
        # Depth and half width of the larger formation, m
        ranks = -(-largest // self._lanes)
        depth = (ranks - 1) * config.lane_spacing
        width = min(largest, self._lanes) * config.lane_spacing / 2
        # The corners of the two formations must not overlap
        if self._half_length <= width + config.jitter + clear:
            raise ValueError(
                f"half_length {config.half_length:g} m is too short for formations "
                f"{2 * width:g} m wide: the teams' starts would overlap; "
                f"lower lane_spacing, jitter or d_safe"
            )
        rise = config.altitude_spread / 2 + config.jitter
        if config.altitude - rise <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low "
                f"for altitude_spread {config.altitude_spread:g} m"
            )
        half_side = max(self._half_length + depth, width) + config.margin
        self.arena_low = np.array([-half_side, -half_side, 0.0])
        self.arena_high = np.array([half_side, half_side, config.altitude + rise + config.margin])

    @classmethod
    def forward_options(
        cls, airframes: Sequence[Airframe], values: Mapping[str, Any], kept: Mapping[str, Any]
    ) -> Mapping[str, Any]:
        """Return lanes as wide as the tightest turn; see the base class."""
        radius = tightest_turn(airframes)
        spacing = kept_number(kept, "lane_spacing", math.ceil(2 * radius))
        drones = int(values["num_drones"])
        largest = max(team_sizes(kept.get("teams"), drones, ((drones + 1) // 2, drones // 2)))
        lanes = int(kept_number(kept, "lanes", CrossingConfig.lanes))
        lanes = _num_lanes(lanes, drones, largest, spacing)
        width = min(largest, lanes) * spacing / 2
        half_length = kept_number(kept, "half_length", math.ceil(width + TURN_MARGIN * radius))
        own = {"lane_spacing": spacing, "half_length": half_length}
        return {**own, **forward_sizes(airframes, values, 2 * half_length)}

    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Return starts and goals, (N, 3) each, m, without altitudes and jitter."""
        drones, half_length = self.context.num_drones, self._half_length
        start, goal = np.zeros((2, drones, 3))
        # Flight axis and drones of each team
        teams = ((1, slice(0, self._num_north)), (0, slice(self._num_north, drones)))
        for axis, team in teams:
            aside, behind = self._formation(len(start[team]))
            start[team, axis] = -half_length - behind
            goal[team, axis] = half_length - behind
            start[team, 1 - axis] = aside
            goal[team, 1 - axis] = aside
        return start, goal

    def _formation(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return each drone's lateral and rearward offset from the centre of the first rank, m."""
        lanes = min(count, self._lanes)
        spacing = self.config.lane_spacing
        index = np.arange(count)
        aside = (index % lanes - (lanes - 1) / 2) * spacing
        behind = (index // lanes) * spacing
        return aside, behind

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts of both teams in formation, in flight."""
        config = self.config
        start, goal = self._start.copy(), self._goal.copy()
        height = config.altitude + config.altitude_spread * rng.uniform(-0.5, 0.5, len(start))
        start[:, 2] = height
        goal[:, 2] = height
        return self.launch(config.scattered(start, rng), goal, rng)
