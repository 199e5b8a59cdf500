"""Policy `orca`: optimal reciprocal collision avoidance (ORCA) in three dimensions.

Half-planes of the paper become half-spaces.

References:
    J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-body collision avoidance (2011).
"""

from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.envs.aviary import Aviary
from bulletuav.geometry.grid import (
    Grid,
    cells_around,
    clear_grid,
    fill_grid,
    is_grid_filled,
    make_point_grid,
    num_rows,
    row_items,
    sort_by_key,
)
from bulletuav.geometry.rotation import Vec3, dot, minus, point, vec3
from bulletuav.policies.avoidance import Avoidance
from bulletuav.policies.half_spaces import (
    AvoidanceParameters,
    add_obstacle_half_spaces,
    max_conflict_distance,
    orca_half_space,
    solve_with_right_turn,
)
from bulletuav.policies.linear_program import DEPTH, write_half_space
from bulletuav.policies.traffic import Traffic
from bulletuav.registry import register


@register("policy")
class Orca(Avoidance):
    """Flight to the goal within the ORCA half-spaces of collision-free velocities.

    Other drones are assumed to perform half of the avoidance. Obstacles (bounding spheres),
    buildings, the ground and the bounds of the arena perform none.
    """

    name = "orca"
    searches_drones = True

    def __init__(self, aviary: Aviary) -> None:
        """Compute the distance of drones that may conflict; see `Avoidance`."""
        super().__init__(aviary)
        self.max_distance = max_conflict_distance(self.parameters)

    def avoid(
        self, traffic: Traffic, preferred: np.ndarray, parameters: AvoidanceParameters
    ) -> np.ndarray:
        """Compute `orca_velocities`; see `Avoidance.avoid`."""
        return orca_velocities(traffic, preferred, parameters)


class _Nearby(NamedTuple):
    """Work arrays of the half-spaces of other drones around one drone, before they are sorted.

    Attributes:
        item: (M,) indices of other drones.
        distance: (M,) squared distances of these drones, m^2.
        normal: (P, 3) normal of the half-space of each drone by index.
        bound: (P,) bound of the half-space of each drone by index, m/s.
        first: (M,) first entry of each bin of distances.
        sorted_item: (M,) the same indices, sorted by distance.
        sorted_distance: (M,) the same squared distances, sorted.
    """

    item: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    bound: np.ndarray
    first: np.ndarray
    sorted_item: np.ndarray
    sorted_distance: np.ndarray


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
    others = max(traffic.known.shape[2], traffic.alive.shape[1])
    capacity = others + traffic.sphere_radius.shape[2] + traffic.surface.shape[2]
    rows = np.empty((DEPTH, capacity, 4))
    scratch = np.empty_like(rows)
    nearby = _Nearby(
        item=np.empty(others, np.int64),
        distance=np.empty(others),
        normal=np.empty((others, 3)),
        bound=np.empty(others),
        first=np.empty(others, np.int64),
        sorted_item=np.empty(others, np.int64),
        sorted_distance=np.empty(others),
    )
    is_searched = traffic.alive.shape[1] > 0
    grid = make_point_grid(traffic.alive.shape[1])
    for w in range(preferred.shape[0]):
        if is_searched:
            grid.place[:] = traffic.position[w]
            if not fill_grid(grid, traffic.alive, w):
                clear_grid(grid)
        for i in range(preferred.shape[1]):
            if is_searched:
                found = _search_drones(nearby, grid, traffic, parameters, w, i)
            else:
                found = _read_drones(nearby, traffic, parameters, w, i)
            count = _write_half_spaces(rows, nearby, found)
            count = add_obstacle_half_spaces(rows, count, traffic, parameters, w, i)
            best = solve_with_right_turn(
                rows, scratch, count, vec3(preferred, w, i), parameters.max_speed
            )
            for axis in range(3):
                result[w, i, axis] = best[axis]
    return result


@kernel
def _read_drones(
    nearby: _Nearby, traffic: Traffic, parameters: AvoidanceParameters, w: int, i: int
) -> int:
    """List the half-spaces of all known drones that matter; return their number."""
    found = 0
    own = vec3(traffic.velocity, w, i)
    for k in range(traffic.known.shape[2]):
        if traffic.known[w, i, k]:
            offset = vec3(traffic.offset[w], i, k)
            velocity = vec3(traffic.other_velocity[w], i, k)
            found = _add_drone(nearby, found, k, offset, own, velocity, parameters)
    return found


@kernel
def _search_drones(
    nearby: _Nearby, grid: Grid, traffic: Traffic, parameters: AvoidanceParameters, w: int, i: int
) -> int:
    """List the half-spaces of all drones of a swarm that matter; return their number."""
    found = 0
    if not traffic.alive[w, i]:
        return found
    here, own = vec3(traffic.position, w, i), vec3(traffic.velocity, w, i)
    if not is_grid_filled(grid):
        # A position is not finite
        for j in range(traffic.alive.shape[1]):
            if traffic.alive[w, j] and j != i:
                offset = minus(vec3(traffic.position, w, j), here)
                velocity = vec3(traffic.velocity, w, j)
                found = _add_drone(nearby, found, j, offset, own, velocity, parameters)
        return found
    box = cells_around(grid, here, max_conflict_distance(parameters) + grid.sizes[1])
    for row in range(num_rows(box)):
        first, last = row_items(grid, box, row)
        for m in range(first, last):
            j = grid.item[m]
            if j != i:
                offset = minus(vec3(traffic.position, w, j), here)
                velocity = vec3(traffic.velocity, w, j)
                found = _add_drone(nearby, found, j, offset, own, velocity, parameters)
    return found


@func
def _add_drone(
    nearby: _Nearby,
    found: int,
    k: int,
    offset: Vec3,
    own: Vec3,
    velocity: Vec3,
    parameters: AvoidanceParameters,
) -> int:
    """List the half-space of drone k unless it permits all velocities; return the new number."""
    # Squared distances have the same order, and need no square root
    square = dot(offset, offset)
    max_distance = max_conflict_distance(parameters)
    if square <= max_distance * max_distance:
        # Reciprocal avoidance: each drone performs half.
        n, bound = orca_half_space(offset, own, velocity, parameters.separation, parameters, 0.5)
        # Fewer half-spaces have to be sorted if they are left out here
        if not bound <= -parameters.max_speed:
            nearby.item[found], nearby.distance[found] = k, square
            nearby.bound[k] = bound
            for axis in range(3):
                nearby.normal[k, axis] = n[axis]
            return found + 1
    return found


@func
def _write_half_spaces(rows: np.ndarray, nearby: _Nearby, found: int) -> int:
    """Write the listed half-spaces, those of the nearest drones first; return their number."""
    _sort_into_bins(nearby, found)
    sort_by_key(nearby.sorted_distance, nearby.sorted_item, found)
    for m in range(found):
        k = nearby.sorted_item[m]
        write_half_space(rows, 0, m, point(nearby.normal, k), nearby.bound[k])
    return found


@func
def _sort_into_bins(nearby: _Nearby, found: int) -> None:
    """Sort the listed drones roughly by distance, which makes their exact sorting faster.

    The squares of the distances to drones that are spread evenly in a plane are spread evenly, too,
    so that there is a bin for each drone.
    """
    first = nearby.first
    max_distance = 0.0
    for m in range(found):
        max_distance = max(max_distance, nearby.distance[m])
        first[m] = 0
    # Finite also if all drones are nearly at one point
    scale = min((found - 1) / max_distance, 1e300) if max_distance > 0.0 else 0.0
    # Counting sort, as in `fill_grid`
    for m in range(found):
        first[int(nearby.distance[m] * scale)] += 1
    for b in range(1, found):
        first[b] += first[b - 1]
    for m in range(found):
        b = int(nearby.distance[m] * scale)
        first[b] -= 1
        nearby.sorted_item[first[b]] = nearby.item[m]
        nearby.sorted_distance[first[b]] = nearby.distance[m]
