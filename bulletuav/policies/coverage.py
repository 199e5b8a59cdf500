"""Policies for tasks with targets: drones hover high above the city at places that serve many points on the ground."""

import math
from abc import abstractmethod

import numpy as np
from scipy.spatial.distance import cdist

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.astar import cell_of, nearest_free
from bulletuav.policies.coverage_geometry import (
    best_responses,
    farthest_first,
    greedy_coverage,
    kmeans,
    matched,
    nearest_left,
    ring,
)
from bulletuav.policies.planner import PathFollower
from bulletuav.policies.potential import INFLUENCE
from bulletuav.vehicle.swarm import Swarm

HIGHEST = 0.93  # of the ceiling: room for gusts
STEP_DOWN, STEPS = (
    0.01,
    10,
)  # of the ceiling, by which the next drone is lower, so that ways above the roofs do not meet
PERIOD = 2.0  # s, between looks at targets that move
TOLERANCE = 4.0  # m, by which a place moves before its drone does
HOTSPOT = 50.0  # m, radius: seen at 60 degrees or more from below the default ceiling
GRID = 25  # places, about, that the oracle tries along each side of a city


class Placement(PathFollower):
    """Each living drone to a place of its own over the targets that count, as high as the airspace allows, and hover there.

    Where buildings are columns, who rises loses nothing from sight. Places are made anew when an episode starts, when a
    drone is lost and, at most every PERIOD, when targets have moved. Those in or near a building give way to the nearest
    free air.
    """

    def __init__(self, aviary: Aviary):
        """Raises ValueError for a task without targets."""
        task, shape = aviary.task, aviary.alive.shape
        if not task.num_targets:
            raise ValueError(
                f"policy {self.name!r} places drones over a task's targets, and task {task.name!r} has none: "
                f"choose a task with users or ground to see"
            )
        super().__init__(aviary)
        self.height = task.arena_high[2] * (
            HIGHEST - STEP_DOWN * (np.arange(shape[1]) % STEPS)
        )  # (N,) m
        self.apart = float(
            max(getattr(task.config, "min_separation", 0.0), INFLUENCE * task.config.d_safe)
        )  # m
        self._every = max(1, round(PERIOD * aviary.options.decision_hz))
        self._place = np.zeros((*shape, 3))
        self._placed = np.zeros(shape, dtype=bool)  # which drones lived when places were made
        self._targets = np.zeros(
            (shape[0], task.num_targets, 3)
        )  # at that time; infinite where they did not count

    def goals(self, swarm: Swarm) -> np.ndarray:
        """The places."""
        aviary, scene, alive = self.aviary, self.aviary.scene, self.aviary.alive
        targets = np.where(
            aviary.task.active_targets(scene)[..., None], aviary.task.targets(scene), np.inf
        )
        anew = ((alive & (self._count == 0)) | (alive != self._placed)).any(axis=1)
        moved = (targets != self._targets).any(axis=(1, 2)) & (aviary.steps % self._every == 0)
        for w in np.flatnonzero((anew | moved) & alive.any(axis=1)).tolist():
            self._settle(w, swarm.position[w], targets[w], bool(anew[w]))
        return self._place

    def _settle(self, w: int, position: np.ndarray, targets: np.ndarray, anew: bool) -> None:
        """Make the places of world w, and forget the ways to those that have moved."""
        self._placed[w], self._targets[w] = self.aviary.alive[w], targets
        flying, active_targets = np.flatnonzero(self.aviary.alive[w]), np.isfinite(targets[:, 0])
        flat, before = position[flying, :2], None if anew else self._place[w, flying, :2]
        if active_targets.any():
            flat = self.places(w, targets[active_targets], flat, before)
        place = np.array(
            [self._free(w, over) for over in np.column_stack([flat, self.height[flying]])]
        )
        away = anew | (np.linalg.norm(place - self._place[w, flying], axis=1) > TOLERANCE)
        self._place[w, flying[away]], self._count[w, flying[away]] = place[away], 0

    def _free(self, w: int, place: np.ndarray) -> np.ndarray:
        """The place (3,), m, or where that is not free the middle of the nearest free cell."""
        grid = self._grid(w)
        if grid.occupied.all():
            return place
        cell = nearest_free(grid, place)
        return (
            place
            if cell == cell_of(grid, place)
            else grid.origin + grid.size * (np.array(cell) + 0.5)
        )

    @abstractmethod
    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """(K, 2) where in world w, m, K drones at `position` (K, 2) are to hover for targets (M, 3), one or more.

        `before` (K, 2): where they were to hover until now; None when they are placed for the first time, or are fewer now.
        """


class Centroid(Placement):
    """Over the centroid of the targets, several drones on a ring about it."""

    name = "centroid"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """The ring, with the least sum of ways there."""
        low, high = self.aviary.task.arena_low[:2], self.aviary.task.arena_high[:2]
        centroid = targets[:, :2].mean(axis=0)
        return matched(ring(centroid, len(position), self.apart, low, high), position)


class Hotspot(Placement):
    """Over hotspots: the target with most others within HOTSPOT, then that with most of those left, and so on.

    In turn each drone takes the nearest one that is left.
    """

    name = "hotspot"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """As many hotspots as drones."""
        points = targets[:, :2]
        distance = cdist(points, points)
        near = (distance <= HOTSPOT).astype(float)
        hotspots = greedy_coverage(near, distance, points, len(position), self.apart)
        return nearest_left(points[hotspots], position)


class KMeans(Placement):
    """Over the means of as many clusters of targets as there are drones; from then on they follow their clusters."""

    name = "kmeans"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """The means, with the least sum of ways there."""
        points = targets[:, :2]
        start = farthest_first(points, len(position)) if before is None else before
        return matched(kmeans(points, start), position)


class Oracle(Placement):
    """Where it is worth most: knows what the task's targets are worth (`Task.worth`) from places all over the city.

    That is what is in sight, and in tasks with a radio link how well it serves, at the height of the lowest drone.
    """

    name = "oracle"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, before: np.ndarray | None
    ) -> np.ndarray:
        """Taken greedily at first; from then on a drone goes elsewhere only to serve what no other drone serves so well."""
        count, grid = len(position), self._grid_places(w)
        tried = np.concatenate([position if before is None else before, grid])
        service_quality = self._worth(w, tried, targets)
        if before is not None:
            return tried[best_responses(service_quality, tried, np.arange(count), self.apart)]
        return matched(
            tried[
                greedy_coverage(
                    service_quality, cdist(tried, targets[:, :2]), tried, count, self.apart
                )
            ],
            position,
        )

    def _grid_places(self, w: int) -> np.ndarray:
        """(C, 2) middles of free cells, m."""
        grid = self._grid(w)
        free = ~grid.occupied[:, :, int((self.height.min() - grid.origin[2]) // grid.size)]
        step = math.ceil((max(free.shape) - 2) / GRID)
        cells = np.argwhere(free)
        return grid.origin[:2] + grid.size * (cells[(cells % step == step // 2).all(axis=1)] + 0.5)

    def _worth(self, w: int, places: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """(C, M) what targets (M, 3) are worth to a drone at places (C, 2), from 0 to 1."""
        start = np.insert(places, 2, self.height.min(), axis=1)
        seen = self.aviary.line_of_sight(
            np.repeat(start, len(targets), axis=0), np.tile(targets, (len(places), 1)), w
        )
        return self.aviary.task.service_quality(
            start, targets, seen.reshape(len(places), len(targets))
        )
