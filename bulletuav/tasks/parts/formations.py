"""Moving frames of leaders, assignment of drones to places, and formation errors."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, hypot, sin
from bulletuav.compiled.kernel import allocating, kernel

JACOBI_SWEEPS = 6
"""Sweeps of Jacobi's eigenvalue algorithm; four reduce random matrices to rounding errors"""


class Leader(NamedTuple):
    """Moving frames of K leaders that fly level and turn about the vertical axis.

    Attributes:
        position: (K, 3) m.
        velocity: (K, 3) m/s.
        yaw: (K,) direction of flight, from east to north, rad.
        turn: (K,) turn rate, rad/s.
    """

    position: np.ndarray
    velocity: np.ndarray
    yaw: np.ndarray
    turn: np.ndarray


class Course:
    """Path of a leader at constant speed, straight or circular, centred at the origin.

    Attributes:
        turn: Absolute turn rate, rad/s.
        radius: Maximum distance of the leader from the origin, m.
    """

    def __init__(
        self, speed: float, turn: float, altitude: float, duration: float, period: float
    ) -> None:
        """Compute the centre of the path, which is placed above the origin.

        Args:
            speed: m/s.
            turn: Absolute turn rate, rad/s.
            altitude: Height above ground, m.
            duration: Length of the flight, s.
            period: Time between decisions, s.
        """
        self.turn = turn
        self._speed, self._altitude = speed, altitude
        time = np.arange(round(duration / period) + 1) * period
        path = self._displacement(time, np.zeros(len(time)), np.full(len(time), turn))
        self._middle = (path.max(axis=0) + path.min(axis=0)) / 2
        offset = path - self._middle
        self.radius = float(hypot(offset[:, 0], offset[:, 1]).max())

    def _displacement(self, time: np.ndarray, course: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Compute the displacements (K, 2) from the start, m, as chords of arcs."""
        half = turn * time / 2
        # The chord is sin(half) / half of the arc's length, and points to the middle of the arc
        share = np.where(half == 0, 1.0, sin(half) / np.where(half == 0, 1.0, half))
        chord = self._speed * time * share
        return np.stack([chord * cos(course + half), chord * sin(course + half)], axis=1)

    def at(self, time: np.ndarray, course: np.ndarray, turn: np.ndarray) -> Leader:
        """Return the states of leaders at given times.

        Args:
            time: (K,) time since the start, s.
            course: (K,) direction of flight at the start, from east to north, rad.
            turn: (K,) turn rate to the left, rad/s, with the absolute value of this course.
        """
        side = np.where(turn < 0, -1.0, 1.0)
        x, y = self._middle[0], side * self._middle[1]
        start = np.stack([sin(course) * y - cos(course) * x, -sin(course) * x - cos(course) * y], 1)
        level = start + self._displacement(time, course, turn)
        yaw = course + turn * time
        position = np.concatenate([level, np.full((len(level), 1), self._altitude)], axis=1)
        direction = np.stack([cos(yaw), sin(yaw), np.zeros(len(yaw))], axis=1)
        return Leader(position, self._speed * direction, yaw, turn)


def in_world(place: np.ndarray, leader: Leader) -> tuple[np.ndarray, np.ndarray]:
    """Transform places from leaders' frames to the world.

    A place moves with the leader and rotates about it: v + turn x r.

    Args:
        place: (K, N, 3) forward, left and up of each leader, m.
        leader: K leaders.

    Returns:
        Positions (K, N, 3), m, and velocities (K, N, 3), m/s.
    """
    ahead, aside = cos(leader.yaw)[:, None], sin(leader.yaw)[:, None]
    east = ahead * place[..., 0] - aside * place[..., 1]
    north = aside * place[..., 0] + ahead * place[..., 1]
    offset = np.stack([east, north, place[..., 2]], axis=-1)
    turn = leader.turn[:, None]
    round_it = np.stack([-turn * north, turn * east, np.zeros(east.shape)], axis=-1)
    return leader.position[:, None] + offset, leader.velocity[:, None] + round_it


def max_place_speed(place: np.ndarray, speed: float, turn: float) -> float:
    """Return the maximum speed of places (M, 3) relative to a turning leader, m/s.

    Args:
        place: Forward, left and up of the leader, m.
        speed: Speed of the leader, m/s.
        turn: Absolute turn rate of the leader, rad/s.
    """
    along = speed + turn * np.abs(place[:, 1])
    return float(hypot(along, turn * place[:, 0]).max())


def assign_places(position: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Assign drones to places with the minimum sum of squared distances.

    Args:
        position: (N, 3) positions of drones, m.
        place: (M, 3) places, M >= N, m.

    Returns:
        (N,) index of each drone's place.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import

    square = ((position[:, None] - place) ** 2).sum(axis=-1)
    chosen: np.ndarray = linear_sum_assignment(square)[1]
    return chosen


def off_places(position: np.ndarray, goal: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute the root mean square distance of drones from their places.

    The error includes a common offset: a perfect shape beside its leader has an error.

    Args:
        position: (W, N, 3) m.
        goal: (W, N, 3) places, m.
        counts: (W, N) bool, drones to include.

    Returns:
        (W,) m, 0 if no drone is included.
    """
    square = ((position - goal) ** 2).sum(axis=-1)
    number = np.maximum(counts.sum(axis=1), 1)
    off: np.ndarray = np.sqrt(np.where(counts, square, 0.0).sum(axis=1) / number)
    return off


@allocating
def off_shape(position: np.ndarray, goal: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Compute the root mean square distance from places after optimal translation and rotation.

    Reflection and scaling are not removed. Method: B. K. P. Horn, Closed-form solution of absolute
    orientation using unit quaternions (1987).

    Args:
        position: (W, N, 3) m.
        goal: (W, N, 3) places, m.
        counts: (W, N) bool, drones to include.

    Returns:
        (W,) m, 0 if no drone is included.
    """
    off = np.zeros(len(position))
    s, table = np.empty((3, 3)), np.empty((4, 4))
    for w in range(len(position)):
        # The optimal translation aligns the means
        number, mean = 0, np.zeros((2, 3))
        for i in range(counts.shape[1]):
            if counts[w, i]:
                number += 1
                mean[0] += position[w, i]
                mean[1] += goal[w, i]
        if number == 0:
            continue
        mean /= number
        # Sum of squares, and cross-covariance
        s[:] = 0.0
        square = 0.0
        for i in range(counts.shape[1]):
            if counts[w, i]:
                for a in range(3):
                    to = position[w, i, a] - mean[0, a]
                    square += to * to + (goal[w, i, a] - mean[1, a]) ** 2
                    for b in range(3):
                        s[b, a] += (goal[w, i, b] - mean[1, b]) * to
        # The optimal rotation belongs to the largest eigenvalue of Horn's matrix
        table[0, 0] = s[0, 0] + s[1, 1] + s[2, 2]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            table[a + 1, a + 1] = s[a, a] - s[b, b] - s[c, c]
            table[0, a + 1] = table[a + 1, 0] = s[b, c] - s[c, b]
            table[b + 1, c + 1] = table[c + 1, b + 1] = s[b, c] + s[c, b]
        rest = square - 2.0 * _largest_eigenvalue(table)
        off[w] = math.sqrt(max(rest, 0.0) / number)
    return off


@kernel
def _largest_eigenvalue(table: np.ndarray) -> float:
    """Compute the largest eigenvalue of a symmetric matrix by Jacobi rotations, in place."""
    size = len(table)
    for _ in range(JACOBI_SWEEPS):
        for p in range(size - 1):
            for q in range(p + 1, size):
                if table[p, q] == 0.0:
                    continue
                # The rotation that annihilates this entry
                ratio = (table[q, q] - table[p, p]) / (2.0 * table[p, q])
                tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(ratio * ratio + 1.0))
                cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for k in range(size):
                    one, other = table[k, p], table[k, q]
                    table[k, p] = cosine * one - sine * other
                    table[k, q] = sine * one + cosine * other
                for k in range(size):
                    one, other = table[p, k], table[q, k]
                    table[p, k] = cosine * one - sine * other
                    table[q, k] = sine * one + cosine * other
    largest = table[0, 0]
    for k in range(1, size):
        largest = max(largest, table[k, k])
    return float(largest)
