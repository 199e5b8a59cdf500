"""Trajectories of the high-level commander: 7th-degree polynomials, spirals and uploaded ones."""

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
"""Matrix that maps residuals of the end conditions at s = 1 (of the value and of its first to third
derivative) to the coefficients of s^4 to s^7: the inverse of ((1, 1, 1, 1), (4, 5, 6, 7),
(12, 20, 30, 42), (24, 60, 120, 210))"""
NUM_COEFFICIENTS = 8
"""Number of coefficients of a polynomial"""
PIECE_SIZE = 4 * (4 * NUM_COEFFICIENTS + 1)
"""Size of a trajectory piece in memory, bytes"""
NUM_SPIRAL_POINTS = 49
"""Number of sample points through which a spiral is interpolated"""
COMPRESSED_DEGREES = (0, 1, 3, 7)
"""Degrees of compressed pieces, by the two bits that encode the degree"""
MAX_COORDINATE = 10_000.0
"""Maximum coordinate (m) and yaw (rad) that a trajectory may reach"""
MAX_PIECE_DURATION = 10_000.0
"""Maximum duration of a piece, s"""


class TrajectoryStart(NamedTuple):
    """State at the start of a trajectory.

    Attributes:
        position: (4,) x, y, z (m) and yaw (rad).
        velocity: (4,) first derivative of `position`.
        acceleration: (4,) second derivative of `position`.
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray

    @classmethod
    def at_rest(cls, position: np.ndarray) -> "TrajectoryStart":
        """Return the start state at a position (4,) without motion."""
        return cls(position, np.zeros(4), np.zeros(4))


def plan_polynomial(start: TrajectoryStart, goal: np.ndarray, duration: float) -> Trajectory:
    """Plan a 7th-degree polynomial to a goal, where it ends at rest.

    Args:
        start: State at the start. The jerk is zero at both ends.
        goal: (4,) x, y, z (m) and yaw (rad).
        duration: Duration, s.

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
    """Plan a straight line at constant speed.

    Args:
        start: (4,) x, y, z (m) and yaw (rad).
        goal: (4,) x, y, z (m) and yaw (rad).
        duration: Duration, s.

    Returns:
        The trajectory, from time 0.
    """
    return Trajectory.polynomial(
        [duration], np.stack([start, (goal - start) / duration], axis=1)[None]
    )


def _powers(duration: float) -> np.ndarray:
    """Return the powers 0 to 7 of a duration, (8, 1)."""
    return np.cumprod([1.0, *[duration] * (NUM_COEFFICIENTS - 1)])[:, None]


class Spiral(NamedTuple):
    """Segment of a spiral.

    Attributes:
        angle: Angle of the segment, rad; a negative angle reverses the direction.
        start_radius: Radius at the start, m.
        end_radius: Radius at the end, m.
        ascent: Change of height, m.
        is_sideways: Whether the nose points to the centre instead of along the path.
        is_clockwise: Whether the drone turns to the right.
    """

    angle: float
    start_radius: float
    end_radius: float
    ascent: float
    is_sideways: bool
    is_clockwise: bool

    def plan(self, start: np.ndarray, duration: float) -> Trajectory:
        """Plan the spiral from rest to rest.

        Args:
            start: (4,) x, y, z (m) and yaw (rad).
            duration: Duration, s.

        Returns:
            The trajectory, from time 0.
        """
        time = np.linspace(0.0, 1.0, NUM_SPIRAL_POINTS)
        progress = (
            (END_CONDITION_INVERSE[:, 0] * time[:, None] ** np.arange(4, NUM_COEFFICIENTS)).sum(
                axis=1
            )
        )[:, None]
        side = -1.0 if self.is_clockwise else 1.0
        turned_angle = side * self.angle * progress
        # Direction from the centre to the drone: the centre is ahead of the nose, or at its side
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
    """Piecewise polynomial trajectory that a client uploaded to the trajectory memory.

    Attributes:
        durations: (P,) duration of each piece, s.
        coefficients: (P, 4, 8) coefficients of x, y, z, yaw as polynomials of the time since the
            start of the piece.
    """

    durations: np.ndarray
    coefficients: np.ndarray

    def evaluate(self, piece: int, time: float) -> np.ndarray:
        """Return the position (4,) of a piece at a time since its start, s."""
        return np.asarray((self.coefficients[piece] * _powers(time).T).sum(axis=1))

    def scaled(self, factor: float) -> "StoredTrajectory":
        """Return the trajectory with all durations multiplied by a factor."""
        return StoredTrajectory(self.durations * factor, self.coefficients / _powers(factor).T)

    def reverse(self) -> "StoredTrajectory":
        """Return the trajectory flown backwards, from its end to its start."""
        coefficients = np.zeros_like(self.coefficients)
        for piece, duration in enumerate(self.durations):
            # Binomial expansion of the powers of p(T - t)
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
        """Return the trajectory moved to another start.

        Args:
            start: (4,) x, y, z (m) and yaw (rad).
            is_relative: Whether to shift the trajectory to the position of `start`.
            is_yaw_relative: Whether to rotate the trajectory to the yaw of `start`.
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
        """Return the trajectory itself if its numbers are within the limits.

        Raises:
            MalformedError: If a duration or a coefficient is not finite or exceeds its limit.
        """
        durations = self.durations
        if not ((durations > 0) & (durations < MAX_PIECE_DURATION)).all():
            raise MalformedError(f"trajectory has a duration outside 0 to {MAX_PIECE_DURATION:g} s")
        with np.errstate(over="ignore", invalid="ignore"):
            reach = (
                np.abs(self.coefficients)
                * np.array([_powers(duration)[:, 0] for duration in durations])[:, None]
            )
        if not (reach < MAX_COORDINATE).all():
            raise MalformedError(f"trajectory may reach farther than {MAX_COORDINATE:g} m")
        return self

    def plan(self) -> Trajectory:
        """Return the `Trajectory` to follow, from time 0."""
        return Trajectory.polynomial(self.durations.tolist(), self.coefficients)


def read_pieces(content: bytes, offset: int, count: int) -> StoredTrajectory:
    """Read uncompressed pieces (7th-degree polynomials) from the trajectory memory.

    Args:
        content: Content of the memory.
        offset: Address of the first piece, bytes.
        count: Number of pieces.

    Returns:
        The trajectory.

    Raises:
        MalformedError: If the pieces extend beyond the memory, or exceed the limits.
    """
    numbers = unpack_data(f"{count * PIECE_SIZE // 4}f", content[offset:])
    rows = np.array(numbers).reshape(count, 4 * NUM_COEFFICIENTS + 1)
    return StoredTrajectory(rows[:, -1], rows[:, :-1].reshape(count, 4, NUM_COEFFICIENTS)).checked()


def read_compressed(content: bytes, offset: int, count: int) -> StoredTrajectory:
    """Read compressed pieces: control points of Bezier curves, in mm and tenths of degrees.

    Args:
        content: Content of the memory.
        offset: Address of the first piece, bytes.
        count: Number of pieces.

    Returns:
        The trajectory.

    Raises:
        MalformedError: If the pieces extend beyond the memory, or exceed the limits.
    """
    # The start point, which is stored once; pieces store their other control points only
    units = np.array([1e-3, 1e-3, 1e-3, math.radians(0.1)])
    last = np.array(unpack_data("4h", content[offset:])) * units
    offset += 8
    durations, coefficients = np.zeros(count), np.zeros((count, 4, NUM_COEFFICIENTS))
    for piece in range(count):
        # Two bits per axis encode the degree of its curve
        degree_bits, duration_ms = unpack_data("BH", content[offset:])
        durations[piece], offset = duration_ms / 1000, offset + 3
        for axis in range(4):
            degree = COMPRESSED_DEGREES[degree_bits >> 2 * axis & 3]
            points = unpack_data(f"{degree}h", content[offset:])
            offset += 2 * degree
            # Each curve starts at the end of the previous one
            control = [last[axis], *(point * units[axis] for point in points)]
            coefficients[piece, axis, : degree + 1] = _bezier_to_monomials(control)
            last[axis] = control[-1]
    if not durations.all():
        raise MalformedError("trajectory has a piece with a duration of zero")
    # Convert from normalised time s in [0, 1] to seconds
    return StoredTrajectory(
        durations, coefficients / np.array([_powers(duration).T for duration in durations])
    ).checked()


def _bezier_to_monomials(control: list[float]) -> list[float]:
    """Convert control points of a Bezier curve into coefficients of powers of s in [0, 1]."""
    degree = len(control) - 1
    return [
        math.comb(degree, k)
        * sum((-1.0) ** (k - m) * math.comb(k, m) * control[m] for m in range(k + 1))
        for k in range(degree + 1)
    ]
