"""Racing lines: ways through gates, how fast they can be flown, and the fastest one.

A line is a row of cubic Hermite curves, one to each gate. It is flown as fast as the limits of
speed and acceleration allow: J. Bobrow, S. Dubowsky, J. Gibson, Time-optimal control of robotic
manipulators along specified paths (1985), here for a point.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, dot, minus

SAMPLES = 24
"""Points of a line on the way to each gate"""
NO_LENGTH = 1e-9
"""Length below which a way has no direction, m"""
TINY = 1e-12
"""Keeps divisions from 0"""
ASIDE, HIGH, TURN, RISE, COMES, LEAVES = range(6)
"""What a line chooses at each gate: where in the opening to pass it, as shares of the room to the
left and up; the direction, left and up of the gate's, rad; and how long the curves' tangents are
that come and leave, in lengths of the straight way"""
DIRECT = 1.15
"""Usual length of tangents; the better one of 1 and 1.15 on 30 random tracks"""
BOUNDS = ((-1.0, 1.0), (-1.0, 1.0), (-0.8, 0.8), (-0.8, 0.8), (0.15, 2.5), (0.15, 2.5))
"""Least and greatest of each"""


class Limits(NamedTuple):
    """Limits that lines are flown by.

    Attributes:
        speed: Greatest speed, m/s.
        acceleration: Greatest acceleration in any direction, without drag, m/s^2.
        drag: Deceleration by drag per speed, 1/s.
    """

    speed: float
    acceleration: float
    drag: float


class Way(NamedTuple):
    """What a line has to pass through.

    Attributes:
        point: (M, 3) the start, then middles of gates in turn, m.
        axis: (M, 3, 3) axes of the gates; of the start x counts, as its direction.
        room: (M,) how far from the middle a line can pass, to each side, m; 0 at the start.
        first_speed: At the start, m/s.
    """

    point: np.ndarray
    axis: np.ndarray
    room: np.ndarray
    first_speed: float


class Line(NamedTuple):
    """A line with its times, at K = (M - 1) SAMPLES + 1 points.

    Attributes:
        position: (K, 3) m.
        time: (K,) since the start, s.
        velocity: (K, 3) m/s.
    """

    position: np.ndarray
    time: np.ndarray
    velocity: np.ndarray


@func
def knot(
    m: int, choice: np.ndarray, point: np.ndarray, axis: np.ndarray, room: np.ndarray
) -> tuple[Vec3, Vec3]:
    """Compute where a line passes gate m, m, and in which direction."""
    # Spherical angles about the direction through the gate
    turn, rise = choice[TURN, m], choice[RISE, m]
    ahead, left, up = cos(turn) * cos(rise), sin(turn) * cos(rise), sin(rise)
    aside, high = room[m] * choice[ASIDE, m], room[m] * choice[HIGH, m]
    # Axes of the gate: through it, to the left, up
    x, y, z = (axis[m, 0, 0], axis[m, 0, 1], axis[m, 0, 2]), axis[m, 1], axis[m, 2]
    # Off the middle within the room that is left for errors
    place = (
        point[m, 0] + aside * y[0] + high * z[0],
        point[m, 1] + aside * y[1] + high * z[1],
        point[m, 2] + aside * y[2] + high * z[2],
    )
    direction = (
        ahead * x[0] + left * y[0] + up * z[0],
        ahead * x[1] + left * y[1] + up * z[1],
        ahead * x[2] + left * y[2] + up * z[2],
    )
    return place, direction


@kernel
def draw_line(
    point: np.ndarray, axis: np.ndarray, room: np.ndarray, choice: np.ndarray, line: np.ndarray
) -> None:
    """Draw the curves between gates.

    Args:
        point: (M, 3) see `Way`, m.
        axis: (M, 3, 3) see `Way`.
        room: (M,) see `Way`, m.
        choice: (6, M) what the line chooses, see `ASIDE`.
        line: (K, 3) m; written.
    """
    for m in range(point.shape[0] - 1):
        here, along = knot(m, choice, point, axis, room)
        there, onward = knot(m + 1, choice, point, axis, room)
        gap = minus(there, here)
        length = math.sqrt(dot(gap, gap))
        leaving, coming = length * choice[LEAVES, m], length * choice[COMES, m + 1]
        for s in range(SAMPLES + 1):
            u = s / SAMPLES
            # Hermite's four polynomials.
            at_start = (1.0 + 2.0 * u) * (1.0 - u) ** 2
            leaves = leaving * u * (1.0 - u) ** 2
            at_end = u * u * (3.0 - 2.0 * u)
            comes = coming * u * u * (u - 1.0)
            for k in range(3):
                line[m * SAMPLES + s, k] = (
                    at_start * here[k] + leaves * along[k] + at_end * there[k] + comes * onward[k]
                )


@func
def along_line(bend: float, square: float, limits: Limits) -> float:
    """Compute the acceleration that turning leaves for speeding up and braking, m/s^2.

    Args:
        bend: Curvature, 1/m.
        square: Of the speed, m^2/s^2.
        limits: Of the acceleration.
    """
    most, across = limits.acceleration, bend * square
    return math.sqrt(max(most * most - across * across, 0.0))


@func
def fastest_square(bend: float, limits: Limits) -> float:
    """Compute the square of the speed that can be kept in a curve, m^2/s^2.

    Acceleration has to turn the velocity and to bear the drag: (bend v^2)^2 + (drag v)^2 is its
    square.
    """
    drag = limits.drag**2
    turn = 2.0 * bend * limits.acceleration
    # The root of a quadratic equation, in the form that holds for straight lines, too.
    root = 2.0 * limits.acceleration**2 / (drag + math.sqrt(drag * drag + turn * turn) + TINY)
    return min(root, limits.speed**2)


@kernel
def time_line(
    line: np.ndarray,
    count: int,
    first_speed: float,
    limits: Limits,
    time: np.ndarray,
    velocity: np.ndarray,
    room: np.ndarray,
) -> None:
    """Find out how fast a line can be flown, from a first speed to any speed at its end.

    Args:
        line: (K, 3) points, m.
        count: How many of them there are.
        first_speed: m/s.
        limits: Of speed and acceleration.
        time: (K,) when to be there, s; written.
        velocity: (K, 3) m/s; written.
        room: (K, 3) room to work in.
    """
    length, bend, square = room[:, 0], room[:, 1], room[:, 2]
    # Lengths and directions of the pieces; directions are kept in `velocity`.
    for s in range(count - 1):
        total = 0.0
        for k in range(3):
            velocity[s, k] = line[s + 1, k] - line[s, k]
            total += velocity[s, k] ** 2
        length[s] = max(math.sqrt(total), NO_LENGTH)
        for k in range(3):
            velocity[s, k] /= length[s]
    # Curvature: change of direction over length. It limits the speed.
    for s in range(count):
        bend[s] = 0.0
        if 0 < s < count - 1:
            change = 0.0
            for k in range(3):
                change += (velocity[s, k] - velocity[s - 1, k]) ** 2
            bend[s] = 2.0 * math.sqrt(change) / (length[s] + length[s - 1])
        square[s] = fastest_square(bend[s], limits)
    # Forwards: speed up with what turning leaves of the acceleration. Backwards: brake in time.
    square[0] = min(square[0], first_speed**2)
    for s in range(count - 1):
        gain = along_line(bend[s], square[s], limits) - limits.drag * math.sqrt(square[s])
        square[s + 1] = min(square[s + 1], square[s] + 2.0 * gain * length[s])
    for s in range(count - 1, 0, -1):
        gain = along_line(bend[s], square[s], limits) + limits.drag * math.sqrt(square[s])
        square[s - 1] = min(square[s - 1], square[s] + 2.0 * gain * length[s - 1])
    # Times between points, at the mean of their speeds.
    time[0] = 0.0
    for s in range(count - 1):
        both = math.sqrt(square[s]) + math.sqrt(square[s + 1])
        # The mean of two speeds is exact for a constant acceleration
        time[s + 1] = time[s] + 2.0 * length[s] / max(both, NO_LENGTH)
    # Velocities along the mean of the directions before and behind.
    for k in range(3):
        velocity[count - 1, k] = velocity[count - 2, k]
    for s in range(count - 1, -1, -1):
        # From the end, so that the piece before still has its own direction
        total = 0.0
        for k in range(3):
            if 0 < s < count - 1:
                velocity[s, k] += velocity[s - 1, k]
            total += velocity[s, k] ** 2
        share = math.sqrt(square[s] / max(total, NO_LENGTH))
        for k in range(3):
            velocity[s, k] *= share


def line_of(way: Way, choice: np.ndarray, limits: Limits) -> Line:
    """Draw and time the line that chooses (6, M) as `ASIDE` and those after it tell."""
    count = (len(way.point) - 1) * SAMPLES + 1
    position, velocity, room = np.empty((3, count, 3))
    time = np.empty(count)
    draw_line(way.point, way.axis, way.room, choice, position)
    time_line(position, count, way.first_speed, limits, time, velocity, room)
    return Line(position, time, velocity)


def usual_choice(gates: int) -> np.ndarray:
    """Choose the middles of gates, and their directions, (6, M)."""
    return np.repeat([[0.0], [0.0], [0.0], [0.0], [DIRECT], [DIRECT]], gates, axis=1)


def fastest_choice(way: Way, limits: Limits, precision: float = 1e-7) -> np.ndarray:
    """Choose the fastest line through gates, by scipy's L-BFGS-B from the usual one.

    Args:
        way: What it has to pass through.
        limits: Of speed and acceleration.
        precision: Gain, as a share of the time, at which the search ends.

    Returns:
        (6, M): a local optimum among cubic lines.
    """
    from scipy.optimize import minimize  # which takes long to import

    first = usual_choice(len(way.point))

    def duration(numbers: np.ndarray) -> float:
        return float(line_of(way, numbers.reshape(first.shape), limits).time[-1])

    bounds = [side for side in BOUNDS for _ in range(first.shape[1])]
    rules = {"ftol": precision}
    found = minimize(duration, first.ravel(), method="L-BFGS-B", bounds=bounds, options=rules)
    chosen: np.ndarray = found.x.reshape(first.shape)
    return chosen
