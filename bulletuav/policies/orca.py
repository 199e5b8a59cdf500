"""Policy `orca`: optimal reciprocal collision avoidance in three dimensions.

J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011), with
half-spaces for half-planes.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, kernel
from bulletuav.geometry.rotation import vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    Rules,
    add,
    going_round,
    half_space,
    nearest_first,
    unyielding,
)
from bulletuav.policies.linear_program import DEPTH
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register


@register("policy")
class Orca(Avoidance):
    """Flight towards the goal, as far as half-spaces of safe velocities permit.

    Other drones are trusted to do half of the avoiding. Obstacles (bounding spheres), buildings,
    the ground and the arena's bounds do nothing of it.
    """

    name = "orca"

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `orca_velocities`; see `Avoidance.avoid`."""
        return orca_velocities(traffic, wish, rules)


@allocating
def orca_velocities(traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
    """Compute the permitted velocities nearest to the preferred ones.

    Where none is permitted, it is the one that violates the half-spaces least (section 5.3). All
    drones count that could come too close within the horizon.

    Args:
        traffic: What drones know.
        wish: (W, N, 3) velocities that they prefer, m/s.
        rules: How they avoid.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(wish.shape)
    # Room for a half-space of each neighbour, each ball and each surface.
    others = traffic.known.shape[2]
    room = others + traffic.ball_radius.shape[2] + traffic.surface.shape[2]
    rows = np.empty((DEPTH, room, 4))
    spare = np.empty_like(rows)
    near = np.empty(others, np.int64)
    distance = np.empty(others)
    for w in range(wish.shape[0]):
        for i in range(wish.shape[1]):
            count = _drones(rows, traffic, rules, near, distance, w, i)
            count = unyielding(rows, count, traffic, rules, w, i)
            best = going_round(rows, spare, count, vec3(wish, w, i), rules.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _drones(
    rows: np.ndarray,
    traffic: Traffic,
    rules: Rules,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Write the half-spaces of all drones that can matter; return how many there are."""
    own = vec3(traffic.velocity, w, i)
    reach = rules.separation + 2.0 * rules.max_speed * rules.horizon
    count = 0
    for k in range(nearest_first(traffic, w, i, reach, near, distance)):
        gap = vec3(traffic.gap[w], i, near[k])
        other = vec3(traffic.other[w], i, near[k])
        # Either drone does half.
        space = half_space(gap, own, other, rules.separation, rules, 0.5)
        count = add(rows, count, space, rules.max_speed)
    return count
