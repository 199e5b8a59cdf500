"""Policies that patrol a city and charge their batteries at pads.

References:
    A. Machado, G. Ramalho, J.-D. Zucker, A. Drogoul, Multi-agent patrolling: an empirical analysis
    of alternative architectures (2002): conscientious reactive agents.
    Y. Chevaleyre, Theoretical analysis of the multi-agent patrolling problem (2004): the cyclic
    strategy on a tour of a travelling salesman.
"""

import math
from abc import abstractmethod
from typing import ClassVar

import numpy as np

from bulletuav.envs.aviary import Aviary
from bulletuav.policies.base import require_supported_task
from bulletuav.policies.coverage_geometry import pairwise_distances
from bulletuav.policies.planner import PathFollower
from bulletuav.policies.readings import require_blocks, unpack_blocks
from bulletuav.registry import register
from bulletuav.tasks.observations.neighbours import PER_NEIGHBOUR
from bulletuav.tasks.observations.observer import Observation
from bulletuav.tasks.parts.charging_pads import has_pads
from bulletuav.tasks.patrol import Patrol
from bulletuav.vehicle.swarm import Swarm

LEVELS = (0.93, 0.88, 0.83, 0.78)
"""Heights of flight of successive drones as fractions of the ceiling: farther apart than d_safe"""
PAD_HEIGHT = 0.5
"""Height above a pad at which drones charge, as a fraction of the option `pad_height`"""
EXTRA_TIME = 2.0
"""Time that turning to a square takes, s, in addition to the flight at CRUISE"""
CRUISE = 10.0
"""Mean speed between squares, m/s"""
ARRIVED = 5.0
"""Horizontal distance from a square's viewpoint at which a drone chooses the next one, m"""
LOW_CHARGE = 0.25
"""Charge at which drones fly to a pad that is not free, and wait"""
GOOD_CHARGES = (0.4, 0.5, 0.6)
"""Charges at which successive drones fly to a free pad: different ones, so that they take turns"""
FULL_CHARGE = 0.97
"""Charge at which drones leave a pad"""
NEEDED = ("position", "battery", "idleness", "neighbours", "pads")
"""Observation blocks that the policies read"""
PER_PAD, PER_SQUARE = 4, 3
"""Numbers of a pad and of a square in observations"""
PATROLS, CHARGES = 0, 1
"""Modes of a drone"""


class PatrolPolicy(PathFollower):
    """Base class of policies that visit squares, and fly to a pad when their charge is low.

    Decisions use the observations only; the flight to a square or a pad uses the map of the city,
    and ORCA. Each drone flies at a height of its own, above most buildings.

    Attributes:
        task: The task.
        charges: Whether the drones charge.
        seen: Observed blocks, (W, N, width) by name.
    """

    remembers = (*PathFollower.remembers, "_mode", "_target", "_square")
    charges: ClassVar[bool] = True

    def __init__(self, aviary: Aviary) -> None:
        """Check the task and its observation; see `Policy`.

        Raises:
            ValueError: If the task is another one, or the observation lacks a block.
        """
        super().__init__(aviary)
        self.task = require_supported_task(self, Patrol)
        if not has_pads(self.task.config):
            raise ValueError(
                f"policy {self.name!r} charges at pads, and there are none: set charging_pads to 1 "
                f"or more"
            )
        require_blocks(self.name, aviary, NEEDED)
        shape = aviary.alive.shape
        levels = np.array(LEVELS)[np.arange(shape[1]) % len(LEVELS)]
        self.height = levels * self.task.arena_high[2]
        self.seen: dict[str, np.ndarray] = {}
        self._mode = np.full(shape, PATROLS)
        # Destinations of the paths, m, and the squares that drones fly to, horizontally
        self._target = np.zeros((*shape, 3))
        self._square = np.full((*shape, 2), np.nan)

    def reset(self, mask: np.ndarray) -> None:
        """Let the drones of the worlds in `mask` (W,) choose squares; see `Policy.reset`."""
        super().reset(mask)
        self._mode[mask] = PATROLS
        self._square[mask] = np.nan

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Choose actions; see `Policy.act`."""
        self.seen = unpack_blocks(self.aviary, observations)
        return super().act(observations, swarm)

    def goals(self, swarm: Swarm) -> np.ndarray:
        """Return squares or pads to fly to, (W, N, 3) m; see `PathFollower.goals`."""
        here = self.seen["position"][..., :2]
        for w, i in np.argwhere(self.aviary.alive).tolist():
            # Drones turn where they are slow: after a fast turn they would drift into buildings
            has_arrived = not math.dist(here[w, i], self._square[w, i]) > ARRIVED
            if self._mode[w, i] == CHARGES or has_arrived or np.isnan(self._square[w, i, 0]):
                self._mode[w, i] = self._choose_mode(w, i)
                if self._mode[w, i] == PATROLS:
                    self._square[w, i] = self.next_square(w, i, here[w, i])
            place = (
                self._pad_place(w, i, swarm.position[w, i])
                if self._mode[w, i] == CHARGES
                else self._square_place(w, i)
            )
            if math.dist(place, self._target[w, i]) > 1.0 or self._count[w, i] == 0:
                self._target[w, i] = place
                self._count[w, i] = 0
        return self._target

    def _choose_mode(self, w: int, i: int) -> int:
        """Return whether a drone patrols or charges."""
        if not self.charges:
            return PATROLS
        charge = float(self.seen["battery"][w, i, 0])
        if self._mode[w, i] == CHARGES:
            return CHARGES if charge < FULL_CHARGE else PATROLS
        is_free = bool((self._pads(w, i)[:, 3] == 0).any())
        enough = GOOD_CHARGES[i % len(GOOD_CHARGES)] if is_free else LOW_CHARGE
        return CHARGES if charge < enough else PATROLS

    def _pads(self, w: int, i: int) -> np.ndarray:
        """Return the observed pads (K, 4): offset, m, and whether it charges another drone."""
        pads: np.ndarray = self.seen["pads"][w, i, :-1].reshape(-1, PER_PAD)
        return pads

    def _pad_place(self, w: int, i: int, position: np.ndarray) -> np.ndarray:
        """Return the place above the nearest free pad, or one high above it to wait there."""
        pads = self._pads(w, i)
        free = np.flatnonzero(pads[:, 3] == 0)
        pad = position + pads[free[0] if len(free) else 0, :3]
        height = PAD_HEIGHT * self.task.config.pad_height if len(free) else self.height[i]
        place: np.ndarray = pad + np.array([0.0, 0.0, height])
        return place

    def _square_place(self, w: int, i: int) -> np.ndarray:
        """Return the place above the square to visit, (3,) m."""
        return np.append(self._square[w, i], self.height[i])

    def squares(self, w: int, i: int) -> np.ndarray:
        """Return the observed squares (K, 3): horizontal offset, m, and idleness, s."""
        squares: np.ndarray = self.seen["idleness"][w, i, 1:].reshape(-1, PER_SQUARE)
        return squares

    @abstractmethod
    def next_square(self, w: int, i: int, here: np.ndarray) -> np.ndarray:
        """Choose the next square of drone i in world w.

        Args:
            w: Index of the world.
            i: Index of the drone.
            here: (2,) horizontal position of the drone, as measured, m.

        Returns:
            (2,) horizontal position of its centre, m.
        """


@register("policy")
class PatrolReactive(PatrolPolicy):
    """Visit the observed square with the most idleness for the time that the flight takes.

    Squares that are nearer to another observed drone are left to it, except for the most idle one
    of all if no drone is nearer.
    """

    name = "patrol_reactive"

    def next_square(self, w: int, i: int, here: np.ndarray) -> np.ndarray:
        """Choose the square of the highest idleness per time; see `PatrolPolicy.next_square`."""
        squares = self.squares(w, i)
        distance = np.linalg.norm(squares[:, :2], axis=1)
        value = self.idleness(w, i, squares) ** 2 / (distance / CRUISE + EXTRA_TIME)
        others = self.others(w, i)
        if len(others):
            nearest = pairwise_distances(squares[:, :2], others).min(axis=1)
            value = np.where(nearest < distance, 0.5 * value, value)
        # The present square was just visited
        value = np.where(distance < ARRIVED, 0.0, value)
        chosen: np.ndarray = here + squares[int(value.argmax()), :2]
        return chosen

    def others(self, w: int, i: int) -> np.ndarray:
        """Return the horizontal offsets (M, 2) of the observed drones, m."""
        others = self.seen["neighbours"][w, i].reshape(-1, PER_NEIGHBOUR)
        offset: np.ndarray = others[others[:, 0] > 0][:, 1:3]
        return offset

    def idleness(self, w: int, i: int, squares: np.ndarray) -> np.ndarray:
        """Return the idleness (K,) of the squares by which drones choose, s."""
        idle: np.ndarray = squares[:, 2]
        return idle


@register("policy")
class PatrolCyclic(PatrolPolicy):
    """Fly one behind the other on a short tour of all squares.

    The tour is that of the nearest neighbour, improved by 2-opt. It is computed from the positions
    of all squares, which are not observed. After charging, a drone continues with its next square.
    """

    name = "patrol_cyclic"
    remembers = (*PatrolPolicy.remembers, "_stop")

    def __init__(self, aviary: Aviary) -> None:
        """Allocate the tours; see `Policy`."""
        super().__init__(aviary)
        self._tours: dict[int, np.ndarray] = {}
        # Index of each drone's present square on the tour; -1 before the first
        self._stop = np.full(aviary.alive.shape, -1)

    def reset(self, mask: np.ndarray) -> None:
        """Distribute the drones again; see `Policy.reset`."""
        super().reset(mask)
        self._stop[mask] = -1

    def next_square(self, w: int, i: int, here: np.ndarray) -> np.ndarray:
        """Return the next square of the tour; see `PatrolPolicy.next_square`."""
        tour = self._tour(w)
        if self._stop[w, i] < 0:
            # Drones begin evenly spaced, in the order of their places on the tour
            first = pairwise_distances(self._first_places(w), tour).argmin(axis=1)
            rank = np.argsort(np.argsort(first, kind="stable"))
            start = int(first[0])
            step = len(tour) / len(first)
            self._stop[w, i] = (start + round(step * int(rank[i] - rank[0]))) % len(tour)
        else:
            self._stop[w, i] = (self._stop[w, i] + 1) % len(tour)
        square: np.ndarray = tour[self._stop[w, i]]
        return square

    def _first_places(self, w: int) -> np.ndarray:
        """Return the starts of the drones of a world, (N, 2) m."""
        places: np.ndarray = self.aviary.scene.start[w, :, :2]
        return places

    def _tour(self, w: int) -> np.ndarray:
        """Return the tour of the squares of a world, (K, 2) m, computed on first use."""
        scene = self.aviary.scene
        layout = int(scene.layout[w])
        if layout not in self._tours:
            active = self.task.active_targets(scene)[w]
            points = self.task.targets(scene)[w, active, :2]
            self._tours[layout] = points[find_tour(pairwise_distances(points, points))]
        return self._tours[layout]


def find_tour(distance: np.ndarray) -> np.ndarray:
    """Find a short closed tour of points, by the nearest neighbour and 2-opt.

    Args:
        distance: (K, K) distances between the points, m.

    Returns:
        (K,) indices of the points in their order.
    """
    count = len(distance)
    tour, left = [0], set(range(1, count))
    while left:
        here = tour[-1]
        tour.append(min(left, key=lambda j: (distance[here, j], j)))
        left.remove(tour[-1])
    order = np.array(tour)
    improved = True
    while improved:
        improved = False
        for a in range(count - 1):
            # Replace the edges after a and after b by those between their ends
            b = np.arange(a + 1, count)
            after = order[(b + 1) % count]
            now = distance[order[a], order[a + 1]] + distance[order[b], after]
            then = distance[order[a], order[b]] + distance[order[a + 1], after]
            gain = now - then
            best = int(gain.argmax())
            if gain[best] > 1e-9:
                order[a + 1 : b[best] + 1] = order[a + 1 : b[best] + 1][::-1].copy()
                improved = True
    return order
