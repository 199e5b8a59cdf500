"""Task `coverage`: drones spread so that as much of the streets as possible is in line of sight of some drone."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.conflict.measures import offsets
from bulletuav.registry import register
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.families.urban import (
    DEFAULTS,
    URBAN_DIFFICULTIES,
    UrbanConfig,
    UrbanTask,
    check_share,
    ground_cells,
)
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.rewards.users import served
from bulletuav.tasks.targets import TargetTask

MOST_CELLS = 1e6  # of a raster


@dataclass(frozen=True)
class CoverageConfig(UrbanConfig):
    """Options of `coverage` beside those of cities, m.

    The ground outdoors is divided into squares of side `cell`; drones are not to be nearer to each other than
    `min_separation`; `wanted` is the share of the squares that is success.
    """

    d_safe: float = 2.0
    cell: float = 10.0
    wanted: float = 0.9
    height: tuple[float, float] = (20.0, 60.0)
    min_separation: float = 100.0


@reward
def close(drones_too_near: float) -> float:
    """Other drones nearer than `min_separation`."""
    return drones_too_near


@register("task")
class Coverage(UrbanTask[CoverageConfig], TargetTask[CoverageConfig]):
    """Spread over a city, apart from each other, and see the most of its streets.

    Observation, per drone, Box(29) with the defaults; `bulletuav tasks coverage` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer. The last number is the share of the squares that the drone itself sees.

    Action, per drone, by default `velocity`, Box(3) in [-1, 1]: velocity over max_speed, its norm limited to max_speed;
    10 decisions a second.

    Reward, per decision: covered 1 times the share of the ground outdoors that some drone sees (the middles of its squares,
    1.5 m up); close -5 for each other drone nearer than min_separation = 100 m; collision -10; out_of_bounds -10 (weights by
    name).

    End: terminated on contact of collision shapes, with an empty battery, and outside the city's square or above its
    ceiling; truncated after 300 decisions. Success: 90 % of the ground outdoors is covered.

    Difficulty, drones / city / irregularity: easy 3, urban, 0; medium 5, urban, 0.5; hard 8, dense, 0.5; extreme 16,
    high_rise, 1, min_separation 50 m; from medium on positions are
    noisy, hard adds wind, extreme everything, as in the shared airspace.
    """

    name = "coverage"
    defaults: ClassVar = {**DEFAULTS, "horizon": 300}
    difficulties: ClassVar = {
        **URBAN_DIFFICULTIES,
        "extreme": {**URBAN_DIFFICULTIES["extreme"], "min_separation": 50.0},
    }
    baseline = "kmeans"
    observation = ("position", "velocity", "battery", "neighbours", "seen_share")
    reward: ClassVar = {
        "covered": (served, 1.0),
        "close": (close, -5.0),
        "collision": -10.0,
        "out_of_bounds": -10.0,
    }
    ends = (collision, leaves_arena)

    def __init__(self, config: CoverageConfig, context: TaskContext):
        """Raises ValueError where the city leaves no room to fly, or its ground has no square outdoors."""
        super().__init__(config, context)
        check_share("wanted", config.wanted)
        if not 0 < config.cell <= min(city.side for city in self.town.cities):
            raise ValueError(
                f"cell is {config.cell:g} m: it must be above 0 and at most the side of the city"
            )
        widest = max(city.side for city in self.town.cities)
        if (widest / config.cell) ** 2 > MOST_CELLS:
            raise ValueError(
                f"cell is {config.cell:g} m: {(widest / config.cell) ** 2:.3g} squares on a side of {widest:g} m, at most "
                f"{MOST_CELLS:g} are possible; make it larger, or area smaller"
            )
        cells = [ground_cells(city, config.cell) for city in self.town.cities]
        if not all(map(len, cells)):
            raise ValueError(
                f"cell is {config.cell:g} m: the middle of no such square is outdoors; make it smaller"
            )
        self.num_targets = max(map(len, cells))
        # All layouts have as many rows: short lists repeat their first cell, and it does not count.
        self._cells = np.array(
            [
                np.concatenate([c, np.repeat(c[:1], self.num_targets - len(c), axis=0)])
                for c in cells
            ]
        )
        self._counts = np.array([np.arange(self.num_targets) < len(c) for c in cells])

    def targets(self, scene: Scene) -> np.ndarray:
        """The middles of the squares outdoors."""
        return self._cells[scene.layout]

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Those that do not only fill up a list."""
        return self._counts[scene.layout]

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """At rest, anywhere outdoors."""
        return self.town.hovering(rng, self.town.draw(rng), self.context.num_drones)

    def quantities(self) -> Mapping[str, Any]:
        """Tell the share of the ground in sight, and how many drones are too near."""
        return {"served": self.served, "drones_too_near": self._drones_too_near}

    def _drones_too_near(self, frame: Frame) -> np.ndarray:
        """Count the living drones nearer than `min_separation`, (W, N)."""
        near = np.linalg.norm(offsets(frame.after.position), axis=-1) < self.config.min_separation
        others = frame.alive[:, None] & ~np.eye(self.context.num_drones, dtype=bool)
        count: np.ndarray = (near & others).sum(axis=-1).astype(float)
        return count

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Tell whether the wanted share of the ground is covered."""
        return self.served(frame) >= self.config.wanted
