"""Policy `mvp`: modified voltage potential (MVP) in three dimensions.

References:
    J. Hoekstra, R. van Gent, R. Ruigrok, Designing for safety: the 'free flight' air traffic
    management concept (2002).
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.grid import ROUNDING
from bulletuav.geometry.rotation import Vec3, dot, plus, vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    MIN_TURN,
    SYMMETRY_BREAKING_TURN,
    AvoidanceParameters,
    add_obstacle_half_spaces,
    choose_turn,
    direction_and_length,
    horizontal_right,
    turn_right,
)
from bulletuav.policies.linear_program import DEPTH, solve_velocity
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register
from bulletuav.tasks.observations.observer import Observation
from bulletuav.vehicle.swarm import Swarm


@register("policy")
class ModifiedVoltagePotential(Avoidance):
    """Flight to the goal with an MVP velocity change for each predicted conflict.

    Each drone of a pair performs the whole change, so that drones which do not cooperate are
    avoided, too. The half-spaces of obstacles (bounding spheres), buildings, the ground and the
    bounds of the arena limit the result, as in policy `orca`.
    """

    name = "mvp"

    def traffic(self, observations: Observation, swarm: Swarm) -> Traffic:
        """Return the traffic of all drones that may come into conflict; see `Avoidance.traffic`."""
        fastest = math.sqrt(float((swarm.velocity**2).sum(axis=-1).max()))
        reach = self.parameters.horizon * (self.parameters.max_speed + fastest)
        self.max_distance = (1 + ROUNDING) * (self.parameters.separation + reach)
        return super().traffic(observations, swarm)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Compute `mvp_velocities`; see `Avoidance.avoid`."""
        return mvp_velocities(traffic, preferred, parameters)


@allocating
def mvp_velocities(
    traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
) -> np.ndarray:
    """Compute velocities that resolve the conflicts of all drones.

    Each preferred velocity is first turned a little to the right, so that drones which meet
    symmetrically do not block each other. The resolution vectors of its conflicts are added. The
    sum is projected onto the half-spaces of obstacles and the maximum speed. The velocity of a
    drone that this blocks is turned further to the right, and resolved again.

    Args:
        traffic: The traffic around each drone.
        preferred: (W, N, 3) preferred velocities, m/s.
        parameters: Parameters of collision avoidance.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(preferred.shape)
    # One half-space for each sphere and each surface.
    rows = np.empty((DEPTH, traffic.sphere_radius.shape[2] + traffic.surface.shape[2], 4))
    scratch = np.empty_like(rows)
    for w in range(preferred.shape[0]):
        for i in range(preferred.shape[1]):
            count = add_obstacle_half_spaces(rows, 0, traffic, parameters, w, i)
            first = turn_right(vec3(preferred, w, i), SYMMETRY_BREAKING_TURN)
            resolved = _resolve_conflicts(first, traffic, parameters, w, i)
            best = solve_velocity(rows, scratch, count, resolved, parameters.max_speed)
            # A blocked drone turns right.
            angle = choose_turn(first, best)
            if angle > MIN_TURN:
                resolved = _resolve_conflicts(turn_right(first, angle), traffic, parameters, w, i)
                best = solve_velocity(rows, scratch, count, resolved, parameters.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _resolve_conflicts(
    own: Vec3, traffic: Traffic, parameters: AvoidanceParameters, w: int, i: int
) -> Vec3:
    """Return a velocity of drone i of world w plus the resolution vectors of its conflicts, m/s."""
    result = own
    for k in range(traffic.known.shape[2]):
        if traffic.known[w, i, k]:
            offset = vec3(traffic.offset[w], i, k)
            # Each conflict is resolved independently of the others
            other_velocity = vec3(traffic.other_velocity[w], i, k)
            result = plus(
                result, 1.0, resolve_conflict(offset, plus(own, -1.0, other_velocity), parameters)
            )
    return result


@func
def resolve_conflict(offset: Vec3, relative: Vec3, parameters: AvoidanceParameters) -> Vec3:
    """Compute the velocity change that resolves a conflict with another drone.

    The change is perpendicular to the relative velocity and points away from the other drone at the
    closest point of approach. With the distance d, the distance m at the closest point of approach,
    the separation s and the time t to the closest point of approach, its size is (s / cos(asin(s /
    d) - asin(m / d)) - m) / t. In an exactly head-on conflict the change points to the right.

    If the drones are closer than the separation already, the change points straight away from the
    other drone, and its size is s - d divided by the recovery time.

    Args:
        offset: Offset from the drone to the other drone, m.
        relative: Velocity of the drone minus that of the other drone, m/s.
        parameters: Parameters of collision avoidance.

    Returns:
        The velocity change, m/s; zero if there is no conflict within the horizon.
    """
    square = dot(offset, offset)
    closing = dot(offset, relative)
    speed_square = dot(relative, relative)
    if square <= parameters.separation * parameters.separation:
        # Resolve an existing violation within the recovery time.
        ahead, distance = direction_and_length(offset, (1.0, 0.0, 0.0))
        size = (distance - parameters.separation) / parameters.recovery_time
        return size * ahead[0], size * ahead[1], size * ahead[2]
    if closing <= 0.0 or closing > parameters.horizon * speed_square:
        return 0.0, 0.0, 0.0
    time = closing / speed_square
    miss = plus(offset, -time, relative)
    # In an exactly head-on conflict, both drones turn right.
    right = horizontal_right(offset)
    left = (-right[0], -right[1], -right[2])
    aside, miss_distance = direction_and_length(miss, left)
    if miss_distance >= parameters.separation:
        return 0.0, 0.0, 0.0
    # Cosine of the difference of the angles, from their sines.
    wide = parameters.separation * parameters.separation / square
    narrow = miss_distance * miss_distance / square
    cosine = math.sqrt((1.0 - wide) * (1.0 - narrow)) + math.sqrt(wide * narrow)
    size = -(parameters.separation / cosine - miss_distance) / time
    return size * aside[0], size * aside[1], size * aside[2]
