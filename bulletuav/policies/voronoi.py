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
    AvoidanceParameters,
    HalfSpace,
    add_half_space,
    add_obstacle_half_spaces,
    direction_and_length,
    find_nearest_drones,
    solve_with_right_turn,
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

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Compute `voronoi_velocities`; see `Avoidance.avoid`."""
        return voronoi_velocities(traffic, preferred, parameters)


@allocating
def voronoi_velocities(
    traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
) -> np.ndarray:
    """Compute the velocities nearest to the preferred ones that stay within the Voronoi cells.

    At a permitted velocity, a drone is still in its cell after the braking time.

    Args:
        traffic: The traffic around each drone.
        preferred: (W, N, 3) preferred velocities, m/s.
        parameters: Parameters of collision avoidance.

    Returns:
        (W, N, 3) velocities, m/s.
    """
    result = np.empty(preferred.shape)
    # One half-space for each neighbour, each sphere and each surface.
    others = traffic.known.shape[2]
    capacity = others + traffic.sphere_radius.shape[2] + traffic.surface.shape[2]
    rows = np.empty((DEPTH, capacity, 4))
    scratch = np.empty_like(rows)
    near = np.empty(others, np.int64)
    distance = np.empty(others)
    for w in range(preferred.shape[0]):
        for i in range(preferred.shape[1]):
            count = _add_cell_half_spaces(rows, traffic, parameters, near, distance, w, i)
            count = add_obstacle_half_spaces(rows, count, traffic, parameters, w, i)
            best = solve_with_right_turn(
                rows, scratch, count, vec3(preferred, w, i), parameters.max_speed
            )
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _add_cell_half_spaces(
    rows: np.ndarray,
    traffic: Traffic,
    parameters: AvoidanceParameters,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Write the half-spaces of a drone's cell; return their number."""
    # Drones beyond this distance cannot be reached within the braking time
    max_distance = parameters.separation + 2.0 * parameters.max_speed * parameters.braking_time
    count = 0
    for k in range(find_nearest_drones(traffic, w, i, max_distance, near, distance)):
        space = voronoi_half_space(vec3(traffic.offset[w], i, near[k]), parameters)
        count = add_half_space(rows, count, space, parameters.max_speed)
    return count


@func
def voronoi_half_space(offset: Vec3, parameters: AvoidanceParameters) -> HalfSpace:
    """Compute the half-space of velocities that stay on the drone's side of the bisecting plane.

    The side of the buffered cell is half-way to the other drone, minus half the separation
    (definition 1).

    Args:
        offset: Offset from the drone to the other drone, m.
        parameters: Parameters of collision avoidance.

    Returns:
        Unit normal n and bound b, m/s, of n . v >= b.
    """
    ahead, distance = direction_and_length(offset, (1.0, 0.0, 0.0))
    margin = 0.5 * (distance - parameters.separation)
    return (-ahead[0], -ahead[1], -ahead[2]), -margin / parameters.braking_time
