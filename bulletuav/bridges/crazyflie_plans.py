"""Trajectories of a virtual Crazyflie's planner: polynomials, spirals, and those of its memory."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.bridges.crtp import MalformedError, unpack
from bulletuav.compiled.functions import cos, sin
from bulletuav.control.trajectory import Trajectory

ENDS = np.array(
    [
        [35, -15, 5 / 2, -1 / 6],
        [-84, 39, -7, 1 / 2],
        [70, -34, 13 / 2, -1 / 2],
        [-20, 10, -2, 1 / 6],
    ]
)
"""Coefficients of s^4 to s^7 from what is missing at s = 1 of value, and first to third derivative:
the inverse of ((1, 1, 1, 1), (4, 5, 6, 7), (12, 20, 30, 42), (24, 60, 120, 210))"""
POWERS = 8
"""Coefficients of a polynomial"""
PIECE = 4 * (4 * POWERS + 1)
"""Size of a piece of a trajectory in memory, bytes"""
SPIRAL_POINTS = 49
"""Points that a spiral is laid through"""
COMPRESSED_DEGREES = (0, 1, 3, 7)
"""Degrees of compressed pieces, by the two bits that tell them"""
FARTHEST = 10_000.0
"""Greatest coordinate (m) and yaw (rad) that a trajectory may reach"""
LONGEST = 10_000.0
"""Longest that a piece may take, s"""


class Pose(NamedTuple):
    """Where a plan begins.

    Attributes:
        place: (4,) x, y, z (m) and yaw (rad).
        speed: (4,) the first derivative.
        gain: (4,) the second derivative.
    """

    place: np.ndarray
    speed: np.ndarray
    gain: np.ndarray

    @classmethod
    def still(cls, place: np.ndarray) -> "Pose":
        """Make one without motion."""
        return cls(place, np.zeros(4), np.zeros(4))


def smooth(begin: Pose, goal: np.ndarray, duration: float) -> Trajectory:
    """Plan a polynomial of 7th degree to a goal, where it ends at rest.

    Args:
        begin: Where, and how fast, it begins; jerk is zero at both ends.
        goal: (4,) x, y, z, yaw.
        duration: s.

    Returns:
        The trajectory, from time 0.
    """
    first = np.array(
        [begin.place, begin.speed * duration, begin.gain * duration**2 / 2, np.zeros(4)]
    )
    missing = np.array(
        [
            goal - first[:3].sum(axis=0),
            -(first[1] + 2 * first[2]),
            -2 * first[2],
            np.zeros(4),
        ]
    )
    terms = np.concatenate([first, (ENDS[:, :, None] * missing).sum(axis=1)])
    return Trajectory.polynomial([duration], (terms / _powers(duration)).T[None])


def straight(begin: np.ndarray, goal: np.ndarray, duration: float) -> Trajectory:
    """Plan a line (4,) to (4,) at one speed."""
    return Trajectory.polynomial(
        [duration], np.stack([begin, (goal - begin) / duration], axis=1)[None]
    )


def _powers(duration: float) -> np.ndarray:
    """Return the powers of a duration, (8, 1)."""
    return np.cumprod([1.0, *[duration] * (POWERS - 1)])[:, None]


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
    first: float
    last: float
    ascent: float
    sideways: bool
    clockwise: bool

    def plan(self, begin: np.ndarray, duration: float) -> Trajectory:
        """Plan it from a pose (4,), from rest to rest."""
        time = np.linspace(0.0, 1.0, SPIRAL_POINTS)
        share = ((ENDS[:, 0] * time[:, None] ** np.arange(4, POWERS)).sum(axis=1))[:, None]
        side = -1.0 if self.clockwise else 1.0
        turned = side * self.angle * share
        # From the centre to the drone: the centre is ahead, or beside it on the inner side.
        outwards = begin[3] + (math.pi if self.sideways else -side * math.pi / 2)
        radius = self.first + (self.last - self.first) * share
        offset = np.array([cos(outwards), sin(outwards)])
        centre = begin[:2] - self.first * offset
        about = np.hstack([cos(outwards + turned), sin(outwards + turned)])
        points = np.hstack(
            [centre + radius * about, begin[2] + self.ascent * share, begin[3] + turned]
        )
        return Trajectory(duration * time, points)


class Stored(NamedTuple):
    """A trajectory that was written to memory.

    Attributes:
        durations: (P,) s.
        terms: (P, 4, 8) coefficients of x, y, z, yaw by the time since the piece began.
    """

    durations: np.ndarray
    terms: np.ndarray

    def value(self, piece: int, time: float) -> np.ndarray:
        """Tell where a piece is, (4,)."""
        return np.asarray((self.terms[piece] * _powers(time).T).sum(axis=1))

    def scaled(self, factor: float) -> "Stored":
        """Return it slower by a factor."""
        return Stored(self.durations * factor, self.terms / _powers(factor).T)

    def reverse(self) -> "Stored":
        """Return it from its end to its begin."""
        terms = np.zeros_like(self.terms)
        for piece, duration in enumerate(self.durations):
            # p(T - t): the binomial expansion of each power.
            for k in range(POWERS):
                for m in range(k + 1):
                    terms[piece, :, m] += (
                        self.terms[piece, :, k]
                        * math.comb(k, m)
                        * duration ** (k - m)
                        * (-1.0) ** m
                    )
        return Stored(self.durations[::-1], terms[::-1])

    def moved(self, begin: np.ndarray, along: bool, turned: bool) -> "Stored":
        """Return it from another begin (4,).

        Args:
            begin: x, y, z, yaw.
            along: Whether it begins at that place.
            turned: Whether it is turned to begin with that yaw.
        """
        terms = self.terms.copy()
        first = self.value(0, 0.0)
        if turned:
            angle = begin[3] - first[3]
            c, s = cos(angle), sin(angle)
            x, y = terms[:, 0].copy(), terms[:, 1].copy()
            terms[:, 0], terms[:, 1] = c * x - s * y, s * x + c * y
            terms[:, 3, 0] += angle
        if along:
            terms[:, :3, 0] += begin[:3] - (terms[0, :3, 0])
        return Stored(self.durations, terms)

    def checked(self) -> "Stored":
        """Return itself, if it stays near enough.

        Raises:
            MalformedError: A number is not finite, or it goes too far, or too long.
        """
        lasting = self.durations
        if not ((lasting > 0) & (lasting < LONGEST)).all():
            raise MalformedError("a trajectory with a duration that cannot be")
        with np.errstate(over="ignore", invalid="ignore"):
            reach = np.abs(self.terms) * np.array([_powers(one)[:, 0] for one in lasting])[:, None]
        if not (reach < FARTHEST).all():
            raise MalformedError(f"a trajectory that may reach farther than {FARTHEST:g} m")
        return self

    def plan(self) -> Trajectory:
        """Make the trajectory, from time 0."""
        return Trajectory.polynomial(self.durations.tolist(), self.terms)


def read_pieces(content: bytes, offset: int, count: int) -> Stored:
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
    numbers = unpack(f"{count * PIECE // 4}f", content[offset:])
    rows = np.array(numbers).reshape(count, 4 * POWERS + 1)
    return Stored(rows[:, -1], rows[:, :-1].reshape(count, 4, POWERS)).checked()


def read_compressed(content: bytes, offset: int, count: int) -> Stored:
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
    last = np.array(unpack("4h", content[offset:])) * units
    offset += 8
    durations, terms = np.zeros(count), np.zeros((count, 4, POWERS))
    for piece in range(count):
        # Two bits an axis tell the degree of its curve
        kinds, lasting = unpack("BH", content[offset:])
        durations[piece], offset = lasting / 1000, offset + 3
        for axis in range(4):
            degree = COMPRESSED_DEGREES[kinds >> 2 * axis & 3]
            points = unpack(f"{degree}h", content[offset:])
            offset += 2 * degree
            # Each curve begins where the one before ended
            control = [last[axis], *(one * units[axis] for one in points)]
            terms[piece, axis, : degree + 1] = _monomials(control)
            last[axis] = control[-1]
    if not durations.all():
        raise MalformedError("a piece of a trajectory that takes no time")
    # Terms are by the share of the time; trajectories want them by seconds
    return Stored(durations, terms / np.array([_powers(one).T for one in durations])).checked()


def _monomials(control: list[float]) -> list[float]:
    """Convert the control points of a Bezier curve into coefficients by powers of s in [0, 1]."""
    degree = len(control) - 1
    return [
        math.comb(degree, k)
        * sum((-1.0) ** (k - m) * math.comb(k, m) * control[m] for m in range(k + 1))
        for k in range(degree + 1)
    ]
