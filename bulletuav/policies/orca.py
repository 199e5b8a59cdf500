"""Policy `orca`: optimal reciprocal collision avoidance (ORCA) in three dimensions.

Half-planes of the paper become half-spaces.

References:
    J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011).
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
    """Flight to the goal within the ORCA half-spaces of collision-free velocities.

    Other drones are assumed to perform half of the avoidance. Obstacles (bounding spheres),
    buildings, the ground and the bounds of the arena perform none.
    """

    name = "orca"

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `orca_velocities`; see `Avoidance.avoid`."""
        return orca_velocities(traffic, wish, rules)


@allocating
def orca_velocities(traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
    """Compute the permitted velocities nearest to the preferred ones.

    If no velocity is permitted, the result minimises the maximum violation (section 5.3). All
    drones that could violate the separation within the horizon are considered.

    Args:
        traffic: The traffic around each drone.
        wish: (W, N, 3) preferred velocities, m/s.
        rules: Parameters of collision avoidance.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(wish.shape)
    # One half-space for each neighbour, each sphere and each surface.
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
    """Write the half-spaces of all drones within reach; return their number."""
    own = vec3(traffic.velocity, w, i)
    reach = rules.separation + 2.0 * rules.max_speed * rules.horizon
    count = 0
    for k in range(nearest_first(traffic, w, i, reach, near, distance)):
        gap = vec3(traffic.gap[w], i, near[k])
        other = vec3(traffic.other[w], i, near[k])
        # Reciprocal avoidance: each drone performs half.
        space = half_space(gap, own, other, rules.separation, rules, 0.5)
        count = add(rows, count, space, rules.max_speed)
    return count
