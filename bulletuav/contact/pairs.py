"""Broad phase: which pairs may touch within a substep.

Whoever a pair is, it is told by the numbers of its shapes, see `Scenery`.
"""

import numpy as np

from bulletuav.compiled.kernel import allocating, func
from bulletuav.compiled.plain import record_type
from bulletuav.contact.motion import put_vector, vector
from bulletuav.contact.touch import TOUCH
from bulletuav.geometry.city_grid import NO_LAYOUT, CityGrid, cells_in_rectangle
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.rotation import Vec3, dot, minus, point, quat4, to_body, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import distance_from_box

SLACK = 2e-3
"""Metres beyond its way within which a drone's pairs are collected"""
ORIGIN = (0.0, 0.0, 0.0)

PAIR = record_type(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("time", "f8"),
        ("normal", "f8", 3),
        ("floor", "f8"),
        ("held", "?"),
        ("near", "?"),
        ("knot", "?"),
        ("leans", "?"),
        ("joins", "?"),
    ],
    align=True,
)
"""A pair of shapes in one world.

Attributes:
    a: Number of a drone.
    b: Number of the other shape.
    time: Share of the substep at which they touch next; NEVER for not.
    normal: Direction of their last separation, or zeros.
    floor: Distance at which they count as touching next, m.
    held: Whether they touched already in this substep.
    near: Whether they were in touch when this time was found, even if they do not come closer.
    knot: Whether they do not touch at `time`, but one of them flies on about another axis.
    leans: Whether a lies on b, who sleeps and bears it.
    joins: Whether it is in touch in the present impact.
"""


@allocating
def _with_pair(
    pairs: np.ndarray,
    count: int,
    first: int,
    a: int,
    b: int,
) -> tuple[np.ndarray, int]:
    """Add a pair unless it is among those from `first` on; returns the pairs and their number."""
    for p in range(first, count):
        same = pairs[p].a == a and pairs[p].b == b
        if same or (pairs[p].b == a and pairs[p].a == b):
            return pairs, count
    if count == pairs.shape[0]:
        # One by one, which compiles in a quarter of the time
        wider = np.empty(2 * count, dtype=PAIR)
        for p in range(count):
            wider[p] = pairs[p]
        pairs = wider
    pair = pairs[count]
    pair.a = a
    pair.b = b
    pair.time = 0.0
    put_vector(pair.normal, ORIGIN)
    pair.floor = TOUCH
    pair.held = False
    pair.near = False
    pair.knot = False
    pair.leans = False
    pair.joins = False
    return pairs, count + 1


@func
def body_distance(
    scenery: Scenery,
    w: int,
    k: int,
    place: Vec3,
) -> float:
    """Return a lower bound of the distance of a point from body piece k of a world, m."""
    table = scenery.table
    s = scenery.first_body + k
    here = to_body(quat4(scenery.quaternion, w, k), minus(place, vec3(scenery.place, w, k)))
    half = point(table.half, s)
    return distance_from_box(minus(here, point(table.centre, s)), minus(ORIGIN, half), half)


@func
def piece_distance(
    city_grid: CityGrid,
    p: int,
    place: Vec3,
) -> float:
    """Return the distance of a point from the bounding box of a city's piece, m."""
    return distance_from_box(place, point(city_grid.low, p), point(city_grid.high, p))


@allocating
def collect(
    scenery: Scenery,
    motions: np.ndarray,
    alive: np.ndarray,
    w: int,
    order: np.ndarray,
    rank: int,
    again: bool,
    speed: float,
    pairs: np.ndarray,
    count: int,
) -> tuple[np.ndarray, int]:
    """Add the pairs of a drone with all that is within its reach.

    Args:
        scenery: What stands.
        motions: (N,) rows of `MOTION`; start, reach and due are read.
        alive: (W, N) bool, drones that can be touched.
        w: The world.
        order: (N,) drones of the world by x, then y, then z.
        rank: Place of the drone in `order`. Drones of lower rank that are due met it in their turn.
        again: Whether it was its turn before in this substep.
        speed: How far the fastest obstacle gets in the substep, m.
        pairs: Rows of `PAIR` that were found before.
        count: Their number.

    Returns:
        The pairs, perhaps in a larger array, and their number.
    """
    i = order[rank]
    here = vector(motions[i].start)
    far = scenery.table.radius[i] + motions[i].reach + TOUCH
    known = 0 if again else count
    # What does not fly: ground, bodies and pieces of the city
    if here[2] < far:
        pairs, count = _with_pair(pairs, count, known, i, scenery.ground)
    for k in range(scenery.place.shape[1]):
        if body_distance(scenery, w, k, here) < far + speed:
            pairs, count = _with_pair(pairs, count, known, i, scenery.first_body + k)
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
                    if piece_distance(city_grid, p, here) < far:
                        other = scenery.first_piece + p
                        pairs, count = _with_pair(pairs, count, known, i, other)
    # Drones in the order of their places, the lower one first
    for place in range(order.shape[0]):
        j = order[place]
        met = motions[j].due and place < rank and not again
        if j == i or not alive[w, j] or met:
            continue
        gap = minus(vector(motions[j].start), here)
        within = far + scenery.table.radius[j] + motions[j].reach
        if dot(gap, gap) < within * within:
            if place < rank:
                pairs, count = _with_pair(pairs, count, known, j, i)
            else:
                pairs, count = _with_pair(pairs, count, known, i, j)
    return pairs, count


@func
def sweeps_apart(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    dt: float,
) -> bool:
    """Tell whether the bounding volumes of a pair stay apart on their ways."""
    table = scenery.table
    here = vector(motions[a].position)
    move = vector(motions[a].move)
    margin = table.radius[a] + TOUCH
    if b < scenery.first_body:
        # Both move straight, but from times of their own: take the boxes of their ways
        there = vector(motions[b].position)
        other = vector(motions[b].move)
        if motions[a].time == motions[b].time and motions[a].until == motions[b].until:
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
        rest = (motions[a].until - motions[a].time) * dt
        before = (
            here[0] - where[0] - begun * drift[0],
            here[1] - where[1] - begun * drift[1],
            here[2] - where[2] - begun * drift[2],
        )
        change = (
            move[0] - rest * drift[0],
            move[1] - rest * drift[1],
            move[2] - rest * drift[2],
        )
        turn = quat4(scenery.quaternion, w, k)
        return _passes_box(table.centre[b], table.half[b], margin, turn, before, change)
    p = b - scenery.first_piece
    city_grid = scenery.city_grid
    for k in range(3):
        low = min(here[k], here[k] + move[k]) - margin
        high = max(here[k], here[k] + move[k]) + margin
        if low > city_grid.high[p, k] or high < city_grid.low[p, k]:
            return True
    return False


@func
def _passes_box(
    middle: np.ndarray,
    half: np.ndarray,
    margin: float,
    turn: tuple[float, float, float, float],
    start: Vec3,
    change: Vec3,
) -> bool:
    """Tell whether the box about a straight way, in body axes, stays off a box by a margin."""
    begin = to_body(turn, start)
    moved = to_body(turn, change)
    for k in range(3):
        one = begin[k] - middle[k]
        low = min(one, one + moved[k])
        high = max(one, one + moved[k])
        if low > half[k] + margin or high < -half[k] - margin:
            return True
    return False
