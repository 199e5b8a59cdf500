"""Task `patrol`: drones visit all of a city again and again, and charge their batteries."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.ends import collision, leaves_arena
from bulletuav.tasks.frame import Frame, Scene, Spawn, TaskContext
from bulletuav.tasks.ingredients import reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.city_layouts import CityOptions, add_city
from bulletuav.tasks.parts.difficulties import SERVICE_DRONES, URBAN_DIFFICULTIES
from bulletuav.tasks.parts.ground_cells import GroundCells
from bulletuav.tasks.parts.obstacle_field import (
    CityObstacleOptions,
    ObstacleField,
    ObstacleOptions,
)
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.urban import URBAN_DEFAULTS

JUDGED_FRACTION = 0.5
"""Fraction of the episode, its last part, over which the worst idleness is judged"""


@dataclass(frozen=True)
class PatrolConfig(CityOptions, CityObstacleOptions, ObstacleOptions, TaskConfig):
    """Options of `patrol`, in addition to those of cities (`CityOptions`).

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        cell: Side of the squares into which the ground is divided, m. The viewpoint of a square is
            the place for a drone outdoors that is nearest to its centre.
        visit_radius: Maximum horizontal distance from the viewpoint of a square at which a drone
            that sees it visits the square, m.
        max_idleness: Time without visit that no square may exceed in the second half of the
            episode, s; the reward of a square falls to zero in that time.
        area: Side of the city's square, or its lengths along x and y, m.
        height: Minimum and maximum height of starts, m.
        ceiling: Maximum height of the airspace, m.
        charging_pads: Number of charging pads, or their positions, see `CityOptions`.
    """

    d_safe: float = 2.0
    cell: float = 30.0
    visit_radius: float = 20.0
    max_idleness: float = 180.0
    area: float | tuple[float, float] = 240.0
    height: tuple[float, float] = (20.0, 45.0)
    ceiling: float = 50.0
    charging_pads: Any = 2


@reward
def freshness(mean_freshness: float) -> float:
    """Mean over the squares of 1 - idleness / max_idleness, at least 0 each."""
    return mean_freshness


@reward
def overdue(is_overdue: bool) -> float:
    """1 while the idleness of any square is above max_idleness."""
    return 1.0 if is_overdue else 0.0


@reward
def visits(visited: float) -> float:
    """Idleness that the drone itself ends by its visits, as a fraction of that of all squares.

    The idleness of a square counts up to max_idleness. Drones that visit it together share it.
    """
    return visited


@reward
def empty(depleted: bool) -> float:
    """1 when the battery is empty."""
    return 1.0 if depleted else 0.0


@register("task")
class Patrol(Task[PatrolConfig]):
    """Drones patrol a city so that no place stays unvisited for long, and charge at pads.

    Drones start at rest at random positions outdoors, at heights of 20 to 45 m. The ground of a
    city of 240 m is divided into squares of 30 m, each with a viewpoint outdoors. A drone visits a
    square if it sees the viewpoint and is within 20 m of it horizontally. The idleness of a square
    is the time since the last visit, 0 at the start. A battery lasts for two minutes of hover. 2
    pads on the ground charge one drone each in half a minute, see `ChargingPads`.

    Observation, Box(77) per drone with the defaults, in world axes (east, north, up): position,
    velocity, battery charge, idleness (the mean of all squares, then horizontal offset and idleness
    of the most idle square and of the 12 nearest ones, shared by all drones), the nearest active
    drones, and the pads. All are relative to the drone, and sorted by distance.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 12 m/s. Its norm is limited to max_speed. There are 2 decisions a second.

    Reward per decision, the weighted sum of these terms:

    - freshness 1: 1 - idleness / max_idleness, at least 0, averaged over the squares.
    - overdue -0.25: 1 while the idleness of any square is above max_idleness.
    - visits 0: idleness that ends by visits of the drone itself, divided by max_idleness and by the
      number of squares.
    - empty -100: 1 when the battery is empty.
    - conflict -100: number of drones whose separation falls below d_safe = 2 m.
    - collision -100: 1 on contact of collision shapes; drones may stand on the ground.
    - out_of_bounds -100: 1 outside the city's square or above its ceiling.

    End: terminated on contact, when the battery is empty, and outside the city's square or above
    its ceiling. Truncated after 600 decisions.

    Success: in the second half of the episode, no idleness exceeds max_idleness = 180 s (medium
    142 s, hard 115 s, extreme 110 s), all drones fly at the end, and the drone had no conflict or
    collision.

    Infos: `idleness`, mean over the squares; `average_idleness`, its mean over the episode, and
    `worst_idleness`, the maximum in its second half, s (Machado et al. 2002, Multi-agent
    patrolling; Portugal and Rocha 2013, Multi-robot patrolling algorithms).
    """

    name = "patrol"
    defaults: ClassVar = {
        **URBAN_DEFAULTS,
        "decision_hz": 2,
        "horizon": 600,
        "max_speed": 12.0,
        "battery_capacity": 2.4,
    }
    difficulties: ClassVar = {
        "easy": URBAN_DIFFICULTIES["easy"],
        **{
            name: {
                **URBAN_DIFFICULTIES[name],
                "city": "dense" if name == "hard" else "urban",
                "num_drones": SERVICE_DRONES[name],
                "charging_pads": pads,
                "max_idleness": limit,
            }
            for name, pads, limit in (
                ("medium", 3, 142.0),
                ("hard", 4, 115.0),
                ("extreme", 4, 110.0),
            )
        },
    }
    has_goals = False
    places = ("start",)
    baseline = "patrol_reactive"
    oracle = "patrol_oracle"
    shirkers = (
        "patrol_rest",
        "patrol_reckless",
        "patrol_half",
        "patrol_by_one",
        "patrol_blind",
    )
    observation = ("position", "velocity", "battery", "idleness", "neighbours")
    reward: ClassVar = {
        "freshness": (freshness, 1.0),
        "overdue": (overdue, -0.25),
        "visits": (visits, 0.0),
        "empty": (empty, -100.0),
        "conflict": -100.0,
        "collision": -100.0,
        "out_of_bounds": -100.0,
    }
    # The visits of each drone teach it to move
    training_weights: ClassVar = {
        "freshness": 0.1,
        "overdue": -0.02,
        "visits": 10.0,
        "empty": -2.0,
        "conflict": -2.0,
        "collision": -2.0,
        "out_of_bounds": -2.0,
    }
    shows: ClassVar = {
        "success": "success",
        "idleness": "mean idleness (s)",
        "worst_idleness": "worst idleness (s)",
        "charge": "charge",
        "collision": "collisions",
    }
    ends = (collision, leaves_arena)

    def __init__(self, config: PatrolConfig, context: TaskContext) -> None:
        """Create the cities, and find the viewpoints of the squares of their ground.

        Raises:
            ValueError: If a city has no space to fly, or no square outdoors, or an option is 0.
            FileNotFoundError: If the city's file does not exist.
        """
        super().__init__(config, context)
        self.add(ObstacleField(self))
        self.safety = self.add(Safety(context.num_drones))
        self.city_layouts = add_city(self)
        for name in ("visit_radius", "max_idleness"):
            if not getattr(config, name) > 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        self._cells = GroundCells(self.city_layouts, config.cell, self.city_layouts.viewpoints)
        self.num_targets = self._cells.count

    def targets(self, scene: Scene) -> np.ndarray:
        """Return the viewpoints of the squares, (W, num_targets, 3) m."""
        return self._cells.centres(scene)

    def active_targets(self, scene: Scene) -> np.ndarray:
        """Return which targets are squares rather than padding, (W, num_targets) bool."""
        return self._cells.active(scene)

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw starts at rest outdoors."""
        layout = self.city_layouts.draw(rng)
        return self.city_layouts.hovering(rng, layout, self.context.num_drones)

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory.

        Returns:
            "idleness" of each square, s; "visited", see the term `visits`, of each drone;
            "idleness_sum", sum of the mean idleness of all decisions; "worst_idleness", s.
        """
        own = {"idleness": (self.num_targets,), "visited": (self.context.num_drones,)}
        return {**super().memory(), **own, "idleness_sum": (), "worst_idleness": ()}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Advance the idleness of the squares, and end that of visited ones."""
        super().update_memory(frame, rngs)
        memory, scene = frame.scene.memory, frame.scene
        cells = (self.targets(scene), self.active_targets(scene))
        limits = (float(self.config.visit_radius), float(self.config.max_idleness))
        drones = (frame.after.position, frame.seen)
        flying: np.ndarray = np.logical_or.reduce(frame.alive, axis=1)
        idleness, period = memory["idleness"], self.context.period
        visit(*drones, flying, *cells, *limits, period, idleness, memory["visited"])
        memory["idleness_sum"][flying] += self._mean_idleness(frame)[flying]
        is_judged = flying & (frame.time >= (1 - JUDGED_FRACTION) * self.context.duration)
        worst = np.maximum(memory["worst_idleness"], idleness.max(axis=1))
        np.copyto(memory["worst_idleness"], worst, where=is_judged)

    def _mean_idleness(self, frame: Frame) -> np.ndarray:
        """Return the mean idleness of the squares of each world, (W,) s."""
        count = self.active_targets(frame.scene).sum(axis=1)
        mean: np.ndarray = frame.scene.memory["idleness"].sum(axis=1) / count
        return mean

    def _freshness(self, frame: Frame) -> np.ndarray:
        """Return the mean of 1 - idleness / max_idleness, at least 0 each, (W, N)."""
        left = 1 - frame.scene.memory["idleness"] / self.config.max_idleness
        active = self.active_targets(frame.scene)
        total = np.where(active, np.maximum(left, 0.0), 0.0).sum(axis=1)
        mean: np.ndarray = (total / active.sum(axis=1))[:, None] + np.zeros(frame.alive.shape)
        return mean

    def _is_overdue(self, frame: Frame) -> np.ndarray:
        """Return whether the idleness of any square is above max_idleness, (W, N) bool."""
        worst = frame.scene.memory["idleness"].max(axis=1)
        return np.broadcast_to((worst > self.config.max_idleness)[:, None], frame.alive.shape)

    def quantities(self) -> Mapping[str, Any]:
        """Return the freshness and whether any square is overdue, for the reward."""
        own = {"mean_freshness": self._freshness, "is_overdue": self._is_overdue}
        return {**super().quantities(), **own}

    def succeeded(self, frame: Frame) -> np.ndarray:
        """Return whether squares were visited in time and all drones still fly, (W, N) bool."""
        is_in_time = frame.scene.memory["worst_idleness"] <= self.config.max_idleness
        flies = frame.alive & ~frame.collision & ~frame.depleted & ~self.outside(frame)
        is_done = frame.last & is_in_time & flies.all(axis=1)
        success: np.ndarray = is_done[:, None] & flies
        return success

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the infos of the city and the pads, and the idleness, s, the same for all drones.

        Returns:
            "idleness", mean over the squares; "average_idleness", its mean over the episode so far;
            "worst_idleness", maximum in the second half of the episode so far.
        """
        memory, nothing = frame.scene.memory, np.zeros(frame.alive.shape)
        decisions = np.maximum(frame.time / self.context.period, 1)
        own = {
            "idleness": self._mean_idleness(frame),
            "average_idleness": memory["idleness_sum"] / decisions,
            "worst_idleness": memory["worst_idleness"],
        }
        infos = {name: values[:, None] + nothing for name, values in own.items()}
        return {**super().info(frame), **infos}


@func
def _is_at(
    position: np.ndarray, seen: np.ndarray, cells: np.ndarray, radius: float, w: int, i: int, j: int
) -> bool:
    """Return True if drone i of world w sees square j, and is near enough to visit it."""
    east, north = position[w, i, 0] - cells[w, j, 0], position[w, i, 1] - cells[w, j, 1]
    return bool(seen[w, i, j] and east * east + north * north <= radius * radius)


@kernel
def visit(
    position: np.ndarray,
    seen: np.ndarray,
    flying: np.ndarray,
    cells: np.ndarray,
    active: np.ndarray,
    radius: float,
    max_idleness: float,
    period: float,
    idleness: np.ndarray,
    visited: np.ndarray,
) -> None:
    """Advance the idleness of squares by a decision, and end that of squares that are visited.

    Args:
        position: (W, N, 3) positions of the drones, m.
        seen: (W, N, U) bool, which squares are in sight of drones that flew the decision.
        flying: (W,) bool, worlds that flew the decision.
        cells: (W, U, 3) viewpoints of the squares, m.
        active: (W, U) bool, which of them count.
        radius: Maximum horizontal distance of a visit, m.
        max_idleness: Idleness up to which `visited` counts it, s.
        period: Duration of the decision, s.
        idleness: (W, U) idleness, s; updated.
        visited: (W, N) idleness that each drone ended, as a fraction of `max_idleness` of all
            squares; written.
    """
    for w in range(position.shape[0]):
        if not flying[w]:
            continue
        count = 0
        for j in range(cells.shape[1]):
            count += 1 if active[w, j] else 0
        for i in range(position.shape[1]):
            visited[w, i] = 0.0
        for j in range(cells.shape[1]):
            if not active[w, j]:
                continue
            idleness[w, j] += period
            visitors = 0
            for i in range(position.shape[1]):
                visitors += 1 if _is_at(position, seen, cells, radius, w, i, j) else 0
            if visitors == 0:
                continue
            ended = min(idleness[w, j], max_idleness) / (max_idleness * count * visitors)
            for i in range(position.shape[1]):
                if _is_at(position, seen, cells, radius, w, i, j):
                    visited[w, i] += ended
            idleness[w, j] = 0.0
