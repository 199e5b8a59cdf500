"""Trajectories of a virtual Crazyflie's planner: polynomials, spirals, and those of its memory."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.crtp import MalformedError, unpack_data
from bulletuav.compiled.functions import cos, sin
from bulletuav.control.trajectory import Trajectory

END_CONDITION_INVERSE = np.array(
    [
        [35, -15, 5 / 2, -1 / 6],
        [-84, 39, -7, 1 / 2],
        [70, -34, 13 / 2, -1 / 2],
        [-20, 10, -2, 1 / 6],
    ]
)
"""Coefficients of s^4 to s^7 from what is missing at s = 1 of value, and first to third derivative:
the inverse of ((1, 1, 1, 1), (4, 5, 6, 7), (12, 20, 30, 42), (24, 60, 120, 210))"""
NUM_COEFFICIENTS = 8
"""Coefficients of a polynomial"""
PIECE_SIZE = 4 * (4 * NUM_COEFFICIENTS + 1)
"""Size of a piece of a trajectory in memory, bytes"""
NUM_SPIRAL_POINTS = 49
"""Points that a spiral is laid through"""
COMPRESSED_DEGREES = (0, 1, 3, 7)
"""Degrees of compressed pieces, by the two bits that tell them"""
MAX_COORDINATE = 10_000.0
"""Greatest coordinate (m) and yaw (rad) that a trajectory may reach"""
MAX_PIECE_DURATION = 10_000.0
"""Longest that a piece may take, s"""


class TrajectoryStart(NamedTuple):
    """Where a plan begins.

    Attributes:
        place: (4,) x, y, z (m) and yaw (rad).
        speed: (4,) the first derivative.
        gain: (4,) the second derivative.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def at_rest(cls, position: np.ndarray) -> "TrajectoryStart":
        """Make one without motion."""
        return cls(position, np.zeros(4), np.zeros(4))


def plan_polynomial(start: TrajectoryStart, goal: np.ndarray, duration: float) -> Trajectory:
    """Plan a polynomial of 7th degree to a goal, where it ends at rest.

    Args:
        begin: Where, and how fast, it begins; jerk is zero at both ends.
        goal: (4,) x, y, z, yaw.
        duration: s.

    Returns:
        The trajectory, from time 0.
    """
    first = np.array(
        [
            start.position,
            start.velocity * duration,
            start.acceleration * duration**2 / 2,
            np.zeros(4),
        ]
    )
    missing = np.array(
        [
            goal - first[:3].sum(axis=0),
            -(first[1] + 2 * first[2]),
            -2 * first[2],
            np.zeros(4),
        ]
    )
    coefficients = np.concatenate(
        [first, (END_CONDITION_INVERSE[:, :, None] * missing).sum(axis=1)]
    )
    return Trajectory.polynomial([duration], (coefficients / _powers(duration)).T[None])


def plan_line(start: np.ndarray, goal: np.ndarray, duration: float) -> Trajectory:
    """Plan a line (4,) to (4,) at one speed."""
    return Trajectory.polynomial(
        [duration], np.stack([start, (goal - start) / duration], axis=1)[None]
    )


def _powers(duration: float) -> np.ndarray:
    """Return the powers of a duration, (8, 1)."""
    return np.cumprod([1.0, *[duration] * (NUM_COEFFICIENTS - 1)])[:, None]


class Spiral(NamedTuple):
    """A part of a spiral.

    Attributes:
        angle: How far it turns, rad; below 0 backwards.
        first: Radius at its begin, m.
        last: Radius at its end, m.
        ascent: m.
        sideways: Whether the nose points to the centre, and not along the path.
        clockwise: Whether it turns to the right.
    """

    angle: float
    start_radius: float
    end_radius: float
    ascent: float
    is_sideways: bool
    is_clockwise: bool

    def plan(self, start: np.ndarray, duration: float) -> Trajectory:
        """Plan it from a pose (4,), from rest to rest."""
        time = np.linspace(0.0, 1.0, NUM_SPIRAL_POINTS)
        progress = (
            (END_CONDITION_INVERSE[:, 0] * time[:, None] ** np.arange(4, NUM_COEFFICIENTS)).sum(
                axis=1
            )
        )[:, None]
        side = -1.0 if self.is_clockwise else 1.0
        turned_angle = side * self.angle * progress
        # From the centre to the drone: the centre is ahead, or beside it on the inner side.
        outwards = start[3] + (math.pi if self.is_sideways else -side * math.pi / 2)
        radius = self.start_radius + (self.end_radius - self.start_radius) * progress
        offset = np.array([cos(outwards), sin(outwards)])
        centre = start[:2] - self.start_radius * offset
        about = np.hstack([cos(outwards + turned_angle), sin(outwards + turned_angle)])
        points = np.hstack(
            [centre + radius * about, start[2] + self.ascent * progress, start[3] + turned_angle]
        )
        return Trajectory(duration * time, points)


class StoredTrajectory(NamedTuple):
    """A trajectory that was written to memory.

    Attributes:
        durations: (P,) s.
        terms: (P, 4, 8) coefficients of x, y, z, yaw by the time since the piece began.
    """

    durations: np.ndarray
    coefficients: np.ndarray

    def evaluate(self, piece: int, time: float) -> np.ndarray:
        """Tell where a piece is, (4,)."""
        return np.asarray((self.coefficients[piece] * _powers(time).T).sum(axis=1))

    def scaled(self, factor: float) -> "StoredTrajectory":
        """Return it slower by a factor."""
        return StoredTrajectory(self.durations * factor, self.coefficients / _powers(factor).T)

    def reverse(self) -> "StoredTrajectory":
        """Return it from its end to its begin."""
        coefficients = np.zeros_like(self.coefficients)
        for piece, duration in enumerate(self.durations):
            # p(T - t): the binomial expansion of each power.
            for k in range(NUM_COEFFICIENTS):
                for m in range(k + 1):
                    coefficients[piece, :, m] += (
                        self.coefficients[piece, :, k]
                        * math.comb(k, m)
                        * duration ** (k - m)
                        * (-1.0) ** m
                    )
        return StoredTrajectory(self.durations[::-1], coefficients[::-1])

    def moved(
        self, start: np.ndarray, is_relative: bool, is_yaw_relative: bool
    ) -> "StoredTrajectory":
        """Return it from another begin (4,).

        Args:
            begin: x, y, z, yaw.
            along: Whether it begins at that place.
            turned_angle: Whether it is turned_angle to begin with that yaw.
        """
        coefficients = self.coefficients.copy()
        first = self.evaluate(0, 0.0)
        if is_yaw_relative:
            angle = start[3] - first[3]
            c, s = cos(angle), sin(angle)
            x, y = coefficients[:, 0].copy(), coefficients[:, 1].copy()
            coefficients[:, 0], coefficients[:, 1] = c * x - s * y, s * x + c * y
            coefficients[:, 3, 0] += angle
        if is_relative:
            coefficients[:, :3, 0] += start[:3] - (coefficients[0, :3, 0])
        return StoredTrajectory(self.durations, coefficients)

    def checked(self) -> "StoredTrajectory":
        """Return itself, if it stays near enough.

        Raises:
            MalformedError: A number is not finite, or it goes too far, or too long.
        """
        durations = self.durations
        if not ((durations > 0) & (durations < MAX_PIECE_DURATION)).all():
            raise MalformedError("a trajectory with a duration that cannot be")
        with np.errstate(over="ignore", invalid="ignore"):
            reach = (
                np.abs(self.coefficients)
                * np.array([_powers(duration)[:, 0] for duration in durations])[:, None]
            )
        if not (reach < MAX_COORDINATE).all():
            raise MalformedError(f"a trajectory that may reach farther than {MAX_COORDINATE:g} m")
        return self

    def plan(self) -> Trajectory:
        """Make the trajectory, from time 0."""
        return Trajectory.polynomial(self.durations.tolist(), self.coefficients)


def read_pieces(content: bytes, offset: int, count: int) -> StoredTrajectory:
    """Read pieces of 7th degree from memory.

    Args:
        content: The memory.
        offset: Where they begin, bytes.
        count: How many pieces.

    Returns:
        The trajectory.

    Raises:
        MalformedError: They lie beyond the memory, or cannot be.
    """
    numbers = unpack_data(f"{count * PIECE_SIZE // 4}f", content[offset:])
    rows = np.array(numbers).reshape(count, 4 * NUM_COEFFICIENTS + 1)
    return StoredTrajectory(rows[:, -1], rows[:, :-1].reshape(count, 4, NUM_COEFFICIENTS)).checked()


def read_compressed(content: bytes, offset: int, count: int) -> StoredTrajectory:
    """Read compressed pieces: control points of Bezier curves, mm and tenths of degrees.

    Args:
        content: The memory.
        offset: Where they begin, bytes.
        count: How many pieces.

    Returns:
        The trajectory.

    Raises:
        MalformedError: They lie beyond the memory, or cannot be.
    """
    # The first point, of which each piece needs only what follows
    units = np.array([1e-3, 1e-3, 1e-3, math.radians(0.1)])
    last = np.array(unpack_data("4h", content[offset:])) * units
    offset += 8
    durations, coefficients = np.zeros(count), np.zeros((count, 4, NUM_COEFFICIENTS))
    for piece in range(count):
        # Two bits an axis tell the degree of its curve
        degree_bits, duration_ms = unpack_data("BH", content[offset:])
        durations[piece], offset = duration_ms / 1000, offset + 3
        for axis in range(4):
            degree = COMPRESSED_DEGREES[degree_bits >> 2 * axis & 3]
            points = unpack_data(f"{degree}h", content[offset:])
            offset += 2 * degree
            # Each curve begins where the one before ended
            control = [last[axis], *(point * units[axis] for point in points)]
            coefficients[piece, axis, : degree + 1] = _bezier_to_monomials(control)
            last[axis] = control[-1]
    if not durations.all():
        raise MalformedError("a piece of a trajectory that takes no time")
    # Terms are by the progress of the time; trajectories want them by seconds
    return StoredTrajectory(
        durations, coefficients / np.array([_powers(duration).T for duration in durations])
    ).checked()


def _bezier_to_monomials(control: list[float]) -> list[float]:
    """Convert the control points of a Bezier curve into coefficients by powers of s in [0, 1]."""
    degree = len(control) - 1
    return [
        math.comb(degree, k)
        * sum((-1.0) ** (k - m) * math.comb(k, m) * control[m] for m in range(k + 1))
        for k in range(degree + 1)
    ]
