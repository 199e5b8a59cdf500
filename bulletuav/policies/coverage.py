"""Policies for tasks with targets on the ground: where to hover high above a city.

Drones go to places that serve many targets: `centroid`, `hotspot`, `kmeans` and `oracle`.
"""

import math
from abc import abstractmethod

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.coverage_geometry import (
    best_responses,
    distances,
    farthest_first,
    greedy_coverage,
    kmeans,
    matched,
    nearest_left,
    ring,
)
from bulletuav.policies.planner import PathFollower
from bulletuav.policies.potential import INFLUENCE
from bulletuav.policies.voxels import cell_of, nearest_free
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

HIGHEST = 0.93
"""Height of the first drone, in heights of the ceiling: room for gusts"""
STEP_DOWN = 0.01
"""How much lower each next drone is, so that ways above the roofs do not meet; same unit"""
STEPS = 10
"""How many drones are lower than the one before, until the next one is highest again"""
PERIOD = 2.0
"""Time between looks at targets that move, s"""
TOLERANCE = 4.0
"""Distance by which a place moves before its drone does, m"""
HOTSPOT = 50.0
"""Radius of a hotspot, m: seen at 60 degrees or more from below the default ceiling"""
GRID = 25
"""How many places, about, the oracle tries along each side of a city"""


class Placement(PathFollower):
    """Flight of each living drone to a place of its own over the targets that count.

    Drones fly as high as the airspace allows and hover there: where buildings are columns, who
    rises loses nothing from sight.

    Places are made anew when an episode starts, when a drone is lost and, at most every PERIOD,
    when targets have moved. Those in or near a building give way to the nearest free air.

    Attributes:
        height: (N,) height of each drone's place, m.
        apart: Distance that places keep where there is room, m.
    """

    remembers = (*PathFollower.remembers, "_place", "_placed", "_targets")

    def __init__(self, aviary: Aviary) -> None:
        """Take the aviary to fly.

        Args:
            aviary: The worlds that it flies.

        Raises:
            ValueError: The task has no targets, or its action is not one of this policy.
        """
        task = aviary.task
        shape = aviary.alive.shape
        if not task.num_targets:
            raise ValueError(
                f"policy {self.name!r} places drones over a task's targets, and task "
                f"{task.name!r} has none: choose a task with users or ground to see"
            )
        super().__init__(aviary)
        steps_down = np.arange(shape[1]) % STEPS
        self.height = task.arena_high[2] * (HIGHEST - STEP_DOWN * steps_down)
        separation = getattr(task.config, "min_separation", 0.0)
        self.apart = float(max(separation, INFLUENCE * task.config.d_safe))
        self._every = max(1, round(PERIOD * aviary.options.decision_hz))
        self._place = np.zeros((*shape, 3))
        # What places were made for: living drones, and targets, infinite where they did not count.
        self._placed = np.zeros(shape, dtype=bool)
        self._targets = np.zeros((shape[0], task.num_targets, 3))

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Give the places (W, N, 3), m, made anew where they must be."""
        aviary = self.aviary
        scene = aviary.scene
        alive = aviary.alive
        counts = aviary.task.active_targets(scene)[..., None]
        targets = np.where(counts, aviary.task.targets(scene), np.inf)
        # Worlds where an episode starts or a drone was lost, and those where targets moved.
        started = alive & (self._count == 0)
        lost = alive != self._placed
        anew = (started | lost).any(axis=1)
        moved = (targets != self._targets).any(axis=(1, 2))
        moved &= aviary.steps % self._every == 0
        settle = (anew | moved) & alive.any(axis=1)
        for w in np.flatnonzero(settle).tolist():
            self._settle(w, swarm.position[w], targets[w], bool(anew[w]))
        return self._place

    def _settle(self, w: int, position: np.ndarray, targets: np.ndarray, anew: bool) -> None:
        """Make the places of world w, and forget the ways to those that have moved."""
        self._placed[w] = self.aviary.alive[w]
        self._targets[w] = targets
        flying = np.flatnonzero(self.aviary.alive[w])
        counts = np.isfinite(targets[:, 0])
        # Without targets drones stay where they are.
        flat = position[flying, :2]
        before = None if anew else self._place[w, flying, :2]
        if counts.any():
            flat = self.places(w, targets[counts], flat, before)
        high = np.column_stack([flat, self.height[flying]])
        place = np.array([self._free(w, over) for over in high])
        # Small moves of a place are not followed.
        move = np.linalg.norm(place - self._place[w, flying], axis=1)
        away = anew | (move > TOLERANCE)
        self._place[w, flying[away]] = place[away]
        self._count[w, flying[away]] = 0

    def _free(self, w: int, place: np.ndarray) -> np.ndarray:
        """Give the place (3,), m, or where it is not free the middle of the nearest free cell."""
        grid = self._grid(w)
        if grid.occupied.all():
            return place
        cell = nearest_free(grid, place)
        if cell == cell_of(grid, place):
            return place
        middle: np.ndarray = grid.origin + grid.size * (np.array(cell) + 0.5)
        return middle

    @abstractmethod
    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Choose where the K living drones of a world are to hover.

        Args:
            w: Index of the world.
            targets: (M, 3) targets that count, one or more, m.
            position: (K, 2) where the drones are, m.
            before: (K, 2) where they were to hover until now, m; None when they are placed for
                the first time, or are fewer now.

        Returns:
            (K, 2) places, m.
        """


@register("policy")
class Centroid(Placement):
    """Hovering over the centroid of the targets; several drones hover on a ring about it."""

    name = "centroid"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Share out the ring with the least sum of ways; see `Placement.places`."""
        task = self.aviary.task
        circle = ring(
            centre=targets[:, :2].mean(axis=0),
            count=len(position),
            apart=self.apart,
            low=task.arena_low[:2],
            high=task.arena_high[:2],
        )
        return matched(circle, position)


@register("policy")
class Hotspot(Placement):
    """Hovering over hotspots.

    These are the target with most others within HOTSPOT, then that with most of those left, and
    so on. In turn each drone takes the nearest one that is left.
    """

    name = "hotspot"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Choose as many hotspots as drones; see `Placement.places`."""
        points = targets[:, :2]
        distance = distances(points, points)
        # A hotspot serves the targets within its radius.
        near = (distance <= HOTSPOT).astype(float)
        hotspots = greedy_coverage(
            serves=near, distance=distance, places=points, count=len(position), apart=self.apart
        )
        return nearest_left(points[hotspots], position)


@register("policy")
class KMeans(Placement):
    """Hovering over the means of clusters of targets, one for each drone.

    Once placed, drones follow their clusters.
    """

    name = "kmeans"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Share out the means with the least sum of ways; see `Placement.places`."""
        points = targets[:, :2]
        start = farthest_first(points, len(position)) if before is None else before
        return matched(kmeans(points, start), position)


@register("policy")
class Oracle(Placement):
    """Hovering where it serves most.

    It knows how well the task's targets would be served (`Task.service_quality`).
    It asks from places all over the city, at the height of the lowest drone. That is what is in
    sight, and in tasks with a radio link how well it serves.
    """

    name = "oracle"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Take places greedily at first, then improve them; see `Placement.places`.

        Later a drone goes elsewhere only to serve what no other drone serves so well.
        """
        count = len(position)
        known = position if before is None else before
        tried = np.concatenate([known, self._grid_places(w)])
        serves = self._served(w, tried, targets)
        if before is None:
            chosen = greedy_coverage(
                serves=serves,
                distance=distances(tried, targets[:, :2]),
                places=tried,
                count=count,
                apart=self.apart,
            )
            return matched(tried[chosen], position)
        kept = best_responses(serves, tried, np.arange(count), self.apart)
        places: np.ndarray = tried[kept]
        return places

    def _grid_places(self, w: int) -> np.ndarray:
        """Give the middles (C, 2) of free cells, evenly over the city, m."""
        grid = self._grid(w)
        layer = int((self.height.min() - grid.origin[2]) // grid.size)
        free = ~grid.occupied[:, :, layer]
        # Every step-th cell on either axis.
        step = math.ceil((max(free.shape) - 2) / GRID)
        cells = np.argwhere(free)
        on_grid = cells % step == step // 2
        kept = cells[on_grid.all(axis=1)]
        middles: np.ndarray = grid.origin[:2] + grid.size * (kept + 0.5)
        return middles

    def _served(self, w: int, places: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Tell how well (C, M), 0 to 1, drones at places (C, 2) would serve targets (M, 3)."""
        start = np.insert(places, 2, self.height.min(), axis=1)
        # A line from each place to each target.
        from_places = np.repeat(start, len(targets), axis=0)
        to_targets = np.tile(targets, (len(places), 1))
        seen = self.aviary.line_of_sight(from_places, to_targets, w)
        in_sight = seen.reshape(len(places), len(targets))
        return self.aviary.task.service_quality(start, targets, in_sight)
