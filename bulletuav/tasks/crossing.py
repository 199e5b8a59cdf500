"""Task `crossing`: two teams cross one airspace at right angles."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.families.airspace import UNCERTAINTY, Airspace, AirspaceConfig, clearance
from bulletuav.tasks.frame import Spawn, TaskContext


@dataclass(frozen=True)
class CrossingConfig(AirspaceConfig):
    """Options of `crossing` beside those of every shared airspace, m.

    Teams start `half_length` from the centre in formations of `lanes` columns, `lane_spacing` apart sideways, in ranks as
    far behind each other, at `altitude` plus or minus half `altitude_spread`; start positions vary by up to `jitter` on each
    axis. Drones start at a speed drawn from `start_speed` towards their goals.
    """

    half_length: float = 100.0
    altitude_spread: float = 6.0
    lanes: int = field(default=10, metadata={"most": 10_000})
    lane_spacing: float = 15.0


@register("task")
class Crossing(Airspace[CrossingConfig]):
    """Two teams at right angles through one airspace: (0, -100) to (0, 100) and (-100, 0) to (100, 0).

    The first half of the drones flies north, the others east; each has its lane and its own goal, straight ahead.

    Observation, per drone, Box(31) with the defaults; `bulletuav tasks crossing` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`.

    Difficulty, drones / lane spacing / altitude spread: easy 4, 20 m, 10 m; medium 8, 15 m, 6 m; hard 20, 12 m, 4 m;
    extreme 100, 12 m, 4 m.
    """

    name = "crossing"
    difficulties: ClassVar = {
        "easy": {
            "num_drones": 4,
            "lane_spacing": 20.0,
            "altitude_spread": 10.0,
            **UNCERTAINTY["easy"],
        },
        "medium": UNCERTAINTY["medium"],
        "hard": {
            "num_drones": 20,
            "lane_spacing": 12.0,
            "altitude_spread": 4.0,
            **UNCERTAINTY["hard"],
        },
        "extreme": {
            "num_drones": 100,
            "lane_spacing": 12.0,
            "altitude_spread": 4.0,
            **UNCERTAINTY["extreme"],
        },
    }

    def __init__(self, config: CrossingConfig, context: TaskContext):
        """Raises ValueError where drones could start in conflict, outside the arena or in touch with the ground."""
        super().__init__(config, context)
        clear = clearance(config, context)
        if config.lane_spacing - 2 * config.jitter <= clear:
            raise ValueError(
                f"start positions may be in conflict: lane_spacing {config.lane_spacing:g} m less twice jitter "
                f"{config.jitter:g} m must exceed {clear:.3g} m (d_safe)"
            )
        self._north = (context.num_drones + 1) // 2
        ranks = -(-self._north // config.lanes)
        depth = (ranks - 1) * config.lane_spacing
        width = min(self._north, config.lanes) * config.lane_spacing / 2
        if config.half_length <= width + config.jitter + clear:
            raise ValueError(
                f"half_length {config.half_length:g} m is too short for formations {2 * width:g} m wide: the teams would "
                f"start in each other; lower lane_spacing, jitter or d_safe"
            )
        rise = config.altitude_spread / 2 + config.jitter
        if config.altitude - rise <= context.collision_radius:
            raise ValueError(
                f"altitude {config.altitude:g} m is too low for altitude_spread {config.altitude_spread:g} m"
            )
        reach = max(config.half_length + depth, width) + config.margin
        self.arena_low = np.array([-reach, -reach, 0.0])
        self.arena_high = np.array([reach, reach, config.altitude + rise + config.margin])

    def _formation(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Sideways and backward places of a team in its formation, m."""
        lanes, spacing = min(count, self.config.lanes), self.config.lane_spacing
        index = np.arange(count)
        return (index % lanes - (lanes - 1) / 2) * spacing, (index // lanes) * spacing

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Both teams in formation, in flight."""
        config, n = self.config, self.context.num_drones
        start, goal = np.zeros((n, 3)), np.zeros((n, 3))
        for axis, team in ((1, slice(0, self._north)), (0, slice(self._north, n))):
            side, back = self._formation(len(start[team]))
            start[team, axis], goal[team, axis] = (
                -config.half_length - back,
                config.half_length - back,
            )
            start[team, 1 - axis] = goal[team, 1 - axis] = side
        start[:, 2] = goal[:, 2] = config.altitude + config.altitude_spread * rng.uniform(
            -0.5, 0.5, n
        )
        return self.launch(config.scattered(start, rng), goal, rng)
