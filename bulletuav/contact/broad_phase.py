"""Broad phase: find the pairs that may touch within a substep.

A pair is given by the indices of its two shapes, see `Scenery`.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import read_vec3, write_vec3
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.geometry.city_grid import NO_LAYOUT, CityGrid, cells_in_rectangle
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.grid import (
    Grid,
    cells_around,
    clear_grid,
    fill_grid,
    is_grid_filled,
    num_rows,
    row_items,
    sort_ascending,
)
from bulletuav.geometry.rotation import Vec3, dot, minus, point, quat4, to_body, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import distance_from_box

PAIR_MARGIN = 2e-3
"""Distance beyond the path of a drone within which its pairs are collected, m"""
ORIGIN = (0.0, 0.0, 0.0)

PAIR = record_type(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("impact_time", "f8"),
        ("normal", "f8", 3),
        ("target_distance", "f8"),
        ("has_touched", "?"),
        ("in_contact", "?"),
        ("is_segment_end", "?"),
        ("is_on_sleeper", "?"),
        ("in_impact", "?"),
    ],
    align=True,
)
"""A pair of shapes in one world.

Attributes:
    a: Shape index of a drone.
    b: Index of the other shape.
    impact_time: Fraction of the substep of the next impact; `NO_IMPACT` for none.
    normal: Direction of the last separation, or zeros.
    target_distance: Distance at which the pair counts as touching next, m.
    has_touched: Whether the pair touched already in this substep.
    in_contact: Whether the pair was in contact when this time was found, even if it does not
        approach.
    is_segment_end: Whether there is no impact at `impact_time`, but the end of a path segment of
        a drone that rotates fast.
    is_on_sleeper: Whether a rests on b, a sleeping drone that acts as a static body.
    in_impact: Whether the pair is in contact in the present impact.
"""


@allocating
def _add_pair(
    pairs: np.ndarray, num_pairs: int, first: int, a: int, b: int
) -> tuple[np.ndarray, int]:
    """Add a pair unless it is among those from `first` on; returns the pairs and their number."""
    for p in range(first, num_pairs):
        same = pairs[p].a == a and pairs[p].b == b
        if same or (pairs[p].b == a and pairs[p].a == b):
            return pairs, num_pairs
    if num_pairs == pairs.shape[0]:
        # A loop over rows compiles in a quarter of the time
        wider = np.empty(2 * num_pairs, dtype=PAIR)
        for p in range(num_pairs):
            wider[p] = pairs[p]
        pairs = wider
    pair = pairs[num_pairs]
    pair.a = a
    pair.b = b
    pair.impact_time = 0.0
    write_vec3(pair.normal, ORIGIN)
    pair.target_distance = CONTACT_DISTANCE
    pair.has_touched = False
    pair.in_contact = False
    pair.is_segment_end = False
    pair.is_on_sleeper = False
    pair.in_impact = False
    return pairs, num_pairs + 1


@func
def bound_body_distance(scenery: Scenery, w: int, k: int, place: Vec3) -> float:
    """Return a lower bound of the distance of a point from body k of a world, m."""
    table = scenery.table
    s = scenery.first_body + k
    here = to_body(quat4(scenery.quaternion, w, k), minus(place, vec3(scenery.place, w, k)))
    half = point(table.half, s)
    return distance_from_box(minus(here, point(table.centre, s)), minus(ORIGIN, half), half)


@func
def compute_piece_distance(city_grid: CityGrid, p: int, place: Vec3) -> float:
    """Return the distance of a point from the bounding box of a building piece, m."""
    return distance_from_box(place, point(city_grid.low, p), point(city_grid.high, p))


@allocating
def collect_pairs(
    scenery: Scenery,
    motions: np.ndarray,
    alive: np.ndarray,
    w: int,
    order: np.ndarray,
    rank: int,
    again: bool,
    obstacle_displacement: float,
    others: tuple[Grid, np.ndarray, np.ndarray],
    pairs: np.ndarray,
    num_pairs: int,
) -> tuple[np.ndarray, int]:
    """Add the pairs of a drone with all shapes that it may touch in the substep.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`; `start_position`, `range` and `is_due` are read.
        alive: (W, N) bool, drones that can be touched.
        w: Index of the world.
        order: (N,) drones of the world sorted by x, then y, then z.
        rank: Position of the drone in `order`. Its pairs with drones of lower
            rank that are checked, too, exist already.
        again: True if pairs of the drone were collected before in this substep.
        obstacle_displacement: Displacement of the fastest obstacle in the substep, m.
        others: `grid`, `rank` and `near` of the `ContactWorkspace`; the grid may be unfilled.
        pairs: Rows of `PAIR` that were found before.
        num_pairs: Number of these pairs.

    Returns:
        The pairs, perhaps in a larger array, and their number.
    """
    i = order[rank]
    here = read_vec3(motions[i].start_position)
    far = scenery.table.radius[i] + motions[i].range + CONTACT_DISTANCE
    known = 0 if again else num_pairs
    # Static shapes: ground, bodies and building pieces
    if here[2] < far:
        pairs, num_pairs = _add_pair(pairs, num_pairs, known, i, scenery.ground)
    for k in range(scenery.place.shape[1]):
        if bound_body_distance(scenery, w, k, here) < far + obstacle_displacement:
            pairs, num_pairs = _add_pair(pairs, num_pairs, known, i, scenery.first_body + k)
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout != NO_LAYOUT:
        left, right, bottom, top = cells_in_rectangle(
            city_grid, here[0] - far, here[0] + far, here[1] - far, here[1] + far
        )
        for column in range(left, right):
            for row in range(bottom, top):
                cell = column * city_grid.cells + row
                for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                    p = city_grid.item[m]
                    if compute_piece_distance(city_grid, p, here) < far:
                        other = scenery.first_piece + p
                        pairs, num_pairs = _add_pair(pairs, num_pairs, known, i, other)
    # Other drones in sorted order; the drone of lower rank is a
    grid, _, near = others
    is_listed = is_grid_filled(grid)
    count = order.shape[0]
    if is_listed:
        count = _list_ranks(grid, others[1], near, here, far)
    for entry in range(count):
        place = near[entry] if is_listed else entry
        j = order[place]
        is_paired = motions[j].is_due and place < rank and not again
        if j == i or not alive[w, j] or is_paired:
            continue
        between = minus(read_vec3(motions[j].start_position), here)
        within = far + scenery.table.radius[j] + motions[j].range
        if dot(between, between) < within * within:
            if place < rank:
                pairs, num_pairs = _add_pair(pairs, num_pairs, known, j, i)
            else:
                pairs, num_pairs = _add_pair(pairs, num_pairs, known, i, j)
    return pairs, num_pairs


@deferred(types.none)
@kernel
def fill_pair_grid(
    scenery: Scenery, motions: np.ndarray, alive: np.ndarray, w: int, grid: Grid
) -> None:
    """Fill the grid of the drones for `collect_pairs`, unless a position is not finite.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`; `start_position` and `range` are read.
        alive: (W, N) bool, drones that can be touched.
        w: Index of the world.
        grid: The grid; `sizes` get the largest sum of a radius and a range.
    """
    most = 0.0
    for i in range(grid.place.shape[0]):
        write_vec3(grid.place[i], read_vec3(motions[i].start_position))
        most = max(most, scenery.table.radius[i] + motions[i].range)
    grid.sizes[2] = most
    if not fill_grid(grid, alive, w):
        clear_grid(grid)


@deferred(types.int64)
@kernel
def _list_ranks(grid: Grid, rank: np.ndarray, near: np.ndarray, here: Vec3, far: float) -> int:
    """List the ranks of all drones that a drone may touch, ascending; return their number."""
    radius = far + grid.sizes[2] + grid.sizes[1]
    box = cells_around(grid, here, radius)
    count = 0
    for row in range(num_rows(box)):
        first, last = row_items(grid, box, row)
        for m in range(first, last):
            between = minus(point(grid.place, grid.item[m]), here)
            if dot(between, between) <= radius * radius:
                near[count] = rank[grid.item[m]]
                count += 1
    sort_ascending(near, count)
    return count


@func
def are_swept_bounds_apart(
    scenery: Scenery, motions: np.ndarray, w: int, a: int, b: int, dt: float
) -> bool:
    """Check whether the bounding volumes of a pair stay apart along their paths."""
    table = scenery.table
    here = read_vec3(motions[a].position)
    move = read_vec3(motions[a].displacement)
    margin = table.radius[a] + CONTACT_DISTANCE
    if b < scenery.first_body:
        # Both move straight; if their segments start at different times, use bounding boxes
        there = read_vec3(motions[b].position)
        other = read_vec3(motions[b].displacement)
        if motions[a].time == motions[b].time and motions[a].end_time == motions[b].end_time:
            before = minus(there, here)
            after = (
                before[0] + other[0] - move[0],
                before[1] + other[1] - move[1],
                before[2] + other[2] - move[2],
            )
            within = margin + table.radius[b]
            apart: bool = closest_squared_distances(before, after)[1] > within * within
            return apart
        margin += table.radius[b]
        for k in range(3):
            low = max(min(here[k], here[k] + move[k]), min(there[k], there[k] + other[k]))
            high = min(max(here[k], here[k] + move[k]), max(there[k], there[k] + other[k]))
            if low - high > margin:
                return True
        return False
    if b == scenery.ground:
        high_up: bool = min(here[2], here[2] + move[2]) > margin
        return high_up
    if b < scenery.first_piece:
        k = b - scenery.first_body
        where = vec3(scenery.place, w, k)
        drift = vec3(scenery.velocity, w, k)
        begun = motions[a].time * dt
        remaining = (motions[a].end_time - motions[a].time) * dt
        before = (
            here[0] - where[0] - begun * drift[0],
            here[1] - where[1] - begun * drift[1],
            here[2] - where[2] - begun * drift[2],
        )
        change = (
            move[0] - remaining * drift[0],
            move[1] - remaining * drift[1],
            move[2] - remaining * drift[2],
        )
        turn = quat4(scenery.quaternion, w, k)
        # In the axes at the beginning of the substep, to which a body has turned at most this far
        spin = vec3(scenery.spin, w, k)
        margin += math.sqrt(dot(spin, spin)) * dt * table.radius[b]
        return _is_sweep_clear_of_box(table.centre[b], table.half[b], margin, turn, before, change)
    p = b - scenery.first_piece
    city_grid = scenery.city_grid
    for k in range(3):
        low = min(here[k], here[k] + move[k]) - margin
        high = max(here[k], here[k] + move[k]) + margin
        if low > city_grid.high[p, k] or high < city_grid.low[p, k]:
            return True
    return False


@func
def _is_sweep_clear_of_box(
    middle: np.ndarray,
    half: np.ndarray,
    margin: float,
    turn: tuple[float, float, float, float],
    start: Vec3,
    change: Vec3,
) -> bool:
    """Check whether the box around a straight path, in body axes, keeps a margin to a box."""
    begin = to_body(turn, start)
    moved = to_body(turn, change)
    for k in range(3):
        one = begin[k] - middle[k]
        low = min(one, one + moved[k])
        high = max(one, one + moved[k])
        if low > half[k] + margin or high < -half[k] - margin:
            return True
    return False
