"""Policy `voronoi`: buffered Voronoi cells in three dimensions.

References:
    D. Zhou, Z. Wang, S. Bandyopadhyay, M. Schwager, Fast, on-line collision avoidance for dynamic
    vehicles using buffered Voronoi cells (2017).
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    HalfSpace,
    Rules,
    add,
    going_round,
    nearest_first,
    unit,
    unyielding,
)
from bulletuav.policies.linear_program import DEPTH
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register


@register("policy")
class Voronoi(Avoidance):
    """Flight to the point of the drone's buffered Voronoi cell nearest to its goal.

    Velocities of other drones are ignored. A blocked drone turns right.
    """

    name = "voronoi"

    def avoid(self, traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
        """Compute `voronoi_velocities`; see `Avoidance.avoid`."""
        return voronoi_velocities(traffic, wish, rules)


@allocating
def voronoi_velocities(traffic: Traffic, wish: np.ndarray, rules: Rules) -> np.ndarray:
    """Compute the velocities nearest to the preferred ones that stay within the Voronoi cells.

    At a permitted velocity, a drone is still in its cell after the braking time.

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
    capacity = others + traffic.ball_radius.shape[2] + traffic.surface.shape[2]
    rows = np.empty((DEPTH, capacity, 4))
    spare = np.empty_like(rows)
    near = np.empty(others, np.int64)
    distance = np.empty(others)
    for w in range(wish.shape[0]):
        for i in range(wish.shape[1]):
            count = _cell(rows, traffic, rules, near, distance, w, i)
            count = unyielding(rows, count, traffic, rules, w, i)
            best = going_round(rows, spare, count, vec3(wish, w, i), rules.max_speed)
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _cell(
    rows: np.ndarray,
    traffic: Traffic,
    rules: Rules,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Write the half-spaces of a drone's cell; return their number."""
    # Drones beyond this distance cannot be reached within the braking time
    reach = rules.separation + 2.0 * rules.max_speed * rules.braking
    count = 0
    for k in range(nearest_first(traffic, w, i, reach, near, distance)):
        space = cell_side(vec3(traffic.gap[w], i, near[k]), rules)
        count = add(rows, count, space, rules.max_speed)
    return count


@func
def cell_side(gap: Vec3, rules: Rules) -> HalfSpace:
    """Compute the half-space of velocities that stay on the drone's side of the bisecting plane.

    The side of the buffered cell is half-way to the other drone, minus half the separation
    (definition 1).

    Args:
        gap: Offset from the drone to the other drone, m.
        rules: Parameters of collision avoidance.

    Returns:
        Unit normal n and bound b, m/s, of n . v >= b.
    """
    ahead, distance = unit(gap, (1.0, 0.0, 0.0))
    margin = 0.5 * (distance - rules.separation)
    return (-ahead[0], -ahead[1], -ahead[2]), -margin / rules.braking
