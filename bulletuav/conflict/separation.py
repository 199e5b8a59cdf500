"""Separation of drones within a decision, and conflicts: separations below d_safe.

A conflict is not a collision, which is a contact of collision shapes.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.gather import gathered, lane_numbers, scatter, three
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.lanes import WIDTH, is_any, where
from bulletuav.compiled.program import Program
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.grid import (
    MIN_POINTS,
    PATHS,
    ROUNDING,
    WIDENING,
    Grid,
    cells_around,
    clear_grid,
    fill_path_grid,
    is_grid_filled,
    is_whole,
    make_point_grid,
    new_point_grid,
    num_rows,
    row_items,
    sort_ascending,
)
from bulletuav.geometry.rotation import minus, point, vec3


class Conflict(NamedTuple):
    """Separations of each drone from all others within one decision.

    Attributes:
        separation: (W, N) minimum distance to another active drone, m; inf for a single drone.
        onsets: (W, N) number of other drones with which a conflict started.
        nearness: (W, N) sum over the other drones of the depth in the warning zone, from 0 at its
            edge to 1 at d_safe.
    """

    separation: np.ndarray
    onsets: np.ndarray
    nearness: np.ndarray


def no_conflict(shape: tuple[int, int]) -> Conflict:
    """Make the separations of drones (W, N) without any other drone."""
    return Conflict(
        separation=np.full(shape, np.inf),
        onsets=np.zeros(shape, dtype=np.int64),
        nearness=np.zeros(shape),
    )


@func
def _zone_squared(zone: float) -> float:
    """Return the squared radius of the warning zone, m^2, with a margin for rounding errors."""
    return (1.0 + 1e-9) * zone * zone


@deferred(types.boolean)
@allocating
def _fill_by_grid(
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    w: int,
    d_safe: float,
    zone: float,
    separation: np.ndarray,
    onsets: np.ndarray,
    nearness: np.ndarray,
) -> bool:
    """Write the results of world w; return False if a drone has a position that is not finite."""
    num_drones = alive.shape[1]
    grid = make_point_grid(num_drones)
    near = np.empty(num_drones, dtype=np.int64)
    finite = fill_path_grid(grid, before, after, PATHS, alive, w)
    if finite:
        paths, results = (before, after), (separation, onsets, nearness)
        _fill_from_grid(grid, near, paths, alive, w, d_safe, zone, results, 0, num_drones)
    return finite


@func
def _fill_from_grid(
    grid: Grid,
    near: np.ndarray,
    paths: tuple[np.ndarray, np.ndarray],
    alive: np.ndarray,
    w: int,
    d_safe: float,
    zone: float,
    results: tuple[np.ndarray, np.ndarray, np.ndarray],
    low: int,
    high: int,
) -> None:
    """Write the results of the drones from `low` to before `high` of world w, with its grid."""
    separation, onsets, nearness = results
    for i in range(low, high):
        separation[w, i], onsets[w, i], nearness[w, i] = np.inf, 0, 0.0
        if alive[w, i]:
            measured = _measure_near(grid, near, paths, w, i, d_safe, zone)
            separation[w, i], onsets[w, i], nearness[w, i] = measured


@kernel
def _measure_near(
    grid: Grid,
    near: np.ndarray,
    paths: tuple[np.ndarray, np.ndarray],
    w: int,
    i: int,
    d_safe: float,
    zone: float,
) -> tuple[float, int, float]:
    """Measure the separations of drone i from the drones around it, in steps of growing radius.

    Args:
        grid: Grid of the paths of world w.
        near: (N,) work array.
        paths: (W, N, 3) positions before and after, m.
        w: Index of the world.
        i: Index of the drone.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone starts, m.

    Returns:
        The entries of `Conflict`.
    """
    before, after = paths
    here, begin, end = point(grid.place, i), vec3(before, w, i), vec3(after, w, i)
    far = _zone_squared(zone)
    closer = grid.reach[i] + grid.sizes[2]
    radius = max(grid.sizes[0], (1.0 + ROUNDING) * math.sqrt(far) + closer)
    closest = np.inf
    count = 0
    is_first = True
    while True:
        box = cells_around(grid, here, radius)
        for row in range(num_rows(box)):
            first, last = row_items(grid, box, row)
            for m in range(first, last):
                j = grid.item[m]
                at_start = minus(vec3(before, w, j), begin)
                at_end = minus(vec3(after, w, j), end)
                least_squared = closest_squared_distances(at_start, at_end)[1]
                if j != i:
                    closest = min(closest, least_squared)
                    # All drones in the zone are within the first radius
                    if is_first and least_squared < far:
                        near[count] = j
                        count += 1
        if math.sqrt(closest) <= radius - closer or is_whole(grid, box):
            break
        is_first = False
        radius *= WIDENING
    # Sums are in the order of the drones
    sort_ascending(near, count)
    begun, depths = 0, 0.0
    for k in range(count):
        at_start = minus(vec3(before, w, near[k]), begin)
        at_end = minus(vec3(after, w, near[k]), end)
        start_squared, least_squared = closest_squared_distances(at_start, at_end)
        minimum = math.sqrt(least_squared)
        # An ongoing conflict started in an earlier decision
        if minimum < d_safe and d_safe <= math.sqrt(start_squared):
            begun += 1
        depths += min(1.0, max(0.0, (zone - minimum) / (zone - d_safe)))
    return math.sqrt(closest), begun, depths


@func
def _fill_lanes(
    paths: tuple[np.ndarray, np.ndarray],
    alive: np.ndarray,
    w: int,
    lowest: int,
    d_safe: float,
    zone: float,
    results: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Write the results of `WIDTH` drones from `lowest` on, each against all drones of world w."""
    before, after = paths
    separation, onsets, nearness = results
    num_drones, far = alive.shape[1], _zone_squared(zone)
    first = w * num_drones + lowest
    here = three(before, first)
    there = three(after, first)
    # Comparisons with NaN are false: a drone that does not fly has no near drone
    x = where(gathered(alive, first, 0), here[0], math.nan)
    itself = lane_numbers() + lowest
    closest, begun, depths = np.inf, 0.0, 0.0
    for j in range(num_drones):
        if not alive[w, j]:
            continue
        # Minimum separation during the motion, and separation at its start
        others = (where(itself != j, x, math.nan), here[1], here[2])
        at_start = minus(vec3(before, w, j), others)
        at_end = minus(vec3(after, w, j), there)
        start_squared, least_squared = closest_squared_distances(at_start, at_end)
        closest = min(closest, least_squared)
        if is_any(least_squared < far):
            start = math.sqrt(start_squared)
            minimum = math.sqrt(least_squared)
            # An ongoing conflict started in an earlier decision
            begun += where(minimum < d_safe, where(d_safe <= start, 1.0, 0.0), 0.0)
            depths += min(1.0, max(0.0, (zone - minimum) / (zone - d_safe)))
    count = min(num_drones - lowest, WIDTH)
    scatter(separation, first, count, math.sqrt(closest))
    scatter(onsets, first, count, begun)
    scatter(nearness, first, count, depths)


@kernel
def fill_conflict(
    first: int,
    last: int,
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    d_safe: float,
    zone: float,
    separation: np.ndarray,
    onsets: np.ndarray,
    nearness: np.ndarray,
) -> None:
    """Write the results of `measure_conflict`, which has the same arguments, for some worlds.

    These are the worlds from `first` to before `last`.
    """
    num_drones = alive.shape[1]
    paths, results = (before, after), (separation, onsets, nearness)
    # `ByWorld` calls this with the arrays of one world
    for w in range(first, min(last, alive.shape[0])):
        if num_drones >= MIN_POINTS and _fill_by_grid(
            before, after, alive, w, d_safe, zone, separation, onsets, nearness
        ):
            continue
        for lowest in range(0, num_drones, WIDTH):
            _fill_lanes(paths, alive, w, lowest, d_safe, zone, results)


@kernel
def start_conflict(before: np.ndarray, after: np.ndarray, alive: np.ndarray, grid: Grid) -> None:
    """Fill the grid of a single world for `fill_conflict_of_blocks`."""
    if not fill_path_grid(grid, before, after, PATHS, alive, 0):
        clear_grid(grid)


@kernel
def fill_conflict_of_blocks(
    begin: int,
    end: int,
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    d_safe: float,
    zone: float,
    separation: np.ndarray,
    onsets: np.ndarray,
    nearness: np.ndarray,
    grid: Grid,
    near: np.ndarray,
) -> None:
    """Write the results of `measure_conflict` for some drones of a single world.

    Args:
        begin: Index of the first block of `WIDTH` drones.
        end: Index after the last block.
        before: As in `measure_conflict`, like the following arguments.
        after: Positions at the end of the decision.
        alive: Drones to measure.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone starts, m.
        separation: As in `Conflict`, written, like the following two.
        onsets: Number of conflicts that started.
        nearness: Depths in the warning zone.
        grid: Grid of `start_conflict`.
        near: (N,) work array.
    """
    paths, results = (before, after), (separation, onsets, nearness)
    if is_grid_filled(grid):
        low, high = begin * WIDTH, min(end * WIDTH, alive.shape[1])
        _fill_from_grid(grid, near, paths, alive, 0, d_safe, zone, results, low, high)
        return
    for block in range(begin, end):
        _fill_lanes(paths, alive, 0, block * WIDTH, d_safe, zone, results)


def add_conflict(
    program: Program,
    before: np.ndarray,
    after: np.ndarray,
    alive: np.ndarray,
    d_safe: float,
    zone: float,
    conflict: Conflict,
) -> None:
    """Add calls to a program that write the result of `measure_conflict` to `conflict`."""
    num_worlds, num_drones = alive.shape
    given = (before, after, alive, d_safe, zone, *conflict)
    if program.threads == 1 or num_worlds > 1 or num_drones < MIN_POINTS:
        program.call(*program.shared(fill_conflict, num_worlds, *given))
        return
    grid = new_point_grid(num_drones)
    own = [(np.zeros(num_drones, dtype=np.int64),) for _ in range(program.threads)]
    program.call(start_conflict, before, after, alive, grid)
    blocks = -(-num_drones // WIDTH)
    program.call(*program.shared(fill_conflict_of_blocks, blocks, *given, grid, own=own))


def measure_conflict(
    before: np.ndarray, after: np.ndarray, alive: np.ndarray, d_safe: float, zone: float
) -> Conflict:
    """Measure separations while all drones move in straight lines from one position to the next.

    A conflict over several decisions is counted once, in the decision in which the separation falls
    below `d_safe`.

    Args:
        before: (W, N, 3) positions at the start of the decision, m.
        after: (W, N, 3) positions at the end of the decision, m.
        alive: (W, N) bool, the drones to measure.
        d_safe: Separation below which two drones are in conflict, m.
        zone: Separation at which the warning zone starts, m; greater than `d_safe`.

    Returns:
        The separations of each drone.
    """
    result = no_conflict(alive.shape)
    places = (np.ascontiguousarray(before), np.ascontiguousarray(after))
    fill_conflict(0, len(alive), *places, np.ascontiguousarray(alive), d_safe, zone, *result)
    return result
