"""Policy `orca`: optimal reciprocal collision avoidance (ORCA) in three dimensions.

Half-planes of the paper become half-spaces.

References:
    J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011).
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, kernel
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.rotation import vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    AvoidanceParameters,
    add_half_space,
    add_obstacle_half_spaces,
    find_nearest_drones,
    max_conflict_distance,
    orca_half_space,
    solve_with_right_turn,
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

    def __init__(self, aviary: Aviary) -> None:
        """Compute the distance of drones that may conflict; see `Avoidance`."""
        super().__init__(aviary)
        self.max_distance = max_conflict_distance(self.parameters)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Compute `orca_velocities`; see `Avoidance.avoid`."""
        return orca_velocities(traffic, preferred, parameters)


@allocating
def orca_velocities(
    traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
) -> np.ndarray:
    """Compute the permitted velocities nearest to the preferred ones.

    If no velocity is permitted, the result minimises the maximum violation (section 5.3). All
    drones that could violate the separation within the horizon are considered.

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
            count = _add_drone_half_spaces(rows, traffic, parameters, near, distance, w, i)
            count = add_obstacle_half_spaces(rows, count, traffic, parameters, w, i)
            best = solve_with_right_turn(
                rows, scratch, count, vec3(preferred, w, i), parameters.max_speed
            )
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _add_drone_half_spaces(
    rows: np.ndarray,
    traffic: Traffic,
    parameters: AvoidanceParameters,
    near: np.ndarray,
    distance: np.ndarray,
    w: int,
    i: int,
) -> int:
    """Write the half-spaces of all drones that are near enough to matter; return their number."""
    own = vec3(traffic.velocity, w, i)
    max_distance = max_conflict_distance(parameters)
    count = 0
    for k in range(find_nearest_drones(traffic, w, i, max_distance, near, distance)):
        offset = vec3(traffic.offset[w], i, near[k])
        other_velocity = vec3(traffic.other_velocity[w], i, near[k])
        # Reciprocal avoidance: each drone performs half.
        space = orca_half_space(offset, own, other_velocity, parameters.separation, parameters, 0.5)
        count = add_half_space(rows, count, space, parameters.max_speed)
    return count
