"""Half-spaces of velocities that keep drones clear, which the avoiding policies share.

A half-space is a unit normal n and a bound b, m/s, of the velocities v with n . v >= b. That of a
moving body is J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance
(2011), with half-spaces for half-planes. Numbers of equations are of this paper.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import cos, sin
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.closest_approach import insert_nearest
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, vec3
from bulletuav.policies.linear_program import best_velocity, write
from bulletuav.policies.traffic import Traffic

SLIGHT_TURN = 0.05
"""Turn of every wish to the right, rad: exactly head-on, drones would only stop"""
MOST_TURN = 1.4
"""Turn to the right of a wish of which nothing is left, rad: 80 degrees, nearly along a wall"""
NO_TURN = 1e-9
"""Angle below which nothing is turned, rad"""
NO_DIRECTION = 1e-9
"""Length below which a vector has no direction, m or m/s"""

HalfSpace = tuple[Vec3, float]
"""Unit normal n and bound b, m/s, of the velocities v with n . v >= b"""


class Rules(NamedTuple):
    """Rules by which drones avoid.

    Attributes:
        separation: Distance between centres that velocities keep, m.
        horizon: Time for which they keep it, s.
        braking: Least time in which velocities may lead to a surface, s.
        recovery: Time within which a conflict that is there is left, s; one time step in the
            paper.
        max_speed: Limit of the speed, m/s.
    """

    separation: float
    horizon: float
    braking: float
    recovery: float
    max_speed: float


@func
def add(
    rows: np.ndarray,
    count: int,
    space: HalfSpace,
    max_speed: float,
) -> int:
    """Append a half-space unless every velocity within max_speed is in it; return the new count."""
    if space[1] <= -max_speed:
        return count
    write(rows, 0, count, space[0], space[1])
    return count + 1


@kernel
def nearest_first(
    traffic: Traffic,
    w: int,
    i: int,
    reach: float,
    near: np.ndarray,
    distance: np.ndarray,
) -> int:
    """Sort the other drones that drone i knows of within a reach, the nearest first.

    Args:
        traffic: What drones know.
        w: Index of the world.
        i: Index of the drone.
        reach: Greatest distance, m.
        near: (M,) indices of the others, written.
        distance: (M,) squares of their distances, m^2, written.

    Returns:
        How many there are.
    """
    found = 0
    for k in range(near.size):
        if traffic.known[w, i, k]:
            # Squares of distances have the same order, and cost no root
            gap = vec3(traffic.gap[w], i, k)
            square = dot(gap, gap)
            if square <= reach * reach:
                found = insert_nearest(near, distance, found, k, square)
    return found


@kernel
def unyielding(
    rows: np.ndarray,
    count: int,
    traffic: Traffic,
    rules: Rules,
    w: int,
    i: int,
) -> int:
    """Append the half-spaces of balls and surfaces, which leave all the avoiding to the drone.

    Args:
        rows: (DEPTH, M, 4) half-spaces, those of depth 0 written.
        count: How many there are.
        traffic: What drones know.
        rules: How they avoid.
        w: Index of the world.
        i: Index of the drone.

    Returns:
        How many there are now.
    """
    own = vec3(traffic.velocity, w, i)
    for k in range(traffic.ball_radius.shape[2]):
        # Rows of balls that are not there have no radius.
        radius = traffic.ball_radius[w, i, k]
        if radius > 0.0:
            gap = vec3(traffic.ball[w], i, k)
            other = vec3(traffic.ball_velocity[w], i, k)
            space = half_space(gap, own, other, radius, rules, 1.0)
            count = add(rows, count, space, rules.max_speed)
    # Whoever keeps its velocity is still this side of a surface after the time for braking.
    for k in range(traffic.surface.shape[2]):
        n = vec3(traffic.surface[w], i, k)
        bound = -traffic.surface[w, i, k, 3] / rules.braking
        count = add(rows, count, (n, bound), rules.max_speed)
    return count


@func
def half_space(
    gap: Vec3,
    own: Vec3,
    other: Vec3,
    radius: float,
    rules: Rules,
    share: float,
) -> HalfSpace:
    """Compute the half-space of velocities that keep away from a body.

    The velocity obstacle of the horizon tau is a cone cut off by the ball of radius / tau about
    gap / tau. The vector u (equation 3) leads from the relative velocity to its nearest boundary,
    and `share` of it is for the drone to do (equations 5 and 6).

    Args:
        gap: Way from the drone to the body, m.
        own: Velocity of the drone, m/s.
        other: Velocity of the body, m/s.
        radius: Distance to keep between the centres, m.
        rules: How the drone avoids.
        share: Share of the avoiding that the drone does.

    Returns:
        Unit normal n and bound b, m/s, of n . v >= b.
    """
    # A conflict that is there is left within the recovery, another avoided for the horizon.
    relative = plus(own, -1.0, other)
    inside = dot(gap, gap) <= radius * radius
    time = rules.recovery if inside else rules.horizon
    # Offset of the relative velocity from the centre of the ball that cuts off the cone.
    w = plus(relative, -1.0 / time, gap)
    back = dot(w, gap)
    on_ball = back < 0.0 and back * back > radius * radius * dot(w, w)
    if inside or on_ball:
        # The ball is the nearest boundary.
        away = (-gap[0], -gap[1], -gap[2])
        n, size = unit(w, away)
        depth = radius / time - size
    else:
        n, depth = _leg(gap, relative, radius)
    return n, dot(n, own) + share * depth


@func
def _leg(
    gap: Vec3,
    relative: Vec3,
    radius: float,
) -> tuple[Vec3, float]:
    """Find the point of the cone's surface nearest to the relative velocity.

    Returns the outward normal there, and how far below the surface that velocity is, m/s.
    """
    # The part of the relative velocity across the cone's axis points to the nearest side.
    axis, distance = unit(gap, (1.0, 0.0, 0.0))
    sideways = plus(relative, -dot(relative, axis), axis)
    # Head-on both drones turn to their right.
    aside, _ = unit(sideways, right_of(axis))
    # The surface is inclined to the axis by the angle of this sine.
    sine = radius / distance
    inwards = (-sine * axis[0], -sine * axis[1], -sine * axis[2])
    n = plus(inwards, math.sqrt(1.0 - sine * sine), aside)
    return n, -dot(n, relative)


@func
def right_of(way: Vec3) -> Vec3:
    """Compute the level direction to the right of a way.

    A way straight up has the north to its right, one straight down the south. So two drones of
    opposite ways always have opposite sides to their right.
    """
    level = cross(way, (0.0, 0.0, 1.0))
    upright = cross(way, (1.0, 0.0, 0.0))
    right, _ = unit(level, upright)
    return right


@func
def turned(wish: Vec3, angle: float) -> Vec3:
    """Turn a velocity towards what is to its right, by an angle in rad."""
    size = math.sqrt(dot(wish, wish))
    if size <= NO_DIRECTION:
        return wish
    # A turn in the plane of the velocity and its right
    cosine = cos(angle)
    ahead = (cosine * wish[0], cosine * wish[1], cosine * wish[2])
    return plus(ahead, size * sin(angle), right_of(wish))


@func
def turn_of(wish: Vec3, given: Vec3) -> float:
    """Choose how far to turn a wish to the right, by how much of it is not given.

    Drones that meet in perfect symmetry stop each other. Where all turn right they go round.

    Args:
        wish: The velocity that the drone prefers, m/s.
        given: The permitted velocity nearest to it, m/s.

    Returns:
        The angle, rad: from 0 where all is given to MOST_TURN where nothing is.
    """
    square = dot(wish, wish)
    if square <= NO_DIRECTION:
        return 0.0
    lost = 1.0 - dot(given, wish) / square
    return MOST_TURN * min(max(lost, 0.0), 1.0)


@func
def unit(vector: Vec3, otherwise: Vec3) -> tuple[Vec3, float]:
    """Compute direction and length of a vector; where it is too short, that of `otherwise`."""
    length = math.sqrt(dot(vector, vector))
    # A direction is needed even where there is none, such as at the goal
    chosen = vector if length > NO_DIRECTION else otherwise
    size = math.sqrt(dot(chosen, chosen))
    direction = (
        chosen[0] / size,
        chosen[1] / size,
        chosen[2] / size,
    )
    return direction, length


@kernel
def going_round(
    rows: np.ndarray,
    spare: np.ndarray,
    count: int,
    wish: Vec3,
    max_speed: float,
) -> Vec3:
    """Find the best permitted velocity, to the right of the wish by as much as that is not given.

    Args:
        rows: (DEPTH, M, 4) the half-spaces in rows[0, :count], and room.
        spare: Room like `rows`.
        count: How many half-spaces there are.
        wish: The velocity that the drone prefers, m/s.
        max_speed: Limit of the speed, m/s.

    Returns:
        The velocity, m/s.
    """
    # A slight turn for all breaks the tie of two that meet head on
    first = turned(wish, SLIGHT_TURN)
    best = best_velocity(rows, spare, count, first, max_speed)
    angle = turn_of(first, best)
    # What was not given is asked for once more, to the right
    if angle > NO_TURN:
        best = best_velocity(rows, spare, count, turned(first, angle), max_speed)
    return best
