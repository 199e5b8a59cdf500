"""Policy `orca`: optimal reciprocal collision avoidance in three dimensions.

J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011), with
half-spaces for half-planes. Numbers of equations and sections are of this paper.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import keep_nearest, offset
from bulletuav.geometry.rotation import Vec3, cross, dot, plus, vec3
from bulletuav.kernel import allocating, func, kernel
from bulletuav.policies.base import Policy
from bulletuav.policies.linear_program import DEPTH, best_velocity, write
from bulletuav.policies.straight import preferred_velocity
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 3.0
"""Time without conflict that a velocity must give, s: turning at 20 m/s takes about 1 s"""
BRAKING = 2.0
"""Least time in which a velocity may lead to a wall, s: 20 m/s then stop with 10 m/s^2"""
RECOVERY = 1.0
"""Time in which to leave a zone entered, s: within one decision no quadrotor could"""
MARGIN = 1.5
"""Distance beyond d_safe and contact, m: lag, wind and overshoot carry drones off by as much"""
NEIGHBOURS = 32
"""How many of the nearest drones count: with 16, twenty that meet at one point overlook some"""
TO_RIGHT = np.array(
    (
        (1, -0.01, 0),
        (0.01, 1, 0),
        (0, 0, 1),
    )
)
"""Turn of 0.01 rad to the right: exactly head-on, drones would only stop"""
LOWEST_CORNER = (-np.inf, -np.inf, 0.0)
"""Lower corner of the world, m"""
NO_DIRECTION = 1e-9
"""Length below which a vector has no direction, m or m/s"""

HalfSpace = tuple[Vec3, float]
"""Unit normal n and bound b, m/s, of the velocities v with n . v >= b"""


class Rules(NamedTuple):
    """Rules by which drones avoid.

    Attributes:
        separation: Distance between centres that velocities keep, m.
        horizon: Time for which they keep it, s.
        braking: Least time in which velocities may lead to a wall, s.
        recovery: Time within which a conflict that is there is left, s; one time step in the
            paper.
        max_speed: Limit of the speed, m/s.
        neighbours: How many of the nearest drones count, 1 or more.
    """

    separation: float
    horizon: float
    braking: float
    recovery: float
    max_speed: float
    neighbours: int = NEIGHBOURS


class Surroundings(NamedTuple):
    """Bodies that drones keep out of, and the box that they keep in.

    Attributes:
        ball: (W, K, 3) centres of balls, m.
        ball_velocity: (W, K, 3) their velocities, m/s.
        ball_radius: (K,) distances to keep from these centres, m.
        low: (3,) lower corner of the box, m.
        high: (3,) upper corner of the box, m.
    """

    ball: np.ndarray
    ball_velocity: np.ndarray
    ball_radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


@register("policy")
class Orca(Policy):
    """Flight towards the goal, as far as half-spaces of safe velocities permit.

    Other drones are trusted to do half of the avoiding. Obstacles (bounding spheres), the ground
    and the arena's bounds do nothing of it.
    """

    name = "orca"
    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Do nothing, as no world is remembered."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """Ask for the velocities of `orca_velocities`, with this module's margins.

        See `Policy.act`.
        """
        aviary = self.aviary
        scene = aviary.scene
        task = aviary.task
        speed = aviary.options.max_speed
        body = task.context.collision_radius
        # Obstacles, ground and bounds, for the drone's centre.
        around = Surroundings(
            ball=scene.obstacle,
            ball_velocity=scene.obstacle_velocity,
            ball_radius=np.array([one.radius + body + MARGIN for one in task.obstacles()]),
            low=np.maximum(task.arena_low, LOWEST_CORNER) + body,
            high=task.arena_high - body,
        )
        rules = Rules(
            separation=max(task.config.d_safe, 2 * body) + MARGIN,
            horizon=HORIZON,
            braking=BRAKING,
            recovery=RECOVERY,
            max_speed=float(speed),
        )
        # The wish that all of this leaves as much of as it can.
        straight = preferred_velocity(scene.goal, scene.goal_velocity, swarm.position, speed)
        wanted = straight @ TO_RIGHT
        velocity = orca_velocities(
            swarm.position, swarm.velocity, wanted, aviary.alive, rules, around
        )
        return self.encoded(velocity)


@allocating
def orca_velocities(
    position: np.ndarray,
    velocity: np.ndarray,
    preferred: np.ndarray,
    alive: np.ndarray,
    rules: Rules,
    around: Surroundings,
) -> np.ndarray:
    """Compute the permitted velocities nearest to the preferred ones.

    Where none is permitted, it is the one that violates the half-spaces least (section 5.3).

    Args:
        position: (W, N, 3) positions of the drones, m.
        velocity: (W, N, 3) their velocities, m/s.
        preferred: (W, N, 3) velocities that they prefer, m/s.
        alive: (W, N) bool, which of them fly.
        rules: How they avoid.
        around: What they avoid beside each other.

    Returns:
        (W, N, 3) velocities, m/s; zero for drones that do not fly.
    """
    result = np.zeros(position.shape)
    # Room for a half-space of each neighbour, each ball and each of six walls.
    rows = np.empty((DEPTH, rules.neighbours + around.ball_radius.size + 6, 4))
    spare = np.empty_like(rows)
    near = np.empty(rules.neighbours, np.int64)
    distance = np.empty(rules.neighbours)
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i]:
                # Half-spaces of everything around, then the best velocity in them.
                count = _drones(rows, position, velocity, alive, rules, near, distance, w, i)
                count = _balls(rows, count, position, velocity, rules, around, w, i)
                count = _walls(rows, count, position, rules, around, w, i)
                best = best_velocity(rows, spare, count, vec3(preferred, w, i), rules.max_speed)
                for axis in range(3):
                    result[w, i, axis] = best[axis]
    return result


@kernel
def _drones(
    rows: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    alive: np.ndarray,
    rules: Rules,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Write the half-spaces of the nearest drones; return how many there are."""
    own = vec3(velocity, w, i)
    count = 0
    for k in range(_nearest(position, alive, near, distance, w, i)):
        j = near[k]
        gap = offset(position, w, i, j)
        other = vec3(velocity, w, j)
        # Either drone does half.
        space = half_space(gap, own, other, rules.separation, rules, 0.5)
        count = _add(rows, count, space, rules.max_speed)
    return count


@kernel
def _balls(
    rows: np.ndarray,
    count: int,
    position: np.ndarray,
    velocity: np.ndarray,
    rules: Rules,
    around: Surroundings,
    w: int,
    i: int,
) -> int:
    """Append the half-spaces of balls; return how many there are now."""
    here = vec3(position, w, i)
    own = vec3(velocity, w, i)
    for k in range(around.ball_radius.size):
        gap = plus(vec3(around.ball, w, k), -1.0, here)
        other = vec3(around.ball_velocity, w, k)
        # The drone does all.
        space = half_space(gap, own, other, around.ball_radius[k], rules, 1.0)
        count = _add(rows, count, space, rules.max_speed)
    return count


@kernel
def _walls(
    rows: np.ndarray,
    count: int,
    position: np.ndarray,
    rules: Rules,
    around: Surroundings,
    w: int,
    i: int,
) -> int:
    """Append the half-spaces of walls; return how many there are now.

    Whoever keeps its velocity is still inside after the time for braking.
    """
    for axis in range(3):
        # Into the arena at its lower face, and back at its upper one.
        n = (
            1.0 * (axis == 0),
            1.0 * (axis == 1),
            1.0 * (axis == 2),
        )
        low = (around.low[axis] - position[w, i, axis]) / rules.braking
        high = (around.high[axis] - position[w, i, axis]) / rules.braking
        back = (-n[0], -n[1], -n[2])
        count = _add(rows, count, (n, low), rules.max_speed)
        count = _add(rows, count, (back, -high), rules.max_speed)
    return count


@func
def _add(
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
def _nearest(
    position: np.ndarray,
    alive: np.ndarray,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Fill `near` with the nearest living drones, the nearest first; return how many there are."""
    found = 0
    for j in range(alive.shape[1]):
        if alive[w, j] and j != i:
            gap = offset(position, w, i, j)
            found = keep_nearest(near, distance, found, j, dot(gap, gap))
    return found


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
        n, size = _unit(w, away)
        depth = radius / time - size
    else:
        n, depth = _leg(gap, relative, radius)
    return n, dot(n, own) + share * depth


@func
def _leg(gap: Vec3, relative: Vec3, radius: float) -> tuple[Vec3, float]:
    """Find the point of the cone's surface nearest to the relative velocity.

    Returns the outward normal there, and how far below the surface that velocity is, m/s.
    """
    # The part of the relative velocity across the cone's axis points to the nearest side.
    axis, distance = _unit(gap, (1.0, 0.0, 0.0))
    sideways = plus(relative, -dot(relative, axis), axis)
    # Head-on both drones turn to their right.
    level = cross(axis, (0.0, 0.0, 1.0))
    # Where both are one above the other, any side does.
    upright = cross(axis, (1.0, 0.0, 0.0))
    right, _ = _unit(level, upright)
    aside, _ = _unit(sideways, right)
    # The surface is inclined to the axis by the angle of this sine.
    sine = radius / distance
    inwards = (-sine * axis[0], -sine * axis[1], -sine * axis[2])
    n = plus(inwards, math.sqrt(1.0 - sine * sine), aside)
    return n, -dot(n, relative)


@func
def _unit(vector: Vec3, otherwise: Vec3) -> tuple[Vec3, float]:
    """Compute direction and length of a vector; where it is too short, that of `otherwise`."""
    length = math.sqrt(dot(vector, vector))
    chosen = vector if length > NO_DIRECTION else otherwise
    size = math.sqrt(dot(chosen, chosen))
    direction = (
        chosen[0] / size,
        chosen[1] / size,
        chosen[2] / size,
    )
    return direction, length
