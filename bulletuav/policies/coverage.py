"""Policies for tasks with ground targets: hover positions high above a city.

The policies `centroid`, `hotspot`, `kmeans` and `oracle` place drones where they serve many
targets.
"""

import math
from abc import abstractmethod

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.coverage_geometry import (
    assign_greedily,
    assign_optimally,
    farthest_first,
    greedy_coverage,
    kmeans,
    local_search,
    pairwise_distances,
    ring_positions,
)
from bulletuav.policies.planner import PathFollower
from bulletuav.policies.potential import INFLUENCE
from bulletuav.policies.voxels import nearest_free, voxel_of
from bulletuav.registry import register
from bulletuav.vehicle.swarm import Swarm

MAX_HEIGHT_FRACTION = 0.93
"""Height of the first drone as a fraction of the ceiling; the rest is a margin for gusts"""
STEP_DOWN = 0.01
"""Height difference between consecutive drones as a fraction of the ceiling, so that their paths
above the roofs do not intersect"""
STEPS = 10
"""Number of distinct heights, after which the sequence repeats"""
PERIOD = 2.0
"""Minimum time between updates of the positions for moving targets, s"""
TOLERANCE = 4.0
"""Minimum displacement of a hover position that a drone follows, m"""
HOTSPOT = 50.0
"""Radius of a hotspot, m: its targets are seen at an elevation of 60 degrees or more from below
the default ceiling"""
GRID = 50
"""Approximate number of candidate positions of the oracle along each side of a city"""
MAX_RAYS = 1e6
"""Approximate number of lines of sight of the oracle, which has fewer candidates if targets are
many"""
RESTARTS = 8
"""Number of random selections that the oracle improves besides the greedy one"""


class Placement(PathFollower):
    """Base class of policies that send each active drone to a hover position above the targets.

    Drones fly as high as the airspace allows. Above column-shaped buildings a higher position never
    loses line of sight.

    Positions are recomputed when an episode starts, when a drone is lost and, at most once per
    PERIOD, when targets have moved. A position in or near a building is replaced by the nearest
    free cell.

    Attributes:
        height: (N,) hover height of each drone, m.
        min_spacing: Minimum distance between hover positions if space permits, m.
    """

    remembers = (*PathFollower.remembers, "_place", "_placed", "_targets")

    def __init__(self, aviary: Aviary) -> None:
        """Initialise the hover heights and spacing.

        Args:
            aviary: The worlds to control.

        Raises:
            ValueError: If the task has no targets, or the policy does not support the action type.
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
        self.height = task.arena_high[2] * (MAX_HEIGHT_FRACTION - STEP_DOWN * steps_down)
        separation = getattr(task.config, "min_separation", 0.0)
        self.min_spacing = float(max(separation, INFLUENCE * task.config.d_safe))
        self._every = max(1, round(PERIOD * aviary.options.decision_hz))
        self._place = np.zeros((*shape, 3))
        # Inputs of the last placement: active drones, and targets (infinite if inactive).
        self._placed = np.zeros(shape, dtype=bool)
        self._targets = np.zeros((shape[0], task.num_targets, 3))

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Return the hover positions (W, N, 3), m, and update outdated ones."""
        aviary = self.aviary
        scene = aviary.scene
        alive = aviary.alive
        counts = aviary.task.active_targets(scene)[..., None]
        targets = np.where(counts, aviary.task.targets(scene), np.inf)
        # Worlds in which an episode starts, a drone was lost, or targets moved.
        started = alive & (self._count == 0)
        lost = alive != self._placed
        reset = (started | lost).any(axis=1)
        moved = (targets != self._targets).any(axis=(1, 2))
        moved &= aviary.steps % self._every == 0
        outdated = (reset | moved) & alive.any(axis=1)
        for w in np.flatnonzero(outdated).tolist():
            self._update_places(w, swarm.position[w], targets[w], bool(reset[w]))
        return self._place

    def _update_places(
        self, w: int, position: np.ndarray, targets: np.ndarray, reset: bool
    ) -> None:
        """Update the hover positions of world w, and drop the paths to positions that moved."""
        self._placed[w] = self.aviary.alive[w]
        self._targets[w] = targets
        flying = np.flatnonzero(self.aviary.alive[w])
        counts = np.isfinite(targets[:, 0])
        # Without active targets, drones hover where they are.
        flat = position[flying, :2]
        previous = None if reset else self._place[w, flying, :2]
        if counts.any():
            flat = self.places(w, targets[counts], flat, previous)
        high = np.column_stack([flat, self.height[flying]])
        place = np.array([self._nearest_free_position(w, over) for over in high])
        # Ignore small displacements.
        move = np.linalg.norm(place - self._place[w, flying], axis=1)
        away = reset | (move > TOLERANCE)
        self._place[w, flying[away]] = place[away]
        self._count[w, flying[away]] = 0

    def _nearest_free_position(self, w: int, place: np.ndarray) -> np.ndarray:
        """Return the position (3,), m, or the centre of the nearest free cell if it is occupied."""
        grid = self._voxel_map(w)
        if grid.occupied.all():
            return place
        cell = nearest_free(grid, place)
        if cell == voxel_of(grid, place):
            return place
        middle: np.ndarray = grid.origin + grid.size * (np.array(cell) + 0.5)
        return middle

    @abstractmethod
    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Choose the hover positions of the K active drones of a world.

        Args:
            w: Index of the world.
            targets: (M, 3) active targets, at least one, m.
            position: (K, 2) positions of the drones, m.
            previous: (K, 2) previous hover positions, m; None for the first placement and after the
                loss of a drone.

        Returns:
            (K, 2) hover positions, m.
        """


@register("policy")
class Centroid(Placement):
    """Hover above the centroid of the targets; several drones hover on a ring around it."""

    name = "centroid"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Assign the ring positions with the minimum total distance; see `Placement.places`."""
        task = self.aviary.task
        circle = ring_positions(
            centre=targets[:, :2].mean(axis=0),
            count=len(position),
            min_spacing=self.min_spacing,
            low=task.arena_low[:2],
            high=task.arena_high[:2],
        )
        return assign_optimally(circle, position)


@register("policy")
class HotspotPolicy(Placement):
    """Hover above hotspots.

    The first hotspot is the target with the most other targets within HOTSPOT, the next is the
    target with the most remaining ones, and so on. Each drone in turn flies to the nearest
    unassigned hotspot.
    """

    name = "hotspot"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Choose one hotspot per drone; see `Placement.places`."""
        points = targets[:, :2]
        distance = pairwise_distances(points, points)
        near = (distance <= HOTSPOT).astype(float)
        hotspots = greedy_coverage(
            service=near,
            distance=distance,
            places=points,
            count=len(position),
            min_spacing=self.min_spacing,
        )
        return assign_greedily(points[hotspots], position)


@register("policy")
class KMeans(Placement):
    """Hover above the k-means centres of the targets, one cluster for each drone.

    After the first placement, drones follow their clusters.
    """

    name = "kmeans"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Assign the means with the minimum total distance; see `Placement.places`."""
        points = targets[:, :2]
        start = farthest_first(points, len(position)) if previous is None else previous
        return assign_optimally(kmeans(points, start), position)


@register("policy")
class Oracle(Placement):
    """Hover at the positions with the highest service quality.

    The policy queries `Task.service_quality` for candidate positions all over the city, at the
    height of the lowest drone. Service quality is line of sight, and in tasks with a radio link the
    quality of the link.
    """

    name = "oracle"

    def places(
        self, w: int, targets: np.ndarray, position: np.ndarray, previous: np.ndarray | None
    ) -> np.ndarray:
        """Choose positions by local search at first, then improve them; see `Placement.places`.

        Local search improves a greedy selection, and random ones, by the best responses of single
        drones until none moves. After the first placement, it starts from the present positions: a
        drone moves only if it then serves targets better than all other drones do.
        """
        count = len(position)
        known = position if previous is None else previous
        candidates = np.concatenate([known, self._grid_places(w, len(targets))])
        service = self._service_quality(w, candidates, targets)
        if previous is None:
            greedy = greedy_coverage(
                service=service,
                distance=pairwise_distances(candidates, targets[:, :2]),
                places=candidates,
                count=count,
                min_spacing=self.min_spacing,
            )
            # A constant seed: the same world has the same positions
            random = np.random.default_rng(0).integers(len(candidates), size=(RESTARTS, count))
            found = [
                local_search(service, candidates, start, self.min_spacing)
                for start in (greedy, *random)
            ]
            values = [service[taken].max(axis=0).sum() for taken in found]
            return assign_optimally(candidates[found[int(np.argmax(values))]], position)
        kept = local_search(service, candidates, np.arange(count), self.min_spacing)
        places: np.ndarray = candidates[kept]
        return places

    def _grid_places(self, w: int, num_targets: int) -> np.ndarray:
        """Return the centres (C, 2) of free cells on a regular grid over the city, m."""
        grid = self._voxel_map(w)
        layer = int((self.height.min() - grid.origin[2]) // grid.size)
        free = ~grid.occupied[:, :, layer]
        per_side = min(GRID, math.sqrt(MAX_RAYS / num_targets))
        step = math.ceil((max(free.shape) - 2) / per_side)
        cells = np.argwhere(free)
        on_grid = cells % step == step // 2
        kept = cells[on_grid.all(axis=1)]
        middles: np.ndarray = grid.origin[:2] + grid.size * (kept + 0.5)
        return middles

    def _service_quality(self, w: int, places: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the service quality (C, M), 0 to 1, of targets (M, 3) from positions (C, 2)."""
        start = np.insert(places, 2, self.height.min(), axis=1)
        from_places = np.repeat(start, len(targets), axis=0)
        to_targets = np.tile(targets, (len(places), 1))
        seen = self.aviary.line_of_sight(from_places, to_targets, w)
        in_sight = seen.reshape(len(places), len(targets))
        return self.aviary.task.service_quality(start, targets, in_sight)
