"""Task `converge`: drones on a circle, each flies to its antipode, all through the centre."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.registry import register
from bulletuav.tasks.families.airspace import (
    UNCERTAINTY,
    Airspace,
    AirspaceConfig,
    between_neighbours,
    circle_arena,
    clearance,
)
from bulletuav.tasks.frame import Spawn, TaskContext


@dataclass(frozen=True)
class ConvergeConfig(AirspaceConfig):
    """Options of `converge` beside those of every shared airspace, m: the circle's `radius`."""

    radius: float = 80.0


@register("task")
class Converge(Airspace[ConvergeConfig]):
    """Drones on a circle, evenly spread, each to its antipode through the centre: where large swarms meet at one point.

    Observation, per drone, Box(31) with the defaults; `bulletuav tasks converge` lists each number:
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`.

    Difficulty, drones / radius: easy 4, 80 m; medium 8, 80 m; hard 20, 80 m; extreme 100, 150 m.
    """

    name = "converge"
    difficulties: ClassVar = {
        "easy": {"num_drones": 4, **UNCERTAINTY["easy"]},
        "medium": UNCERTAINTY["medium"],
        "hard": {"num_drones": 20, **UNCERTAINTY["hard"]},
        "extreme": {"num_drones": 100, "radius": 150.0, **UNCERTAINTY["extreme"]},
    }

    def __init__(self, config: ConvergeConfig, context: TaskContext):
        """Raises ValueError where drones could start in conflict or in touch with the ground."""
        super().__init__(config, context)
        chord = 2 * config.radius * np.sin(np.pi / max(context.num_drones, 2))
        nearest, clear = between_neighbours(config, chord), clearance(config, context)
        if nearest <= clear:
            raise ValueError(
                f"start positions may be in conflict: on a circle of radius {config.radius:g} m with jitter "
                f"{config.jitter:g} m neighbours may be {nearest:.3g} m apart, more than {clear:.3g} m (d_safe) is needed"
            )
        self.arena_low, self.arena_high = circle_arena(config, context, config.radius)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """On the circle, in flight towards its centre."""
        angle = 2 * np.pi * np.arange(self.context.num_drones) / self.context.num_drones
        place = self.config.radius * np.stack(
            [np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1
        )
        height = np.array([0.0, 0.0, self.config.altitude])
        return self.launch(self.config.scattered(place + height, rng), height - place, rng)
