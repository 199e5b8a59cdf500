"""Racing lines: splines through gates, their speed profiles, and their optimisation.

A line is a sequence of cubic Hermite curves, one to each gate. Its speed profile is the fastest one
within the limits of speed and acceleration, computed for a point mass.

References:
    J. Bobrow, S. Dubowsky, J. Gibson, Time-optimal control of robotic manipulators along specified
    paths (1985).
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, dot, minus

SAMPLES = 24
"""Number of points of a line per gate"""
MIN_NORM = 1e-9
"""Minimum length of a vector that has a direction, m"""
EPSILON = 1e-12
"""Offset that prevents divisions by 0"""
LATERAL, VERTICAL, YAW, PITCH, TANGENT_IN, TANGENT_OUT = range(6)
"""Rows of the line parameters of each gate: offsets in the opening to the left and up, as
fractions of the clearance; yaw and pitch of the direction relative to the gate, rad; and
lengths of the incoming and outgoing tangents, as fractions of the distance between gates"""
DEFAULT_TANGENT = 1.15
"""Default length of tangents; the better one of 1 and 1.15 on 30 random tracks"""
BOUNDS = ((-1.0, 1.0), (-1.0, 1.0), (-0.8, 0.8), (-0.8, 0.8), (0.15, 2.5), (0.15, 2.5))
"""Lower and upper bound of each parameter"""


class RacingLimits(NamedTuple):
    """Limits of speed profiles.

    Attributes:
        speed: Maximum speed, m/s.
        acceleration: Maximum acceleration in any direction, without drag, m/s^2.
        drag: Deceleration by drag per speed, 1/s.
    """

    speed: float
    acceleration: float
    drag: float


class GatePath(NamedTuple):
    """Start and gates of a line.

    Attributes:
        point: (M, 3) start, then centres of the gates in order, m.
        axis: (M, 3, 3) axes of the gates; the x axis of the start is its direction.
        clearance: (M,) maximum distance of the line from the centre, m; 0 at the start.
        first_speed: Speed at the start, m/s.
    """

    point: np.ndarray
    axis: np.ndarray
    clearance: np.ndarray
    first_speed: float


class RacingLine(NamedTuple):
    """A line with its times, at K = (M - 1) SAMPLES + 1 points.

    Attributes:
        position: (K, 3) positions, m.
        time: (K,) times since the start, s.
        velocity: (K, 3) velocities, m/s.
    """

    position: np.ndarray
    time: np.ndarray
    velocity: np.ndarray


@func
def gate_knot(
    m: int, parameters: np.ndarray, point: np.ndarray, axis: np.ndarray, clearance: np.ndarray
) -> tuple[Vec3, Vec3]:
    """Return the point where a line passes gate m, m, and its direction there."""
    # Spherical angles relative to the direction of the gate
    turn, rise = parameters[YAW, m], parameters[PITCH, m]
    ahead, left, up = cos(turn) * cos(rise), sin(turn) * cos(rise), sin(rise)
    aside, high = clearance[m] * parameters[LATERAL, m], clearance[m] * parameters[VERTICAL, m]
    # Axes of the gate: through it, to the left, up
    x, y, z = (axis[m, 0, 0], axis[m, 0, 1], axis[m, 0, 2]), axis[m, 1], axis[m, 2]
    # Offset from the centre within the clearance
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
def evaluate_line(
    point: np.ndarray,
    axis: np.ndarray,
    clearance: np.ndarray,
    parameters: np.ndarray,
    line: np.ndarray,
) -> None:
    """Evaluate the cubic Hermite curves between gates.

    Args:
        point: (M, 3) see `GatePath`, m.
        axis: (M, 3, 3) see `GatePath`.
        clearance: (M,) see `GatePath`, m.
        parameters: (6, M) line parameters, see `LATERAL`.
        line: (K, 3) points, m; written.
    """
    for m in range(point.shape[0] - 1):
        here, along = gate_knot(m, parameters, point, axis, clearance)
        there, onward = gate_knot(m + 1, parameters, point, axis, clearance)
        offset = minus(there, here)
        length = math.sqrt(dot(offset, offset))
        leaving, coming = (
            length * parameters[TANGENT_OUT, m],
            length * parameters[TANGENT_IN, m + 1],
        )
        for s in range(SAMPLES + 1):
            u = s / SAMPLES
            # Hermite basis polynomials.
            at_start = (1.0 + 2.0 * u) * (1.0 - u) ** 2
            leaves = leaving * u * (1.0 - u) ** 2
            at_end = u * u * (3.0 - 2.0 * u)
            comes = coming * u * u * (u - 1.0)
            for k in range(3):
                line[m * SAMPLES + s, k] = (
                    at_start * here[k] + leaves * along[k] + at_end * there[k] + comes * onward[k]
                )


@func
def tangential_acceleration(curvature: float, squared_speed: float, limits: RacingLimits) -> float:
    """Compute the tangential acceleration that remains in a turn, m/s^2.

    Args:
        curvature: Curvature, 1/m.
        squared_speed: Squared speed, m^2/s^2.
        limits: Limits of the acceleration.
    """
    total, across = limits.acceleration, curvature * squared_speed
    return math.sqrt(max(total * total - across * across, 0.0))


@func
def max_squared_speed(curvature: float, limits: RacingLimits) -> float:
    """Compute the square of the maximum steady speed in a curve, m^2/s^2.

    The acceleration turns the velocity and compensates the drag: (bend v^2)^2 + (drag v)^2 equals
    its square.
    """
    drag = limits.drag**2
    turn = 2.0 * curvature * limits.acceleration
    # Root of a quadratic equation, in a form that is valid for zero curvature, too.
    root = 2.0 * limits.acceleration**2 / (drag + math.sqrt(drag * drag + turn * turn) + EPSILON)
    return min(root, limits.speed**2)


@kernel
def compute_speed_profile(
    line: np.ndarray,
    count: int,
    first_speed: float,
    limits: RacingLimits,
    time: np.ndarray,
    velocity: np.ndarray,
    scratch: np.ndarray,
) -> None:
    """Compute the fastest speed profile of a line, with a given first speed and a free last speed.

    Args:
        line: (K, 3) points, m.
        count: Number of points.
        first_speed: Speed at the first point, m/s.
        limits: Limits of speed and acceleration.
        time: (K,) times at the points, s; written.
        velocity: (K, 3) velocities at the points, m/s; written.
        scratch: (K, 3) work buffer.
    """
    length, curvature, squared_speed = scratch[:, 0], scratch[:, 1], scratch[:, 2]
    # Lengths and directions of the segments; directions are stored in `velocity`.
    for s in range(count - 1):
        total = 0.0
        for k in range(3):
            velocity[s, k] = line[s + 1, k] - line[s, k]
            total += velocity[s, k] ** 2
        length[s] = max(math.sqrt(total), MIN_NORM)
        for k in range(3):
            velocity[s, k] /= length[s]
    # Curvature, the change of direction over length, limits the speed.
    for s in range(count):
        curvature[s] = 0.0
        if 0 < s < count - 1:
            change = 0.0
            for k in range(3):
                change += (velocity[s, k] - velocity[s - 1, k]) ** 2
            curvature[s] = 2.0 * math.sqrt(change) / (length[s] + length[s - 1])
        squared_speed[s] = max_squared_speed(curvature[s], limits)
    # Forward pass: accelerate with the remaining tangential acceleration. Backward pass: brake.
    squared_speed[0] = min(squared_speed[0], first_speed**2)
    for s in range(count - 1):
        gain = tangential_acceleration(
            curvature[s], squared_speed[s], limits
        ) - limits.drag * math.sqrt(squared_speed[s])
        squared_speed[s + 1] = min(squared_speed[s + 1], squared_speed[s] + 2.0 * gain * length[s])
    for s in range(count - 1, 0, -1):
        gain = tangential_acceleration(
            curvature[s], squared_speed[s], limits
        ) + limits.drag * math.sqrt(squared_speed[s])
        squared_speed[s - 1] = min(
            squared_speed[s - 1], squared_speed[s] + 2.0 * gain * length[s - 1]
        )
    time[0] = 0.0
    for s in range(count - 1):
        both = math.sqrt(squared_speed[s]) + math.sqrt(squared_speed[s + 1])
        # The mean speed is exact for a constant acceleration
        time[s + 1] = time[s] + 2.0 * length[s] / max(both, MIN_NORM)
    # Velocities along the mean of the adjacent directions.
    for k in range(3):
        velocity[count - 1, k] = velocity[count - 2, k]
    for s in range(count - 1, -1, -1):
        # Backwards, so that the previous segment still has its own direction
        total = 0.0
        for k in range(3):
            if 0 < s < count - 1:
                velocity[s, k] += velocity[s - 1, k]
            total += velocity[s, k] ** 2
        factor = math.sqrt(squared_speed[s] / max(total, MIN_NORM))
        for k in range(3):
            velocity[s, k] *= factor


def make_line(path: GatePath, parameters: np.ndarray, limits: RacingLimits) -> RacingLine:
    """Compute a line and its speed profile from line parameters (6, M), see `LATERAL`."""
    count = (len(path.point) - 1) * SAMPLES + 1
    position, velocity, scratch = np.empty((3, count, 3))
    time = np.empty(count)
    evaluate_line(path.point, path.axis, path.clearance, parameters, position)
    compute_speed_profile(position, count, path.first_speed, limits, time, velocity, scratch)
    return RacingLine(position, time, velocity)


def default_parameters(gates: int) -> np.ndarray:
    """Return the default line parameters (6, M): centres and directions of the gates."""
    return np.repeat(
        [[0.0], [0.0], [0.0], [0.0], [DEFAULT_TANGENT], [DEFAULT_TANGENT]], gates, axis=1
    )


def optimize_line(path: GatePath, limits: RacingLimits, precision: float = 1e-7) -> np.ndarray:
    """Optimise the line parameters for minimum time with scipy's L-BFGS-B, from the default ones.

    Args:
        path: Start and gates of the line.
        limits: Limits of speed and acceleration.
        precision: Relative improvement of the time at which the optimisation stops.

    Returns:
        (6, M) line parameters, a local optimum among cubic splines.
    """
    from scipy.optimize import minimize  # lazy: slow to import

    first = default_parameters(len(path.point))

    def duration(numbers: np.ndarray) -> float:
        return float(make_line(path, numbers.reshape(first.shape), limits).time[-1])

    bounds = [side for side in BOUNDS for _ in range(first.shape[1])]
    settings = {"ftol": precision}
    found = minimize(duration, first.ravel(), method="L-BFGS-B", bounds=bounds, options=settings)
    chosen: np.ndarray = found.x.reshape(first.shape)
    return chosen
