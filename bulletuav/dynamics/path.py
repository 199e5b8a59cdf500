"""Where drones and obstacles go during one decision, and where drones stop on the way."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Motion, Swarm


def inner(one: np.ndarray, two: np.ndarray) -> float:
    """Inner product of two short vectors, added up in their order: BLAS adds as the processor likes."""
    total = 0.0
    for a, b in zip(one.tolist(), two.tolist(), strict=True):
        total += a * b
    return total


def length(vector: np.ndarray) -> float:
    """Euclidean norm of a short vector."""
    return math.sqrt(inner(vector, vector))


class Path(NamedTuple):
    """Poses at the ends of S straight pieces: position (S + 1, W, N, 3) m, quaternion (S + 1, W, N, 4).

    Of the obstacles position (S + 1, W, K, 3) and quaternion (W, K, 4). Times are in substeps since the beginning; a piece
    takes `span` of them. `stop` (W, N): from when on a drone stays where it is, inf for those that go all the way.
    """

    position: np.ndarray
    quaternion: np.ndarray
    obstacle: np.ndarray
    obstacle_quaternion: np.ndarray
    stop: np.ndarray
    span: float

    @classmethod
    def begin(cls, swarm: Swarm, motion: Motion, pieces: int, span: float = 1.0) -> "Path":
        """Room for a decision, with the present poses first."""
        position, quaternion = (
            np.empty((pieces + 1, *array.shape)) for array in (swarm.position, swarm.quaternion)
        )
        obstacle = np.empty((pieces + 1, *motion.before.shape))
        obstacle[:] = (
            motion.at(np.arange(pieces + 1)[:, None, None, None] / pieces)
            if motion.moving
            else motion.before
        )
        position[0], quaternion[0] = swarm.position, swarm.quaternion
        stop = np.full(swarm.position.shape[:2], np.inf)
        return cls(position, quaternion, obstacle, motion.quaternion, stop, float(span))

    def piece(self, time: float) -> int:
        """That in which `time` is."""
        return min(int(time / self.span), len(self.position) - 2)

    def pose(self, world: int, who: int, time: float) -> tuple[int, np.ndarray, np.ndarray]:
        """(who, position, quaternion) at `time`, within a piece by straight interpolation."""
        if who in (GROUND, CITY):
            return who, np.zeros(3), np.zeros(4)
        if who >= 0:
            time = min(time, self.stop[world, who])
        s = self.piece(time)
        share = time / self.span - s
        if who <= FIRST_OBSTACLE:
            k = FIRST_OBSTACLE - who
            position = (1 - share) * self.obstacle[s, world, k] + share * self.obstacle[
                s + 1, world, k
            ]
            return who, position, self.obstacle_quaternion[world, k]
        position = (1 - share) * self.position[s, world, who] + share * self.position[
            s + 1, world, who
        ]
        before, after = self.quaternion[s, world, who], self.quaternion[s + 1, world, who]
        quaternion = (1 - share) * before + share * after * (1 if inner(before, after) >= 0 else -1)
        return who, position, quaternion / length(quaternion)

    def change(self, world: int, who: int, begin: float, end: float) -> np.ndarray:
        """(3,) displacement between two times within a piece, m."""
        if who in (GROUND, CITY) or (who >= 0 and begin >= self.stop[world, who]):
            return np.zeros(3)
        if end - begin < self.span:
            return self.pose(world, who, end)[1] - self.pose(world, who, begin)[1]
        s, track = (
            self.piece(begin),
            self.obstacle[:, world, FIRST_OBSTACLE - who]
            if who < 0
            else self.position[:, world, who],
        )
        return track[s + 1] - track[s]

    def breaks(self, world: int, ends: tuple[int, int]) -> list[float]:
        """Times, first to last, between which both of a pair move straight."""
        times = {k * self.span for k in range(len(self.position))}
        stops = {float(self.stop[world, who]) for who in ends if who >= 0}
        return sorted(times | {stop for stop in stops if stop < max(times)})
