"""Half-spaces of collision-free velocities, shared by the avoidance policies.

A half-space is a unit normal n and a bound b, m/s: the set of velocities v with n . v >= b. The
half-space of a moving body is that of ORCA (J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal
n-body collision avoidance, 2011), extended to three dimensions. Equation numbers refer to this
paper.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.closest_approach import insert_nearest
from bulletuav.geometry.grid import sort_by_key
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, vec3
from bulletuav.policies.linear_program import solve_velocity, write_half_space
from bulletuav.policies.traffic import Traffic

SYMMETRY_BREAKING_TURN = 0.05
"""Right turn of every preferred velocity, rad; without it, exactly head-on drones would only
stop"""
MAX_TURN = 1.4
"""Right turn of a fully blocked preferred velocity, rad: 80 degrees, nearly along a wall"""
MIN_TURN = 1e-9
"""Minimum angle that is turned, rad"""
MIN_NORM = 1e-9
"""Minimum length of a vector that has a direction, m or m/s"""

MAX_INSERTED = 32
"""Number of other drones up to which they are sorted by insertion"""

HalfSpace = tuple[Vec3, float]
"""Unit normal n and bound b, m/s, of the velocities v with n . v >= b"""


class AvoidanceParameters(NamedTuple):
    """Parameters of collision avoidance.

    Attributes:
        separation: Distance between centres to maintain, m.
        horizon: Time horizon tau of conflict detection, s.
        braking_time: Minimum time to reach a static surface, s.
        recovery_time: Time in which an existing violation is resolved, s; one time step in the
            paper.
        max_speed: Speed limit, m/s.
    """

    separation: float
    horizon: float
    braking_time: float
    recovery_time: float
    max_speed: float


@func
def add_half_space(rows: np.ndarray, count: int, space: HalfSpace, max_speed: float) -> int:
    """Append a half-space unless it contains all permitted velocities; return the new count."""
    if space[1] <= -max_speed:
        return count
    write_half_space(rows, 0, count, space[0], space[1])
    return count + 1


@kernel
def find_nearest_drones(
    traffic: Traffic, w: int, i: int, max_distance: float, near: np.ndarray, distance: np.ndarray
) -> int:
    """Find the known drones within a distance of drone i, sorted by distance.

    Args:
        traffic: The traffic around each drone.
        w: Index of the world.
        i: Index of the drone.
        max_distance: Maximum distance, m.
        near: (M,) indices of the other drones, written.
        distance: (M,) their squared distances, m^2, written.

    Returns:
        The number of drones found.
    """
    found = 0
    for k in range(near.size):
        if traffic.known[w, i, k]:
            # Squared distances have the same order, and need no square root
            offset = vec3(traffic.offset[w], i, k)
            square = dot(offset, offset)
            if square <= max_distance * max_distance:
                if near.size <= MAX_INSERTED:
                    found = insert_nearest(near, distance, found, k, square)
                else:
                    near[found], distance[found] = k, square
                    found += 1
    if near.size > MAX_INSERTED:
        sort_by_key(distance, near, found)
    return found


@func
def max_conflict_distance(parameters: AvoidanceParameters) -> float:
    """Return the distance beyond which no drones can conflict within the horizon, m."""
    return parameters.separation + 2.0 * parameters.max_speed * parameters.horizon


@kernel
def add_obstacle_half_spaces(
    rows: np.ndarray, count: int, traffic: Traffic, parameters: AvoidanceParameters, w: int, i: int
) -> int:
    """Append the half-spaces of spheres and surfaces, for which the drone takes all responsibility.

    Args:
        rows: (DEPTH, M, 4) half-spaces; those of depth 0 are written.
        count: Number of half-spaces so far.
        traffic: The traffic around each drone.
        parameters: Parameters of collision avoidance.
        w: Index of the world.
        i: Index of the drone.

    Returns:
        The new number of half-spaces.
    """
    own = vec3(traffic.velocity, w, i)
    for k in range(traffic.sphere_radius.shape[2]):
        # Unused rows have radius 0.
        radius = traffic.sphere_radius[w, i, k]
        if radius > 0.0:
            offset = vec3(traffic.sphere[w], i, k)
            other_velocity = vec3(traffic.sphere_velocity[w], i, k)
            space = orca_half_space(offset, own, other_velocity, radius, parameters, 1.0)
            count = add_half_space(rows, count, space, parameters.max_speed)
    # At a permitted velocity, the drone does not reach a surface within the braking time.
    for k in range(traffic.surface.shape[2]):
        n = vec3(traffic.surface[w], i, k)
        bound = -traffic.surface[w, i, k, 3] / parameters.braking_time
        count = add_half_space(rows, count, (n, bound), parameters.max_speed)
    return count


@func
def orca_half_space(
    offset: Vec3,
    own: Vec3,
    other_velocity: Vec3,
    radius: float,
    parameters: AvoidanceParameters,
    responsibility: float,
) -> HalfSpace:
    """Compute the ORCA half-space of velocities that avoid a body.

    The velocity obstacle of the time horizon tau is a cone truncated by the ball of radius / tau
    around offset / tau. The vector u (equation 3) points from the relative velocity to the nearest
    boundary of the velocity obstacle; the drone performs the fraction `responsibility` of it
    (equations 5 and 6).

    Args:
        offset: Offset from the drone to the body, m.
        own: Velocity of the drone, m/s.
        other_velocity: Velocity of the body, m/s.
        radius: Distance between centres to maintain, m.
        parameters: Parameters of collision avoidance.
        responsibility: Fraction of the avoidance that the drone performs.

    Returns:
        Unit normal n and bound b, m/s, of n . v >= b.
    """
    # An existing violation is resolved within the recovery time; others are avoided for tau.
    relative = plus(own, -1.0, other_velocity)
    inside = dot(offset, offset) <= radius * radius
    time = parameters.recovery_time if inside else parameters.horizon
    # Offset of the relative velocity from the centre of the truncating ball.
    w = plus(relative, -1.0 / time, offset)
    back = dot(w, offset)
    on_ball = back < 0.0 and back * back > radius * radius * dot(w, w)
    if inside or on_ball:
        # Project on the truncating ball.
        away = (-offset[0], -offset[1], -offset[2])
        n, size = direction_and_length(w, away)
        depth = radius / time - size
    else:
        n, depth = _project_on_cone(offset, relative, radius)
    return n, dot(n, own) + responsibility * depth


@func
def _project_on_cone(offset: Vec3, relative: Vec3, radius: float) -> tuple[Vec3, float]:
    """Project the relative velocity on the cone of the velocity obstacle.

    Returns the outward normal there, and the depth of the velocity below the surface, m/s.
    """
    # The component perpendicular to the axis of the cone points to the nearest side.
    axis, distance = direction_and_length(offset, (1.0, 0.0, 0.0))
    sideways = plus(relative, -dot(relative, axis), axis)
    # In an exactly head-on conflict, both drones turn right.
    aside, _ = direction_and_length(sideways, horizontal_right(axis))
    # Sine of the half-angle of the cone.
    sine = radius / distance
    inwards = (-sine * axis[0], -sine * axis[1], -sine * axis[2])
    n = plus(inwards, math.sqrt(1.0 - sine * sine), aside)
    return n, -dot(n, relative)


@func
def horizontal_right(way: Vec3) -> Vec3:
    """Compute the horizontal direction to the right of a vector.

    The right of a vector straight up is north, that of a vector straight down is south. Two drones
    that fly in opposite directions therefore always have opposite right sides.
    """
    level = cross(way, (0.0, 0.0, 1.0))
    upright = cross(way, (1.0, 0.0, 0.0))
    right, _ = direction_and_length(level, upright)
    return right


@func
def turn_right(preferred: Vec3, angle: float) -> Vec3:
    """Rotate a velocity to the right by an angle, rad."""
    size = math.sqrt(dot(preferred, preferred))
    if size <= MIN_NORM:
        return preferred
    cosine = cos(angle)
    ahead = (cosine * preferred[0], cosine * preferred[1], cosine * preferred[2])
    return plus(ahead, size * sin(angle), horizontal_right(preferred))


@func
def choose_turn(preferred: Vec3, permitted: Vec3) -> float:
    """Compute the right turn of a preferred velocity from the part of it that is blocked.

    Drones in a symmetric conflict block each other. If all drones turn right, they pass around each
    other.

    Args:
        preferred: Preferred velocity, m/s.
        permitted: Permitted velocity nearest to the preferred one, m/s.

    Returns:
        The angle, rad: 0 if the preferred velocity is permitted, MAX_TURN if it is fully blocked.
    """
    square = dot(preferred, preferred)
    if square <= MIN_NORM:
        return 0.0
    lost = 1.0 - dot(permitted, preferred) / square
    return MAX_TURN * min(max(lost, 0.0), 1.0)


@func
def direction_and_length(vector: Vec3, otherwise: Vec3) -> tuple[Vec3, float]:
    """Return direction and length of a vector; the direction of `otherwise` if it is too short."""
    length = math.sqrt(dot(vector, vector))
    # Callers need a direction for zero vectors, too, such as at the goal
    chosen = vector if length > MIN_NORM else otherwise
    size = math.sqrt(dot(chosen, chosen))
    direction = (
        chosen[0] / size,
        chosen[1] / size,
        chosen[2] / size,
    )
    return direction, length


@kernel
def solve_with_right_turn(
    rows: np.ndarray, scratch: np.ndarray, count: int, preferred: Vec3, max_speed: float
) -> Vec3:
    """Find the best permitted velocity; turn right by as much as the preferred one is blocked.

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count]; the rest is a work buffer.
        scratch: Work buffer with the shape of `rows`.
        count: Number of half-spaces.
        preferred: Preferred velocity, m/s.
        max_speed: Speed limit, m/s.

    Returns:
        The velocity, m/s.
    """
    # A small right turn breaks the symmetry of head-on conflicts
    first = turn_right(preferred, SYMMETRY_BREAKING_TURN)
    best = solve_velocity(rows, scratch, count, first, max_speed)
    angle = choose_turn(first, best)
    # Solve again for a preferred velocity farther to the right
    if angle > MIN_TURN:
        best = solve_velocity(rows, scratch, count, turn_right(first, angle), max_speed)
    return best
