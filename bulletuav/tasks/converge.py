"""Task `converge`: drones on a circle, each flies to its antipode, all through the centre."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bulletuav.tasks.base import Spawn, TaskContext
from bulletuav.tasks.families.airspace import (
    UNCERTAINTY,
    Airspace,
    AirspaceConfig,
    between_neighbours,
    circle_arena,
    clearance,
)


@dataclass(frozen=True)
class ConvergeConfig(AirspaceConfig):
    """Options of `converge` beside those of every shared airspace, m: the circle's `radius`."""

    radius: float = 80.0


class Converge(Airspace):
    """Drones on a circle, evenly spread, each to its antipode through the centre: where large swarms meet at one point.

    Observation, per drone, Box(31) float32, clipped to its bounds (here for max_speed 20 and 8 drones):
      0  position x              m     [-110, 110]
      1  position y              m     [-110, 110]
      2  position z              m     [0, 70]
      3  velocity x              m/s   [-40, 40]
      4  velocity y              m/s   [-40, 40]
      5  velocity z              m/s   [-40, 40]
      6  goal direction x        1     [-1, 1]
      7  goal direction y        1     [-1, 1]
      8  goal direction z        1     [-1, 1]
      9  goal distance           m     [0, 318.904]
     10  neighbour 1 distance    m     [0, 318.904]
     11  neighbour 1 position x  m     [-220, 220]
     12  neighbour 1 position y  m     [-220, 220]
     13  neighbour 1 position z  m     [-70, 70]
     14  neighbour 1 velocity x  m/s   [-80, 80]
     15  neighbour 1 velocity y  m/s   [-80, 80]
     16  neighbour 1 velocity z  m/s   [-80, 80]
     17  neighbour 2 distance    m     [0, 318.904]
     18  neighbour 2 position x  m     [-220, 220]
     19  neighbour 2 position y  m     [-220, 220]
     20  neighbour 2 position z  m     [-70, 70]
     21  neighbour 2 velocity x  m/s   [-80, 80]
     22  neighbour 2 velocity y  m/s   [-80, 80]
     23  neighbour 2 velocity z  m/s   [-80, 80]
     24  neighbour 3 distance    m     [0, 318.904]
     25  neighbour 3 position x  m     [-220, 220]
     26  neighbour 3 position y  m     [-220, 220]
     27  neighbour 3 position z  m     [-70, 70]
     28  neighbour 3 velocity x  m/s   [-80, 80]
     29  neighbour 3 velocity y  m/s   [-80, 80]
     30  neighbour 3 velocity z  m/s   [-80, 80]
    World axes (east, north, up). Neighbours are the nearest living drones, nearest first, relative to the drone; zeros where
    there are fewer.

    Action, reward, end and what is uncertain: as in every shared airspace, see `Airspace`.

    Difficulty, drones / radius: easy 4, 80 m; medium 8, 80 m; hard 20, 80 m; extreme 100, 150 m.
    """

    name = "converge"
    Config = ConvergeConfig
    config: ConvergeConfig
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
