"""Broad phase: which pairs may touch within a substep, and how long a drone needs no look at all.

Every drone has a budget: how far it may move before anything can be near. Only drones that have
used it up are looked at. Budgets change no result: no touch is possible while both of a pair have
some left. Whoever a pair is, it is told by the numbers of its shapes, see `Scenery`.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.contact.motion import Motions
from bulletuav.contact.touch import TOUCH
from bulletuav.geometry.city_grid import NO_LAYOUT, CityGrid, reached
from bulletuav.geometry.closest_approach import closest_squared
from bulletuav.geometry.rotation import Vec3, dot, minus, point, quat4, to_body, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Swarm

SPARE = 1e-3
"""Metres that budgets leave, beside a touch, for rounding"""
FARTHEST = 20.0
"""Greatest budget, m"""
VIEW = 5.0
"""Distance within which a city is looked at for a budget, m"""
SLACK = 2e-3
"""Metres beyond its way within which a drone's pairs are collected"""


class Pairs(NamedTuple):
    """Pairs of shapes in one world; some rows are room for more.

    Attributes:
        who: (P, 2) number of a drone, and of the other shape.
        time: (P,) share of the substep at which they touch next; NEVER for not.
        normal: (P, 3) direction of their last separation, or zeros.
        floor: (P,) distance at which they count as touching next, m.
        held: (P,) bool, whether they touched already in this substep.
    """

    who: np.ndarray
    time: np.ndarray
    normal: np.ndarray
    floor: np.ndarray
    held: np.ndarray


@kernel
def make_pairs(room: int) -> Pairs:
    """Make room for pairs."""
    return Pairs(
        np.empty((room, 2), dtype=np.int64),
        np.empty(room),
        np.zeros((room, 3)),
        np.empty(room),
        np.zeros(room, dtype=np.bool_),
    )


@kernel
def _doubled(pairs: Pairs) -> Pairs:
    """Return the same pairs with room for twice as many."""
    count = pairs.time.shape[0]
    new = make_pairs(2 * count)
    new.who[:count] = pairs.who
    new.time[:count] = pairs.time
    new.normal[:count] = pairs.normal
    new.floor[:count] = pairs.floor
    new.held[:count] = pairs.held
    return new


@kernel
def _with_pair(pairs: Pairs, count: int, first: int, a: int, b: int) -> tuple[Pairs, int]:
    """Add a pair unless it is among those from `first` on; returns the pairs and their number."""
    for p in range(first, count):
        same = pairs.who[p, 0] == a and pairs.who[p, 1] == b
        if same or (pairs.who[p, 0] == b and pairs.who[p, 1] == a):
            return pairs, count
    if count == pairs.time.shape[0]:
        pairs = _doubled(pairs)
    pairs.who[count, 0] = a
    pairs.who[count, 1] = b
    pairs.time[count] = 0.0
    for k in range(3):
        pairs.normal[count, k] = 0.0
    pairs.floor[count] = TOUCH
    pairs.held[count] = False
    return pairs, count + 1


@func
def _box_distance(scenery: Scenery, w: int, k: int, place: Vec3) -> float:
    """Return a lower bound of the distance of a point from body piece k of a world, m."""
    s = scenery.first_body + k
    table = scenery.table
    body = vec3(scenery.place, w, k)
    here = to_body(quat4(scenery.quaternion, w, k), minus(place, body))
    beyond = 0.0
    for m in range(3):
        past = abs(here[m] - table.middle[s, m]) - table.half[s, m]
        if past > 0.0:
            beyond += past * past
    return math.sqrt(beyond)


@func
def _piece_distance(city_grid: CityGrid, p: int, place: Vec3) -> float:
    """Return the distance of a point from the bounding box of a city's piece, m."""
    beyond = 0.0
    for m in range(3):
        past = max(city_grid.low[p, m] - place[m], place[m] - city_grid.high[p, m])
        if past > 0.0:
            beyond += past * past
    return math.sqrt(beyond)


@kernel
def collect(
    scenery: Scenery,
    swarm: Swarm,
    alive: np.ndarray,
    reach: np.ndarray,
    w: int,
    i: int,
    order: np.ndarray,
    rank: int,
    due: np.ndarray,
    again: bool,
    speed: float,
    pairs: Pairs,
    count: int,
) -> tuple[Pairs, int]:
    """Add the pairs of drone i with all that is within its reach.

    Args:
        scenery: What stands.
        swarm: State of all drones at the beginning of the substep.
        alive: (W, N) bool, drones that can be touched.
        reach: (N,) how far from there each drone may get in the substep, m.
        w: The world.
        i: The drone.
        order: (N,) drones of the world by x, then y, then z.
        rank: Place of i in `order`.
        due: (N,) bool, drones that are looked at in this substep, in that order.
        again: Whether it was i's turn before in this substep.
        speed: How far the fastest obstacle gets in the substep, m.
        pairs: What was found before.
        count: Their number.

    Returns:
        The pairs, perhaps in larger arrays, and their number.
    """
    here = vec3(swarm.position, w, i)
    far = scenery.table.radius[i] + reach[i] + TOUCH
    known = 0 if again else count
    # What does not fly: ground, bodies and pieces of the city
    if here[2] < far:
        pairs, count = _with_pair(pairs, count, known, i, scenery.ground)
    for k in range(scenery.place.shape[1]):
        if _box_distance(scenery, w, k, here) < far + speed:
            pairs, count = _with_pair(pairs, count, known, i, scenery.first_body + k)
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout != NO_LAYOUT:
        left, right, bottom, top = reached(
            city_grid, here[0] - far, here[0] + far, here[1] - far, here[1] + far
        )
        for column in range(left, right):
            for row in range(bottom, top):
                cell = column * city_grid.cells + row
                for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                    p = city_grid.item[m]
                    if _piece_distance(city_grid, p, here) < far:
                        other = scenery.first_piece + p
                        pairs, count = _with_pair(pairs, count, known, i, other)
    # Drones in the order of their places, the lower one first
    for place in range(order.shape[0]):
        j = order[place]
        met = due[j] and place < rank and not again
        if j == i or not alive[w, j] or met:
            continue
        gap = minus(vec3(swarm.position, w, j), here)
        within = far + scenery.table.radius[j] + reach[j]
        if dot(gap, gap) < within * within:
            if place < rank:
                pairs, count = _with_pair(pairs, count, known, j, i)
            else:
                pairs, count = _with_pair(pairs, count, known, i, j)
    return pairs, count


@kernel
def sweeps_apart(
    scenery: Scenery,
    motions: Motions,
    w: int,
    a: int,
    b: int,
    dt: float,
) -> bool:
    """Tell whether the bounding volumes of a pair stay apart for the rest of the substep."""
    table = scenery.table
    here = point(motions.position, a)
    move = point(motions.move, a)
    margin = table.radius[a] + TOUCH
    if b < scenery.first_body:
        # Both move straight, but from times of their own: take the boxes of their ways
        there = point(motions.position, b)
        other = point(motions.move, b)
        if motions.time[a] == motions.time[b]:
            before = minus(there, here)
            after = (
                before[0] + other[0] - move[0],
                before[1] + other[1] - move[1],
                before[2] + other[2] - move[2],
            )
            within = margin + table.radius[b]
            return closest_squared(before, after)[1] > within * within
        margin += table.radius[b]
        for k in range(3):
            low = max(min(here[k], here[k] + move[k]), min(there[k], there[k] + other[k]))
            high = min(max(here[k], here[k] + move[k]), max(there[k], there[k] + other[k]))
            if low - high > margin:
                return True
        return False
    if b == scenery.ground:
        return min(here[2], here[2] + move[2]) > margin
    if b < scenery.first_piece:
        k = b - scenery.first_body
        where = vec3(scenery.place, w, k)
        drift = vec3(scenery.velocity, w, k)
        begun = motions.time[a] * dt
        rest = dt - begun
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
        return _passes_box(table.middle[b], table.half[b], margin, turn, before, change)
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


@kernel
def rest_budget(
    scenery: Scenery,
    swarm: Swarm,
    alive: np.ndarray,
    budget: np.ndarray,
    w: int,
    i: int,
) -> None:
    """Give drone i of world w the metres that it may move before anything can touch it.

    Args:
        scenery: What stands.
        swarm: State of all drones.
        alive: (W, N) bool, drones that can be touched.
        budget: (W, N) m; that of drone i is set, and those of others are lowered where i is near.
        w: The world.
        i: The drone.
    """
    here = vec3(swarm.position, w, i)
    own = scenery.table.radius[i] + TOUCH + SPARE
    least = min(FARTHEST, here[2] - own)
    # Bodies may be many: none nearer than what is known already needs its box
    for k in range(scenery.place.shape[1]):
        least = min(least, _box_distance(scenery, w, k, here) - own)
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout != NO_LAYOUT and least > 0.0:
        far = min(VIEW, least) + own
        least = min(least, VIEW)
        left, right, bottom, top = reached(
            city_grid, here[0] - far, here[0] + far, here[1] - far, here[1] + far
        )
        for column in range(left, right):
            for row in range(bottom, top):
                cell = column * city_grid.cells + row
                for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                    distance = _piece_distance(city_grid, city_grid.item[m], here)
                    least = min(least, distance - own)
    # What is between two drones is for both: half each
    for j in range(alive.shape[1]):
        if j != i and alive[w, j]:
            gap = minus(vec3(swarm.position, w, j), here)
            share = 0.5 * (math.sqrt(dot(gap, gap)) - own - scenery.table.radius[j])
            least = min(least, share)
            budget[w, j] = min(budget[w, j], share)
    budget[w, i] = least
