"""Policy `mvp`: modified voltage potential in three dimensions.

J. Hoekstra, R. van Gent, R. Ruigrok, Designing for safety: the 'free flight' air traffic management
concept (2002).
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
    """Flight towards the goal, with a change of velocity for each conflict ahead.

    Each drone of a pair makes the whole change, so that one that does not avoid is avoided, too.
    Obstacles (bounding spheres), buildings, the ground and the arena's bounds limit what comes of
    it, as in policy `orca`.
    """

    name = "mvp"

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `mvp_velocities`; see `Avoidance.avoid`."""
        return mvp_velocities(traffic, wish, rules)


@allocating
def mvp_velocities(traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
    """Add to the preferred velocities what solves each conflict that they would lead to.

    Args:
        traffic: What drones know.
        wish: (W, N, 3) velocities that they prefer, m/s.
        rules: How they avoid.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(wish.shape)
    # Room for a half-space of each ball and each surface.
    rows = np.empty((DEPTH, traffic.ball_radius.shape[2] + traffic.surface.shape[2], 4))
    spare = np.empty_like(rows)
    for w in range(wish.shape[0]):
        for i in range(wish.shape[1]):
            count = unyielding(rows, 0, traffic, rules, w, i)
            first = turned(vec3(wish, w, i), SLIGHT_TURN)
            changed = _changed(first, traffic, rules, w, i)
            best = best_velocity(rows, spare, count, changed, rules.max_speed)
            # Who is held up turns to its right.
            angle = turn_of(first, best)
            if angle > NO_TURN:
                changed = _changed(turned(first, angle), traffic, rules, w, i)
                best = best_velocity(rows, spare, count, changed, rules.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _changed(own: Vec3, traffic: Traffic, rules: Rules, w: int, i: int) -> Vec3:
    """Add the changes for all conflicts of a velocity to it, m/s."""
    result = own
    for k in range(traffic.known.shape[2]):
        if traffic.known[w, i, k]:
            gap = vec3(traffic.gap[w], i, k)
            # Each conflict by itself, with the velocity relative to the other
            other = vec3(traffic.other[w], i, k)
            result = plus(result, 1.0, change(gap, plus(own, -1.0, other), rules))
    return result


@func
def change(gap: Vec3, relative: Vec3, rules: Rules) -> Vec3:
    """Compute the change of velocity that solves a conflict.

    It is across the relative velocity, away from where the other one would be at the closest
    approach, and as large as it takes to pass by at the separation. With d the distance, m that of
    the closest approach, s the separation and t the time until then, it is
    (s / cos(asin(s / d) - asin(m / d)) - m) / t.

    Args:
        gap: Way from the drone to the other one, m.
        relative: Velocity of the drone less that of the other one, m/s.
        rules: How drones avoid.

    Returns:
        The change, m/s; zero where there is no conflict within the horizon.
    """
    square = dot(gap, gap)
    closing = dot(gap, relative)
    speed_square = dot(relative, relative)
    if square <= rules.separation * rules.separation:
        # A conflict that is there is left within the recovery.
        ahead, distance = unit(gap, (1.0, 0.0, 0.0))
        size = (distance - rules.separation) / rules.recovery
        return size * ahead[0], size * ahead[1], size * ahead[2]
    if closing <= 0.0 or closing > rules.horizon * speed_square:
        return 0.0, 0.0, 0.0
    time = closing / speed_square
    miss = plus(gap, -time, relative)
    # Exactly head-on both drones turn to their right.
    right = right_of(gap)
    left = (-right[0], -right[1], -right[2])
    aside, least = unit(miss, left)
    if least >= rules.separation:
        return 0.0, 0.0, 0.0
    # The cosine of a difference, from the sines of both angles.
    wide = rules.separation * rules.separation / square
    narrow = least * least / square
    cosine = math.sqrt((1.0 - wide) * (1.0 - narrow)) + math.sqrt(wide * narrow)
    size = -(rules.separation / cosine - least) / time
    return size * aside[0], size * aside[1], size * aside[2]
