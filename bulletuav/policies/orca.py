"""Policy `orca`: 3-D Optimal Reciprocal Collision Avoidance.

J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011), with half-spaces for half-planes.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.closest_approach import keep_nearest, offset
from bulletuav.geometry.rotation import cross, dot, vec3
from bulletuav.kernel import func, kernel
from bulletuav.policies.base import Policy
from bulletuav.policies.linear_program import DEPTH, along, best_velocity, write
from bulletuav.policies.straight import preferred_velocity
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm

HORIZON = 3.0  # s without conflict that a velocity must give: turning at 20 m/s takes about one
BRAKING = 2.0  # s in which velocities lead to a wall at the earliest: stopping from 20 m/s then takes 10 m/s^2
RECOVERY = 1.0  # s in which to leave a zone entered; within one decision no quadrotor could
MARGIN = 1.5  # m, beyond d_safe and contact: how far lag, wind and overshoot carry a drone off its velocity
NEIGHBOURS = 32  # the nearest drones: with 16, twenty that meet at one point overlook those behind
TO_RIGHT = np.array(
    ((1, -0.01, 0), (0.01, 1, 0), (0, 0, 1))
)  # a turn of 0.01 rad: exactly head-on, drones would only stop
LOWEST_CORNER = (-np.inf, -np.inf, 0.0)  # m, lower corner of the world
NO_DIRECTION = 1e-9  # m/s, m: below this a direction is none


class Rules(NamedTuple):
    """How drones avoid: m, s, s, s, m/s, and how many neighbours count, 1 or more.

    Velocities keep `separation` between centres for `horizon`, leave a conflict that is there within `recovery` (one time
    step, in the paper) and lead through no wall within `braking`.
    """

    separation: float
    horizon: float
    braking: float
    recovery: float
    max_speed: float
    neighbours: int = NEIGHBOURS


class Surroundings(NamedTuple):
    """Balls (W, K, 3) m, m/s, (K,) m to keep the centre out of, and the corners (3,) of the box to keep it in, m."""

    ball: np.ndarray
    ball_velocity: np.ndarray
    ball_radius: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Orca(Policy):
    """Towards the goal, as far as half-spaces of safe velocities permit.

    Other drones are trusted to do half of the avoiding; obstacles (bounding spheres), ground and arena bounds do nothing.
    """

    name = "orca"
    actions = ("velocity", "velocity_increment")
    reads_swarm = True

    def reset(self, mask: np.ndarray) -> None:
        """Nothing to forget."""

    def act(self, observations: Observation, swarm: Swarm) -> np.ndarray:
        """The velocities of `orca_velocities` with this module's margins."""
        aviary, scene, task = self.aviary, self.aviary.scene, self.aviary.task
        speed, body = aviary.options.max_speed, task.context.collision_radius
        radius = np.array([obstacle.radius + body + MARGIN for obstacle in task.obstacles()])
        low, high = np.maximum(task.arena_low, LOWEST_CORNER) + body, task.arena_high - body
        around = Surroundings(scene.obstacle, scene.obstacle_velocity, radius, low, high)
        rules = Rules(
            max(task.config.d_safe, 2 * body) + MARGIN, HORIZON, BRAKING, RECOVERY, float(speed)
        )
        wanted = (
            preferred_velocity(scene.goal, scene.goal_velocity, swarm.position, speed) @ TO_RIGHT
        )
        return self.encoded(
            orca_velocities(swarm.position, swarm.velocity, wanted, aviary.alive, rules, around)
        )


@kernel
def orca_velocities(position, velocity, preferred, alive, rules, around):
    """New velocities (W, N, 3), m/s, of drones at (W, N, 3) m, m/s that prefer (W, N, 3) m/s; zero unless alive (W, N).

    The permitted velocity nearest to the preferred one; where none is permitted, the one that violates least (5.3).
    """
    result = np.zeros(position.shape)
    rows = np.empty((DEPTH, rules.neighbours + around.ball_radius.size + 6, 4))
    spare, near, distance = (
        np.empty_like(rows),
        np.empty(rules.neighbours, np.int64),
        np.empty(rules.neighbours),
    )
    for w in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            if alive[w, i]:
                count = _drones(rows, position, velocity, alive, rules, near, distance, w, i)
                count = _balls(rows, count, position, velocity, rules, around, w, i)
                count = _walls(rows, count, position, rules, around, w, i)
                best = best_velocity(rows, spare, count, vec3(preferred, w, i), rules.max_speed)
                for axis in range(3):
                    result[w, i, axis] = best[axis]
    return result


@kernel
def _drones(rows, position, velocity, alive, rules, near, distance, w, i):
    own, count = vec3(velocity, w, i), 0
    for k in range(_nearest(position, alive, near, distance, w, i)):
        j = near[k]
        gap, other = offset(position, w, i, j), vec3(velocity, w, j)
        count = _add(
            rows, count, half_space(gap, own, other, rules.separation, rules, 0.5), rules.max_speed
        )
    return count


@kernel
def _balls(rows, count, position, velocity, rules, around, w, i):
    here, own = vec3(position, w, i), vec3(velocity, w, i)
    for k in range(around.ball_radius.size):
        gap, other = along(vec3(around.ball, w, k), -1.0, here), vec3(around.ball_velocity, w, k)
        count = _add(
            rows,
            count,
            half_space(gap, own, other, around.ball_radius[k], rules, 1.0),
            rules.max_speed,
        )
    return count


@kernel
def _walls(rows, count, position, rules, around, w, i):
    """Whoever keeps its velocity is inside after the time for braking."""
    for axis in range(3):
        n = (1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2))
        low = (around.low[axis] - position[w, i, axis]) / rules.braking
        high = (around.high[axis] - position[w, i, axis]) / rules.braking
        count = _add(rows, count, (n, low), rules.max_speed)
        count = _add(rows, count, ((-n[0], -n[1], -n[2]), -high), rules.max_speed)
    return count


@func
def _add(rows, count, space, max_speed):
    """Append a half-space unless every velocity within max_speed is in it; the new count."""
    if space[1] <= -max_speed:
        return count
    write(rows, 0, count, space[0], space[1])
    return count + 1


@kernel
def _nearest(position, alive, near, distance, w, i):
    """Fill `near` with the nearest living drones, the nearest first; how many there are."""
    found = 0
    for j in range(alive.shape[1]):
        if alive[w, j] and j != i:
            gap = offset(position, w, i, j)
            found = keep_nearest(near, distance, found, j, dot(gap, gap))
    return found


@func
def half_space(gap, own, other, radius, rules, share):
    """Normal n and bound b of n . v >= b: the velocities that keep `gap` m away from a body of velocity `other` m/s.

    The velocity obstacle of the horizon tau is a cone cut off by the ball of radius / tau about gap / tau. u (equation 3)
    leads from the relative velocity to its nearest boundary; `share` of it is for the drone of velocity `own` to do (5, 6).
    """
    relative = along(own, -1.0, other)
    inside = dot(gap, gap) <= radius * radius
    time = rules.recovery if inside else rules.horizon
    w = along(relative, -1.0 / time, gap)
    back = dot(w, gap)
    if inside or (back < 0.0 and back * back > radius * radius * dot(w, w)):
        n, size = _unit(w, (-gap[0], -gap[1], -gap[2]))
        depth = radius / time - size
    else:
        n, depth = _leg(gap, relative, radius)
    return n, dot(n, own) + share * depth


@func
def _leg(gap, relative, radius):
    """Outward normal of the cone at the point of its surface nearest to the relative velocity, and the depth below it."""
    axis, distance = _unit(gap, (1.0, 0.0, 0.0))
    sideways = along(relative, -dot(relative, axis), axis)
    right, _ = _unit(cross(axis, (0.0, 0.0, 1.0)), cross(axis, (1.0, 0.0, 0.0)))
    aside, _ = _unit(sideways, right)  # head-on both turn to their right
    sine = radius / distance
    n = along(
        (-sine * axis[0], -sine * axis[1], -sine * axis[2]), math.sqrt(1.0 - sine * sine), aside
    )
    return n, -dot(n, relative)


@func
def _unit(vector, otherwise):
    """Direction and length of a vector; where it has none, the direction `otherwise`."""
    length = math.sqrt(dot(vector, vector))
    chosen = vector if length > NO_DIRECTION else otherwise
    size = math.sqrt(dot(chosen, chosen))
    return (chosen[0] / size, chosen[1] / size, chosen[2] / size), length
