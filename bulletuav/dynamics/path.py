"""Straight pieces along which drones and obstacles move, and where drones stop on the way."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.rotation import Quat4, Vec3
from bulletuav.kernel import func
from bulletuav.vehicle.swarm import CITY, FIRST_OBSTACLE, GROUND, Motion, Swarm

Pose = tuple[int, np.ndarray, np.ndarray]
"""Who (as `other` in `Contacts`), position (3,) in m, quaternion (4,)"""


def inner(one: np.ndarray, two: np.ndarray) -> float:
    """Return the inner product of two short vectors, added up in their order.

    BLAS would add in an order that depends on the processor.
    """
    total = 0.0
    for a, b in zip(one.tolist(), two.tolist(), strict=True):
        total += a * b
    return total


def length(vector: np.ndarray) -> float:
    """Return the Euclidean norm of a short vector, added up in its order."""
    return math.sqrt(inner(vector, vector))


class Path(NamedTuple):
    """Poses of W worlds of N drones and K obstacles at the ends of S straight pieces.

    Times are in substeps since the beginning of the path. Who moves is told as in `Contacts`:
    index of a drone, GROUND, CITY, or FIRST_OBSTACLE - k for obstacle k.

    Attributes:
        position: (S + 1, W, N, 3) centres of mass of the drones, m.
        quaternion: (S + 1, W, N, 4) attitudes of the drones.
        obstacle: (S + 1, W, K, 3) positions of the obstacles, m.
        obstacle_quaternion: (W, K, 4) attitudes of the obstacles, which do not turn.
        stop: (W, N) time from which on a drone stays where it is; inf for one that never stops.
        span: Time that each piece takes, in substeps.
    """

    position: np.ndarray
    quaternion: np.ndarray
    obstacle: np.ndarray
    obstacle_quaternion: np.ndarray
    stop: np.ndarray
    span: float

    @classmethod
    def begin(
        cls,
        swarm: Swarm,
        motion: Motion,
        pieces: int,
        span: float = 1.0,
    ) -> "Path":
        """Make room for a path that starts from the present poses.

        Args:
            swarm: State at the beginning; it fills the first poses, all later ones are unset.
            motion: Motion of the obstacles, cut into pieces of the same duration.
            pieces: Number S of pieces.
            span: Substeps that each piece takes.

        Returns:
            A path on which no drone stops.
        """
        # Drones: the present poses alone
        position = np.empty((pieces + 1, *swarm.position.shape))
        quaternion = np.empty((pieces + 1, *swarm.quaternion.shape))
        position[0] = swarm.position
        quaternion[0] = swarm.quaternion

        # Obstacles: all the way
        obstacle = np.empty((pieces + 1, *motion.before.shape))
        if motion.moving:
            share = np.arange(pieces + 1)[:, None, None, None] / pieces
            obstacle[:] = motion.at(share)
        else:
            obstacle[:] = motion.before

        # Nobody stops yet
        stop = np.full(swarm.position.shape[:2], np.inf)
        return cls(position, quaternion, obstacle, motion.quaternion, stop, float(span))

    def piece(self, time: float) -> int:
        """Return the index of the piece in which `time` lies."""
        return min(int(time / self.span), len(self.position) - 2)

    def pose(self, world: int, who: int, time: float) -> Pose:
        """Interpolate a pose, straight within a piece; ground and city have none, told as zeros.

        Args:
            world: Index of the world.
            who: A drone, an obstacle, GROUND or CITY.
            time: Substeps since the beginning.

        Returns:
            Who, position (3,) in m, and unit quaternion (4,).
        """
        if who in (GROUND, CITY):
            return who, np.zeros(3), np.zeros(4)
        if who >= 0:
            time = min(time, self.stop[world, who])
        piece = self.piece(time)
        share = time / self.span - piece

        track = self._track(world, who)
        here = track[piece]
        there = track[piece + 1]
        position = (1 - share) * here + share * there
        if who <= FIRST_OBSTACLE:
            return who, position, self.obstacle_quaternion[world, FIRST_OBSTACLE - who]

        before = self.quaternion[piece, world, who]
        after = self.quaternion[piece + 1, world, who]
        # q and -q are the same attitude: go the shorter way
        sign = 1 if inner(before, after) >= 0 else -1
        quaternion = (1 - share) * before + share * after * sign
        return who, position, quaternion / length(quaternion)

    def change(
        self,
        world: int,
        who: int,
        begin: float,
        end: float,
    ) -> np.ndarray:
        """Return the displacement (3,) in m between two times within one piece."""
        stopped = who >= 0 and begin >= self.stop[world, who]
        if stopped or who in (GROUND, CITY):
            return np.zeros(3)
        moved: np.ndarray
        # A whole piece needs no interpolation
        if end - begin < self.span:
            _, before, _ = self.pose(world, who, begin)
            _, after, _ = self.pose(world, who, end)
            moved = after - before
        else:
            piece = self.piece(begin)
            track = self._track(world, who)
            moved = track[piece + 1] - track[piece]
        return moved

    def breaks(self, world: int, ends: tuple[int, int]) -> list[float]:
        """Return the ascending times between which both of a pair move straight."""
        times = {k * self.span for k in range(len(self.position))}
        stops = {float(self.stop[world, who]) for who in ends if who >= 0}
        last = max(times)
        return sorted(times | {stop for stop in stops if stop < last})

    def _track(self, world: int, who: int) -> np.ndarray:
        """Return the positions (S + 1, 3) of a drone or an obstacle."""
        if who < 0:
            return self.obstacle[:, world, FIRST_OBSTACLE - who]
        return self.position[:, world, who]


@func
def write_pose(
    path: Path,
    end: int,
    w: int,
    i: int,
    position: Vec3,
    quaternion: Quat4,
) -> None:
    """Write where drone i of world w is after `end` pieces, for compiled code."""
    for k in range(3):
        path.position[end, w, i, k] = position[k]
    for k in range(4):
        path.quaternion[end, w, i, k] = quaternion[k]
