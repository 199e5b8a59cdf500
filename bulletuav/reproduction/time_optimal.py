"""Time-optimal flights of a quadrotor through gates, as minimum-snap polynomials.

The position is a piecewise polynomial of degree 7 with the least integral of squared snap between
its junctions. The junctions, which lie in the openings of the gates or between them, and the
durations of the pieces minimise the flight time, with penalties on exceeded limits, by the
Levenberg-Marquardt method. The limits follow from the differential flatness of a quadrotor: with
the thrust f = a + g per mass, of direction n, the body turns at the rate |dn/dt| about horizontal
axes of its own, and n's second derivative needs a torque. The body does not rotate about its
thrust.

References:
    D. Mellinger, V. Kumar, Minimum snap trajectory generation and control for quadrotors (2011).
    Z. Wang, X. Zhou, C. Xu, F. Gao, Geometrically constrained trajectory optimization for
    multicopters (2022): junctions and durations as variables.
    C. Qin, M. Michet, J. Chen, H. Liu, Time-optimal gate-traversing planner for autonomous drone
    racing (2024): the problem, with one or five pieces for each gate.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

TERMS = 8
"""Number of coefficients of a piece: degree 7"""
FIXED = TERMS // 2
"""Number of derivatives that are 0 at both ends, except the position: the flight rests"""
MOTION = 5
"""Number of derivatives from position to snap"""
SAMPLES = 16
"""Number of times per piece at which limits hold; twice as many with one piece per gate"""
START_SPEED, START_DURATION = 3.0, 0.5
"""Speed between gates at the start of the optimisation, m/s, and minimum duration of a piece, s"""
WEIGHTS = (10.0, 100.0, 1000.0)
"""Weights of exceeded limits relative to the flight time, in the order in which they are used"""
GATE_WEIGHT = 10.0
"""Weight of distances from openings, relative to that of limits, 1/m"""
MAX_ITERATIONS = 100
"""Maximum number of iterations for each weight"""
MAX_GROWTH, MAX_SHIFT = 0.3, 1.0
"""Maximum step of the logarithm of a duration, and of a junction, m"""
PRECISION = 1e-5
"""Relative decrease of the objective below which four iterations in a row are the last ones"""
BLUNTNESS = 1.0
"""Thrust per mass below which the direction of the thrust is blurred, m/s^2"""
DENSE = 40
"""Number of times per piece at which a finished flight is checked"""


class QuadrotorLimits(NamedTuple):
    """Limits of a quadrotor without drag.

    Attributes:
        mass: Mass, kg.
        inertia: Moment of inertia about the horizontal body axes, kg m^2.
        lever: Distance of the rotors from the x and from the y axis, m.
        min_thrust: Minimum thrust of each rotor, N.
        max_thrust: Maximum thrust of each rotor, N.
        max_rate: Maximum rate of the thrust direction, rad/s.
        min_height: Minimum height, m.
        gravity: Gravitational acceleration, m/s^2.
    """

    mass: float
    inertia: float
    lever: float
    min_thrust: float
    max_thrust: float
    max_rate: float
    min_height: float
    gravity: float


class Opening(NamedTuple):
    """A convex set that a flight passes.

    Attributes:
        centre: (3,) centre, m.
        normals: (E, 3) outward unit normals of the faces; two opposite ones make it a plane.
        offsets: (E,) distances of the faces from the centre, m.
        radius: Radius of a ball around the centre, m; infinite without a ball.
    """

    centre: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    radius: float

    def excess(self, place: np.ndarray) -> np.ndarray:
        """Return by how far a place (3,) is outside of each face and of the ball, (E + 1,) m."""
        offset = place - self.centre
        size = math.sqrt(float(offset @ offset))
        outside = np.append(self.normals @ offset - self.offsets, size - self.radius)
        excess: np.ndarray = np.maximum(outside, 0.0)
        return excess

    def slope(self, place: np.ndarray) -> np.ndarray:
        """Return the derivatives (E + 1, 3) of `excess` by the place."""
        offset = place - self.centre
        away = offset / max(math.sqrt(float(offset @ offset)), 1e-9)
        slope: np.ndarray = np.append(self.normals, away[None], axis=0)
        slope *= (self.excess(place) > 0.0)[:, None]
        return slope


@dataclass(frozen=True)
class PolynomialFlight:
    """A flight of P polynomials.

    Attributes:
        coefficients: (P, TERMS, 3) coefficients by the elapsed fraction of the piece, m.
        durations: (P,) durations of the pieces, s.
        gates: (G,) number of the junction that lies in each opening.
    """

    coefficients: np.ndarray
    durations: np.ndarray
    gates: np.ndarray

    @property
    def duration(self) -> float:
        """Flight time, s."""
        return float(self.durations.sum())

    def motion(self, time: np.ndarray) -> np.ndarray:
        """Return position, velocity, acceleration, jerk and snap.

        Args:
            time: (T,) times, s; clamped to the flight.

        Returns:
            (T, 5, 3) values, m/s^k.
        """
        ends = np.cumsum(self.durations)
        piece = np.minimum(np.searchsorted(ends, time, side="right"), len(ends) - 1)
        length = self.durations[piece]
        fraction = np.clip((time - ends[piece]) / length + 1.0, 0.0, 1.0)
        values = np.einsum("tkd,tdx->tkx", monomials(fraction, MOTION), self.coefficients[piece])
        scaled: np.ndarray = values * (length[:, None] ** -np.arange(float(MOTION)))[..., None]
        return scaled

    def stretched(self, factor: float) -> "PolynomialFlight":
        """Return the flight along the same path that takes `factor` times as long."""
        return PolynomialFlight(self.coefficients, self.durations * factor, self.gates)


def monomials(fraction: np.ndarray, count: int) -> np.ndarray:
    """Return derivatives (T, count, TERMS) of the powers 0 to 7 at fractions (T,)."""
    values = np.zeros((len(fraction), count, TERMS))
    for k in range(count):
        for d in range(k, TERMS):
            values[:, k, d] = math.perm(d, k) * fraction ** (d - k)
    return values


AT_START, AT_END = monomials(np.array([0.0, 1.0]), TERMS)
"""(TERMS, TERMS) derivatives of the powers at the start and at the end of a piece"""


def _junction_equations(durations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the equations (8 P, 8 P) of the coefficients, and the rows of the junctions."""
    pieces = len(durations)
    scale = durations ** -np.arange(float(TERMS))[:, None]
    matrix = np.zeros((TERMS * pieces, TERMS * pieces))
    matrix[:FIXED, :TERMS] = AT_START[:FIXED] * scale[:FIXED, :1]
    for i in range(pieces - 1):
        row, here = FIXED + TERMS * i, slice(TERMS * i, TERMS * (i + 1))
        there = slice(TERMS * (i + 1), TERMS * (i + 2))
        # The end of a piece is its junction; derivatives 0 to 6 are continuous there
        matrix[row, here] = AT_END[0]
        matrix[row + 1 : row + TERMS, here] = AT_END[:-1] * scale[:-1, i, None]
        matrix[row + 1 : row + TERMS, there] = -AT_START[:-1] * scale[:-1, i + 1, None]
    matrix[-FIXED:, -TERMS:] = AT_END[:FIXED] * scale[:FIXED, -1:]
    return matrix, FIXED + TERMS * np.arange(pieces - 1)


def _by_durations(durations: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the derivatives (8 P, P, 3) of equations times coefficients by the durations."""
    pieces, orders = len(durations), np.arange(float(TERMS))
    slope = np.zeros((TERMS * pieces, pieces, 3))
    for i in range(pieces):
        factor = (-orders * durations[i] ** (-orders - 1.0))[:, None]
        starts, ends = AT_START @ coefficients[i] * factor, AT_END @ coefficients[i] * factor
        before, after = FIXED + TERMS * (i - 1) + 1, FIXED + TERMS * i + 1
        if i == 0:
            slope[:FIXED, i] += starts[:FIXED]
        else:
            slope[before : before + TERMS - 1, i] -= starts[:-1]
        if i == pieces - 1:
            slope[-FIXED:, i] += ends[:FIXED]
        else:
            slope[after : after + TERMS - 1, i] += ends[:-1]
    return slope


def join_pieces(
    junctions: np.ndarray, durations: np.ndarray, ends: np.ndarray, gates: np.ndarray
) -> PolynomialFlight:
    """Return the flight of minimum snap through given points at given times.

    Args:
        junctions: (P - 1, 3) points between the pieces, m.
        durations: (P,) durations, s.
        ends: (2, 3) start and end, m, where the flight rests.
        gates: (G,) number of the junction in each opening.
    """
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    matrix, rows = _junction_equations(durations)
    right = np.zeros((len(matrix), 3))
    right[0], right[-FIXED], right[rows] = ends[0], ends[1], junctions
    solved = splu(csc_matrix(matrix)).solve(right)
    return PolynomialFlight(solved.reshape(-1, TERMS, 3), durations, gates)


def flat_attitude(motion: np.ndarray, gravity: float) -> tuple[np.ndarray, ...]:
    """Return thrust, its direction and the derivatives of the direction.

    Args:
        motion: (..., 5, 3) position and derivatives up to snap.
        gravity: Gravitational acceleration, m/s^2.

    Returns:
        (...) thrust per mass, m/s^2; (..., 3) direction n; (..., 3) dn/dt, 1/s; (..., 3) part of
        n's second derivative across n, 1/s^2.
    """
    force = motion[..., 2, :] + np.array((0.0, 0.0, gravity))
    jerk, snap = motion[..., 3, :], motion[..., 4, :]
    size = np.sqrt((force**2).sum(-1))
    along = force / np.maximum(size, 1e-9)[..., None]
    blunt = np.sqrt(size**2 + BLUNTNESS**2)[..., None]
    growth = (along * jerk).sum(-1)[..., None]
    turn = (jerk - growth * along) / blunt
    across = snap - (along * snap).sum(-1)[..., None] * along
    return size, along, turn, (across - 2.0 * growth * turn) / blunt


def exceed_limits(motion: np.ndarray, limits: QuadrotorLimits) -> np.ndarray:
    """Return by how much limits are exceeded; negative values are reserves.

    The torque about an axis between the arms takes sqrt(2) / (4 lever) of it as thrust of a rotor,
    the most of all axes.

    Args:
        motion: (..., 5, 3) position and derivatives up to snap.
        limits: Limits of the quadrotor.

    Returns:
        (..., 4) excess of maximum and minimum thrust, relative to the maximum; of the rate,
            relative to the maximum, times the squared relative thrust, so that it is smooth where
            the thrust is small; and of the height, m.
    """
    size, _, turn, bend = flat_attitude(motion, limits.gravity)
    torque = limits.inertia * np.sqrt((bend**2).sum(-1) + 1e-6)
    share = math.sqrt(2.0) / (4.0 * limits.lever) * torque / limits.max_thrust
    relative = limits.mass * size / (4.0 * limits.max_thrust)
    rate = np.sqrt((turn**2).sum(-1) + 1e-6)
    return np.stack(
        [
            relative + share - 1.0,
            limits.min_thrust / limits.max_thrust + share - relative,
            (rate / limits.max_rate - 1.0) * relative**2,
            limits.min_height - motion[..., 0, 2],
        ],
        axis=-1,
    )


class _Problem:
    """The least-squares problem of one number of pieces and one weight."""

    def __init__(
        self,
        openings: Sequence[Opening],
        gates: np.ndarray,
        ends: np.ndarray,
        limits: QuadrotorLimits,
        pieces: int,
        samples: int,
        weight: float,
    ) -> None:
        self.openings, self.gates, self.ends, self.limits = openings, gates, ends, limits
        self.pieces, self.samples, self.weight = pieces, samples, weight
        self.basis = monomials((np.arange(samples) + 0.5) / samples, MOTION)

    def flight(self, x: np.ndarray) -> PolynomialFlight:
        """Return the flight of the variables: junctions and logarithms of durations."""
        count = 3 * (self.pieces - 1)
        return join_pieces(x[:count].reshape(-1, 3), np.exp(x[count:]), self.ends, self.gates)

    def _motion(self, flight: PolynomialFlight) -> np.ndarray:
        values = np.einsum("mkd,pdx->pmkx", self.basis, flight.coefficients)
        powers = flight.durations[:, None] ** -np.arange(float(MOTION))
        motion: np.ndarray = values * powers[:, None, :, None]
        return motion.reshape(-1, MOTION, 3)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Return flight time and weighted excesses; the limits as an integral over time."""
        flight = self.flight(x)
        excess = np.maximum(exceed_limits(self._motion(flight), self.limits), 0.0)
        root = np.repeat(np.sqrt(flight.durations / self.samples), self.samples)[:, None]
        return np.concatenate(
            [
                [flight.duration],
                self.weight * (root * excess).ravel(),
                GATE_WEIGHT * self.weight * self._gates(x, Opening.excess),
            ]
        )

    def _gates(
        self, x: np.ndarray, measure: Callable[[Opening, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        places = x[: 3 * (self.pieces - 1)].reshape(-1, 3)[self.gates]
        pairs = zip(self.openings, places, strict=True)
        return np.concatenate([measure(opening, place) for opening, place in pairs])

    def linearize(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals that are not 0, and their derivatives."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        flight, pieces, samples = self.flight(x), self.pieces, self.samples
        durations, inner = flight.durations, pieces - 1
        matrix, rows = _junction_equations(durations)
        factors = splu(csc_matrix(matrix))
        right = np.zeros((len(matrix), inner))
        right[rows, np.arange(inner)] = 1.0
        of_junctions = factors.solve(right).reshape(pieces, TERMS, inner)
        right = -_by_durations(durations, flight.coefficients).reshape(len(matrix), -1)
        of_durations = factors.solve(right).reshape(pieces, TERMS, 3 * pieces)

        # Samples at which a limit is exceeded, and derivatives of the limits there
        motion = self._motion(flight)
        excess = exceed_limits(motion, self.limits)
        active = np.flatnonzero((excess > 0.0).any(axis=1))
        own, at = active // samples, active % samples
        motion, excess = motion[active], np.maximum(excess[active], 0.0)
        slope = np.zeros((len(active), 4, MOTION, 3))
        for k in (0, 2, 3, 4):
            step = 1e-6 * (1.0 + float(np.abs(motion[:, k]).max(initial=0.0)))
            for axis in range(3):
                moved = motion.copy()
                moved[:, k, axis] += step
                upper = exceed_limits(moved, self.limits)
                moved[:, k, axis] -= 2.0 * step
                difference = upper - exceed_limits(moved, self.limits)
                slope[:, :, k, axis] = difference / (2.0 * step)
        root = np.sqrt(durations[own] / samples)[:, None]
        slope *= (self.weight * root * (excess > 0.0))[..., None, None]
        values = self.weight * root * excess

        # Chain rule through the coefficients, whose derivatives scale with the durations
        powers = durations[own, None] ** -np.arange(float(MOTION))
        basis = self.basis[at] * powers[..., None]
        by_coefficient = np.einsum("stkx,skd->stxd", slope, basis)
        table = by_coefficient.reshape(len(active), 12, TERMS)
        junction = (table @ of_junctions[own]).reshape(len(active), 4, 3, inner)
        wide = table @ of_durations[own]
        wide = wide.reshape(len(active), 4, 3, pieces, 3)
        duration = np.einsum("stxix->sti", wide)
        each = np.arange(len(active))
        orders = np.arange(float(MOTION)) / durations[own, None]
        duration[each, :, own] -= np.einsum("stkx,sk,skx->st", slope, orders, motion)
        duration[each, :, own] += 0.5 * values / durations[own, None]
        limits = np.concatenate(
            [
                junction.transpose(0, 1, 3, 2).reshape(len(active) * 4, 3 * inner),
                (duration * durations).reshape(len(active) * 4, pieces),
            ],
            axis=1,
        )

        slopes = self._gates(x, Opening.slope)
        gates = np.zeros((len(slopes), len(x)))
        first = 0
        for gate, opening in zip(self.gates.tolist(), self.openings, strict=True):
            after = first + len(opening.normals) + 1
            gates[first:after, 3 * gate : 3 * gate + 3] = slopes[first:after]
            first = after
        gates *= GATE_WEIGHT * self.weight
        total = np.concatenate([np.zeros(3 * inner), durations])
        residuals = [[flight.duration], values.ravel()]
        residuals.append(GATE_WEIGHT * self.weight * self._gates(x, Opening.excess))
        return np.concatenate(residuals), np.concatenate([total[None], limits, gates])

    def solve(self, x: np.ndarray, iterations: int) -> np.ndarray:
        """Minimise the sum of squares by the Levenberg-Marquardt method."""
        count, damping, stalled = 3 * (self.pieces - 1), 1e-2, 0
        cost = float((self.residuals(x) ** 2).sum())
        for _ in range(iterations):
            values, slope = self.linearize(x)
            hessian, gradient = slope.T @ slope, slope.T @ values
            scale = np.diag(hessian.diagonal() + 1e-3)
            while damping < 1e8:
                step = -np.linalg.solve(hessian + damping * scale, gradient)
                growth, shift = np.abs(step[count:]).max(), np.abs(step[:count]).max()
                step *= min(1.0, MAX_GROWTH / growth, MAX_SHIFT / max(shift, 1e-9))
                new_cost = float((self.residuals(x + step) ** 2).sum())
                if new_cost < cost:
                    break
                damping *= 3.0
            else:
                break
            x, gain, cost = x + step, 1.0 - new_cost / cost, new_cost
            damping = max(damping / 3.0, 1e-8)
            stalled = stalled + 1 if gain < PRECISION else 0
            if stalled == 4:
                break
        return x


def optimize_flight(
    openings: Sequence[Opening],
    ends: np.ndarray,
    limits: QuadrotorLimits,
    pieces: Sequence[int] = (1, 3, 5),
    iterations: int = MAX_ITERATIONS,
) -> list[PolynomialFlight]:
    """Find fast flights through openings in order, from rest to rest.

    Each flight starts from that with fewer pieces, which are divided; the first one from the
    centres of the openings. Each flight is stretched until no limit is exceeded.

    Args:
        openings: Openings in order.
        ends: (2, 3) start and end, m.
        limits: Limits of the quadrotor.
        pieces: Numbers of polynomials from gate to gate, each a multiple or more of the one before.
        iterations: Maximum number of iterations for each weight.

    Returns:
        A flight for each number of pieces; local optima.
    """
    legs = len(openings) + 1
    places = np.array([opening.centre for opening in openings])
    path = np.concatenate([ends[:1], places, ends[1:]])
    lengths = np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))
    durations = np.maximum(lengths / START_SPEED, START_DURATION)
    flights: list[PolynomialFlight] = []
    flight = join_pieces(places, durations, ends, np.arange(legs - 1))
    for number in pieces:
        flight = _divide(flight, legs, number)
        junctions = flight.coefficients[1:, 0]
        x = np.concatenate([junctions.ravel(), np.log(flight.durations)])
        samples = SAMPLES * (2 if number == 1 else 1)
        for weight in WEIGHTS:
            problem = _Problem(openings, flight.gates, ends, limits, legs * number, samples, weight)
            x = problem.solve(x, iterations)
        flight = problem.flight(x)
        flights.append(stretch_to_limits(flight, limits))
    return flights


def _divide(flight: PolynomialFlight, legs: int, number: int) -> PolynomialFlight:
    """Return the flight with another number of equal pieces for each leg."""
    per = len(flight.durations) // legs
    whole = flight.durations.reshape(legs, per).sum(axis=1)
    starts = np.cumsum(whole) - whole
    times = (starts[:, None] + whole[:, None] * np.arange(1, number + 1) / number).ravel()
    places = flight.motion(times)[:, 0]
    gates = number * np.arange(1, legs) - 1
    ends = np.stack([flight.coefficients[0, 0], places[-1]])
    return join_pieces(places[:-1], np.repeat(whole / number, number), ends, gates)


def stretch_to_limits(flight: PolynomialFlight, limits: QuadrotorLimits) -> PolynomialFlight:
    """Return the fastest flight along the same path, at the same relative speeds, within limits.

    The minimum thrust and the height are not considered: slower flights do not mend them.
    """
    edges = np.concatenate([[0.0], np.cumsum(flight.durations)])
    fraction = (np.arange(DENSE) + 0.5) / DENSE
    times = (edges[:-1, None] + flight.durations[:, None] * fraction).ravel()

    def exceeds(factor: float) -> bool:
        excess = exceed_limits(flight.stretched(factor).motion(times * factor), limits)
        return bool((excess[:, (0, 2)] > 0.0).any())

    low, high = 0.9, 1.5
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if exceeds(middle) else (low, middle)
    return flight.stretched(high)
