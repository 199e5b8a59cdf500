"""Policy `mvp`: modified voltage potential (MVP) in three dimensions.

References:
    J. Hoekstra, R. van Gent, R. Ruigrok, Designing for safety: the 'free flight' air traffic
    management concept (2002).
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, dot, plus, vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    NO_TURN,
    SLIGHT_TURN,
    Rules,
    right_of,
    turn_of,
    turned,
    unit,
    unyielding,
)
from bulletuav.policies.linear_program import DEPTH, best_velocity
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register


@register("policy")
class ModifiedVoltagePotential(Avoidance):
    """Flight to the goal with an MVP velocity change for each predicted conflict.

    Each drone of a pair performs the whole change, so that drones which do not cooperate are
    avoided, too. The half-spaces of obstacles (bounding spheres), buildings, the ground and the
    bounds of the arena limit the result, as in policy `orca`.
    """

    name = "mvp"

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `mvp_velocities`; see `Avoidance.avoid`."""
        return mvp_velocities(traffic, wish, rules)


@allocating
def mvp_velocities(traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
    """Add conflict resolution vectors to the preferred velocities.

    Args:
        traffic: The traffic around each drone.
        wish: (W, N, 3) preferred velocities, m/s.
        rules: Parameters of collision avoidance.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(wish.shape)
    # One half-space for each sphere and each surface.
    rows = np.empty((DEPTH, traffic.ball_radius.shape[2] + traffic.surface.shape[2], 4))
    spare = np.empty_like(rows)
    for w in range(wish.shape[0]):
        for i in range(wish.shape[1]):
            count = unyielding(rows, 0, traffic, rules, w, i)
            first = turned(vec3(wish, w, i), SLIGHT_TURN)
            changed = _changed(first, traffic, rules, w, i)
            best = best_velocity(rows, spare, count, changed, rules.max_speed)
            # A blocked drone turns right.
            angle = turn_of(first, best)
            if angle > NO_TURN:
                changed = _changed(turned(first, angle), traffic, rules, w, i)
                best = best_velocity(rows, spare, count, changed, rules.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _changed(own: Vec3, traffic: Traffic, rules: Rules, w: int, i: int) -> Vec3:
    """Return a velocity plus the resolution vectors of all its conflicts, m/s."""
    result = own
    for k in range(traffic.known.shape[2]):
        if traffic.known[w, i, k]:
            gap = vec3(traffic.gap[w], i, k)
            # Each conflict is resolved independently of the others
            other = vec3(traffic.other[w], i, k)
            result = plus(result, 1.0, change(gap, plus(own, -1.0, other), rules))
    return result


@func
def change(gap: Vec3, relative: Vec3, rules: Rules) -> Vec3:
    """Compute the velocity change that resolves a conflict with another drone.

    The change is perpendicular to the relative velocity and points away from the other drone at the
    closest point of approach. With the distance d, the distance m at the closest point of approach,
    the separation s and the time t to the closest point of approach, its size is (s / cos(asin(s /
    d) - asin(m / d)) - m) / t.

    Args:
        gap: Offset from the drone to the other drone, m.
        relative: Velocity of the drone minus that of the other drone, m/s.
        rules: Parameters of collision avoidance.

    Returns:
        The velocity change, m/s; zero if there is no conflict within the horizon.
    """
    square = dot(gap, gap)
    closing = dot(gap, relative)
    speed_square = dot(relative, relative)
    if square <= rules.separation * rules.separation:
        # Resolve an existing violation within the recovery time.
        ahead, distance = unit(gap, (1.0, 0.0, 0.0))
        size = (distance - rules.separation) / rules.recovery
        return size * ahead[0], size * ahead[1], size * ahead[2]
    if closing <= 0.0 or closing > rules.horizon * speed_square:
        return 0.0, 0.0, 0.0
    time = closing / speed_square
    miss = plus(gap, -time, relative)
    # In an exactly head-on conflict, both drones turn right.
    right = right_of(gap)
    left = (-right[0], -right[1], -right[2])
    aside, least = unit(miss, left)
    if least >= rules.separation:
        return 0.0, 0.0, 0.0
    # Cosine of the difference of the angles, from their sines.
    wide = rules.separation * rules.separation / square
    narrow = least * least / square
    cosine = math.sqrt((1.0 - wide) * (1.0 - narrow)) + math.sqrt(wide * narrow)
    size = -(rules.separation / cosine - least) / time
    return size * aside[0], size * aside[1], size * aside[2]
