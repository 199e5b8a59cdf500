"""Contacts within one substep of one world, in the order of time.

A substep is flown freely first. Whoever would touch something is then taken to the time of the
touch; all who touch each other there are pushed apart together (an island); and they fly on with
what is left of the substep. A touch is a distance of `TOUCH`, so that shapes stay apart.
"""

import math

import numpy as np

from bulletuav.contact.impact import Workspace, World, halt, push_apart
from bulletuav.contact.motion import begin, finish
from bulletuav.contact.pairs import SLACK, Pairs, collect, make_pairs, rest_budget, sweeps_apart
from bulletuav.contact.touch import EXACT, NEVER, touch_time
from bulletuav.contact.touches import Touches
from bulletuav.geometry.rotation import dot, minus, point, vec3
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Swarm


@func
def _start_drone(space: Workspace, world: World, end: Swarm, i: int) -> None:
    """Begin the motion of a drone that may touch something, if it has not begun."""
    if i < world.scenery.first_body and not space.begun[i]:
        space.begun[i] = True
        begin(space.motions, world.start, end, world.w, i, world.parameters[world.w, i])


@kernel
def _time_pair(space: Workspace, world: World, pairs: Pairs, p: int, start: float) -> None:
    """Find when a pair touches next, from a time on."""
    a = pairs.who[p, 0]
    b = pairs.who[p, 1]
    motions = space.motions
    if sweeps_apart(world.scenery, motions, world.w, a, b, world.dt):
        pairs.time[p] = NEVER
        return
    time, normal = touch_time(
        world.scenery,
        motions,
        world.w,
        a,
        b,
        start,
        pairs.floor[p],
        max(1e-7, 0.2 * abs(pairs.floor[p])) if pairs.held[p] else EXACT,
        world.dt,
        point(pairs.normal, p),
        space.room,
    )
    pairs.time[p] = time
    for k in range(3):
        pairs.normal[p, k] = normal[k]


@kernel
def _next_pair(pairs: Pairs, count: int) -> int:
    """Return the pair that touches first, the first of several; -1 if none does."""
    first = -1
    time = NEVER
    for p in range(count):
        if pairs.time[p] < time:
            first = p
            time = pairs.time[p]
    return first


@func
def _is_before(position: np.ndarray, w: int, i: int, j: int) -> bool:
    """Tell whether drone i comes before drone j by x, then y, then z."""
    for k in range(3):
        if position[w, i, k] != position[w, j, k]:
            return position[w, i, k] < position[w, j, k]
    return False


@kernel
def in_order(position: np.ndarray, w: int) -> np.ndarray:
    """Return the drones (N,) of a world by place, so that their numbers do not matter."""
    order = np.arange(position.shape[1])
    for last in range(1, order.shape[0]):
        i = order[last]
        k = last
        while k > 0 and _is_before(position, w, i, order[k - 1]):
            order[k] = order[k - 1]
            k -= 1
        order[k] = i
    return order


@func
def _distance(one: np.ndarray, two: np.ndarray, w: int, i: int) -> float:
    """Return how far drone i is in one array (W, N, 3) from where it is in another, m."""
    way = minus(vec3(one, w, i), vec3(two, w, i))
    return math.sqrt(dot(way, way))


@kernel
def _due(space: Workspace, world: World, end: Swarm, budget: np.ndarray) -> bool:
    """Find the drones that have moved too far to be sure that they touch nothing."""
    w = world.w
    found = False
    for i in range(budget.shape[1]):
        space.due[i] = False
        space.begun[i] = False
        space.member[i] = False
        if world.alive[w, i]:
            way = _distance(end.position, world.start.position, w, i)
            space.reach[i] = way + SLACK
            budget[w, i] -= way + world.speed
            if budget[w, i] < 0.0:
                space.due[i] = True
                found = True
    return found


@kernel
def find_pairs(
    space: Workspace,
    world: World,
    end: Swarm,
    order: np.ndarray,
    pairs: Pairs,
) -> tuple[Pairs, int]:
    """Collect the pairs of all drones that are due, and time them."""
    count = 0
    for rank in range(order.shape[0]):
        i = order[rank]
        if space.due[i]:
            pairs, count = collect(
                world.scenery,
                world.start,
                world.alive,
                space.reach,
                world.w,
                i,
                order,
                rank,
                space.due,
                False,
                world.speed,
                pairs,
                count,
            )
    for p in range(count):
        _start_drone(space, world, end, pairs.who[p, 0])
        _start_drone(space, world, end, pairs.who[p, 1])
        _time_pair(space, world, pairs, p, 0.0)
    return pairs, count


@kernel
def _widen(
    space: Workspace,
    world: World,
    end: Swarm,
    order: np.ndarray,
    members: int,
    pairs: Pairs,
    count: int,
) -> tuple[Pairs, int]:
    """Collect the pairs of drones anew that were sent farther than was looked at."""
    motions = space.motions
    for rank in range(order.shape[0]):
        i = order[rank]
        if not space.member[i]:
            continue
        start = vec3(world.start.position, world.w, i)
        here = minus(point(motions.position, i), start)
        move = point(motions.move, i)
        there = (here[0] + move[0], here[1] + move[1], here[2] + move[2])
        way = math.sqrt(max(dot(here, here), dot(there, there)))
        if way > space.reach[i] or not space.due[i]:
            space.reach[i] = max(space.reach[i], 1.5 * way + SLACK)
            space.due[i] = True
            old = count
            pairs, count = collect(
                world.scenery,
                world.start,
                world.alive,
                space.reach,
                world.w,
                i,
                order,
                rank,
                space.due,
                True,
                world.speed,
                pairs,
                count,
            )
            for p in range(old, count):
                _start_drone(space, world, end, pairs.who[p, 0])
                _start_drone(space, world, end, pairs.who[p, 1])
    return pairs, count


@kernel
def resolve(
    space: Workspace,
    world: World,
    end: Swarm,
    budget: np.ndarray,
    stops: bool,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: Touches,
) -> bool:
    """Let the drones of a world touch what they would have flown into in a substep.

    Args:
        space: Arrays to work on.
        world: The world, and the state at the beginning of the substep.
        end: State at the end of the substep as flown freely; changed.
        budget: (W, N) how far each drone may move before it must be looked at, m; changed.
        stops: Whether drones stop where they touch, instead of being pushed.
        stopped: (W, N) bool, drones that stopped; changed.
        changed: (W, N) bool, drones whose state was changed; changed.
        touches: What was touched; added to.

    Returns:
        Whether anything was touched.
    """
    w = world.w
    if not _due(space, world, end, budget):
        return False
    order = in_order(world.start.position, w)
    pairs, count = find_pairs(space, world, end, order, make_pairs(16))
    eventful = False
    while True:
        first = _next_pair(pairs, count)
        if first < 0:
            break
        eventful = True
        time = pairs.time[first]
        if stops:
            members = halt(space, world, pairs, first, time, touches, stopped)
        else:
            members = push_apart(space, world, pairs, count, first, time, touches)
        pairs, count = _widen(space, world, end, order, members, pairs, count)
        for p in range(count):
            a = pairs.who[p, 0]
            b = pairs.who[p, 1]
            if space.member[a] or (b < world.scenery.first_body and space.member[b]):
                _time_pair(space, world, pairs, p, time)
        for m in range(members):
            i = space.island[m]
            space.member[i] = False
            changed[w, i] = True
    for i in range(changed.shape[1]):
        if changed[w, i]:
            finish(space.motions, end, w, i, world.parameters[w, i])
    for i in range(changed.shape[1]):
        if space.due[i]:
            rest_budget(world.scenery, end, world.alive, budget, w, i)
            budget[w, i] -= world.speed
    return eventful
