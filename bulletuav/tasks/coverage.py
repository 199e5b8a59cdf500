"""Task `coverage`: drones spread to see as much of a city's streets as possible."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.conflict.measures import pair_offsets
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.difficulties import service_difficulties
from bulletuav.tasks.parts.ground_cells import GroundCells
from bulletuav.tasks.parts.mean_service import SERVICE_SHIRKERS, MeanService
from bulletuav.tasks.parts.obstacle_field import (
    CityObstacleOptions,
    ObstacleField,
    ObstacleOptions,
)
from bulletuav.tasks.parts.presets import URBANMARL_COVERAGE
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS, check_fraction
from bulletuav.tasks.rewards.users import served
from bulletuav.tasks.targets import compute_seen_fraction, get_served_fraction


@dataclass(frozen=True)
class CoverageConfig(CityOptions, CityObstacleOptions, ObstacleOptions, TaskConfig):
    """Options of `coverage`, in addition to those of cities (`CityOptions`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        cell: Side of the squares into which the ground outdoors is divided, m.
        wanted: Fraction of covered squares, averaged over the episode, from which the task is
            successful.
        city: The city, see `CityOptions`, by default "dense": few places see much of it.
        height: Minimum and maximum height of starts, m.
        ceiling: Maximum height of the airspace, m: low enough that no place sees most of the city.
        min_separation: Separation that drones should keep from each other, m.
    """

    d_safe: float = 2.0
    cell: float = 10.0
    wanted: float = 0.43
    city: Any = "dense"
    height: tuple[float, float] = (20.0, 45.0)
    ceiling: float = 50.0
    min_separation: float = 100.0


@reward
def sight(seen_share: float) -> float:
    """Fraction of the squares that the drone itself sees."""
    return seen_share


@reward
def close(drones_too_near: float) -> float:
    """Count the other drones closer than `min_separation`."""
    return drones_too_near


@register("task")
class Coverage(Task[CoverageConfig]):
    """Drones spread over a city to see as much of its streets as possible.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. The ground outdoors
    is divided into squares of 10 m. A square is covered if at least one active drone sees its
    centre, 1.5 m above the ground.

    Observation, Box(29) per drone with the defaults, in world axes (east, north, up): position,
    velocity, battery charge, the nearest active drones, and the fraction of the squares that the
    drone itself sees. Neighbours are relative to the drone, sorted by distance, and padded with
    zeros.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 15 m/s. Its norm is limited to max_speed. There are 10 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - covered 1: fraction of the squares that are covered.
    - sight 0: fraction of the squares that the drone itself sees.
    - close -0.2: number of other drones closer than min_separation = 100 m.
    - conflict -100: number of drones whose separation falls below d_safe = 2 m.
    - collision -10: 1 on contact of collision shapes.
    - out_of_bounds -10: 1 outside the city's square or above its ceiling.

    End: terminated on contact, when the battery is empty, and outside the city's square or above
    its ceiling. Truncated after 600 decisions.

    Success: averaged over the episode, 43 % of the squares are covered (medium 55 %, hard
    62 %, extreme 65 %), and the drone had no conflict or collision.

    Preset urbanmarl: sizes and rates of UrbanMARL 0.3.1 (docs/explanation/radio_and_edge.md).
    """

    version = 2
    name = "coverage"
    defaults: ClassVar = {**URBAN_DEFAULTS, "horizon": 600}
    difficulties: ClassVar = service_difficulties(medium=0.55, hard=0.62, extreme=0.65)
    presets: ClassVar = {"urbanmarl": URBANMARL_COVERAGE}
    has_goals = False
    places = ("start",)
    baseline = "oracle"
    shirkers = SERVICE_SHIRKERS
    observation = ("position", "velocity", "battery", "neighbours", "seen_share")
    reward: ClassVar = {
        "covered": (served, 1.0),
        "sight": (sight, 0.0),
        "close": (close, -0.2),
        "conflict": -100.0,
        "collision": -10.0,
        "out_of_bounds": -10.0,
    }
    shows: ClassVar = {"served": "covered by all", "collision": "collisions"}
    ends = (collision, leaves_arena)

    def __init__(self, config: CoverageConfig, context: TaskContext) -> None:
        """Create the cities and divide their ground into squares.

        Raises:
            ValueError: If a city has no space to fly, or no square outdoors.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.safety = self.add(Safety(context.num_drones))
        self.city_layouts = add_city(self)
        check_fraction("wanted", config.wanted)
        self.mean_service = self.add(MeanService(self, self._served))
        self._cells = GroundCells(self.city_layouts, config.cell, self.city_layouts.cell_centres)
        self.num_targets = self._cells.count

    def targets(self, scene: Scene) -> np.ndarray:
        """Return the centres of the squares outdoors, (W, num_targets, 3) m."""
        return self._cells.centres(scene)

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Return which targets are squares rather than padding, (W, num_targets) bool."""
        return self._cells.active(scene)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts at rest outdoors."""
        layout = self.city_layouts.draw(rng)
        return self.city_layouts.hovering(rng, layout, self.context.num_drones)

    def quantities(self) -> Mapping[str, Any]:
        """Return the fractions of ground in sight, and the number of drones that are too close."""
        near = self._drones_too_near
        own = {"served": self._served, "seen_share": self._seen_share, "drones_too_near": near}
        return {**super().quantities(), **own}

    def _served(self, frame: Frame) -> np.ndarray:
        """Compute the fraction of squares seen by at least one active drone, (W, N)."""
        return get_served_fraction(self, frame)

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the infos of the city, and the covered fraction as "served"."""
        return {**super().info(frame), "served": self._served(frame)}

    def _seen_share(self, frame: Frame) -> np.ndarray:
        """Compute the fraction of squares that each drone sees, (W, N)."""
        return compute_seen_fraction(frame.seen, self.active_targets(frame.scene)[:, None])

    def _drones_too_near(self, frame: Frame) -> np.ndarray:
        """Count the other active drones closer than `min_separation`, (W, N)."""
        distance = np.linalg.norm(pair_offsets(frame.after.position), axis=-1)
        is_near = distance < self.config.min_separation
        is_other = frame.alive[:, None] & ~np.eye(self.context.num_drones, dtype=bool)
        count: np.ndarray = (is_near & is_other).sum(axis=-1).astype(float)
        return count

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether the required fraction of the ground is covered on average, (W, N) bool."""
        return self.mean_service.succeeded(frame)
