"""Contacts within one substep of one world, in the order of time.

A substep is flown freely first. Whoever would touch something is then taken to the time of the
touch; all who touch each other there are pushed apart together (an island); and they fly on with
what is left of the substep. A touch is a distance of `TOUCH`, so that shapes stay apart.
"""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.contact.budgets import are_clear, free_way, share_gaps
from bulletuav.contact.impact import add_forces, push_apart
from bulletuav.contact.island import join
from bulletuav.contact.motion import (
    aim,
    begin,
    change_rates,
    finish,
    is_spent,
    put_vector,
    valid_until,
    vector,
)
from bulletuav.contact.order import set_order
from bulletuav.contact.pairs import SLACK, collect, sweeps_apart
from bulletuav.contact.points import Workspace, World
from bulletuav.contact.staying import halt
from bulletuav.contact.touch import NEVER, TOUCH, touch_time
from bulletuav.contact.touches import Touches
from bulletuav.geometry.rotation import dot, minus, plus, vec3
from bulletuav.vehicle.swarm import Swarm


@deferred(types.none)
@kernel
def _start_drone(space: Workspace, world: World, end: Swarm, i: int) -> None:
    """Begin the motion of a drone that may touch something, if it has not begun."""
    if i < world.scenery.first_body and not space.motions[i].begun:
        row = world.parameters[world.w, i]
        begin(space.motions[i], world.start, end, world.w, i, row, world.dt)
        space.motions[i].bears = world.asleep[world.w, i]
        for k in range(3):
            space.motions[i].load[0, k] = space.motions[i].load[1, k] = 0.0


@func
def _is_over(space: Workspace, world: World, pair: np.record) -> bool:
    """Tell whether a pair is not asked any more when it touches.

    Drones of too many impacts stay, or go along with an obstacle, and take along those of them that
    they come to. So such pairs are over unless one moves against the other. Who goes along with an
    obstacle is asked for no other one.
    """
    motions = space.motions
    if not is_spent(motions[pair.a]):
        return False
    if pair.b < motions.shape[0] and not is_spent(motions[pair.b]):
        return False
    if world.stops:
        return True
    way, _ = change_rates(world.scenery, motions, world.w, pair.a, world.dt)
    other, _ = change_rates(world.scenery, motions, world.w, pair.b, world.dt)
    off = minus(way, other)
    taken = pair.b >= motions.shape[0] and way != (0.0, 0.0, 0.0)
    return taken or dot(off, off) < TOUCH * TOUCH


@kernel
def _time_pair(space: Workspace, world: World, pair: np.record, start: float) -> None:
    """Find when a pair touches next, from a time on."""
    motions = space.motions
    pair.time = NEVER
    pair.knot = False
    pair.near = False
    if _is_over(space, world, pair):
        return
    if not sweeps_apart(world.scenery, motions, world.w, pair.a, pair.b, world.dt):
        pair.time, normal, pair.near = touch_time(
            world.scenery,
            motions,
            world.w,
            pair.a,
            pair.b,
            start,
            pair.floor,
            pair.held,
            world.dt,
            vector(pair.normal),
            space.room,
            world.stops,
        )
        put_vector(pair.normal, normal)
    if pair.time == NEVER:
        end = valid_until(world.scenery, motions, pair.a)
        end = min(end, valid_until(world.scenery, motions, pair.b))
        if end < 1.0:
            pair.time = end
            pair.knot = True


@func
def _next_pair(pairs: np.ndarray, count: int) -> int:
    """Return the pair that touches first, the first of several; -1 if none does."""
    first = -1
    time = NEVER
    for p in range(count):
        if pairs[p].time < time:
            first = p
            time = pairs[p].time
    return first


@func
def _distance(one: np.ndarray, two: np.ndarray, w: int, i: int) -> float:
    """Return how far drone i is in one array (W, N, 3) from where it is in another, m."""
    way = minus(vec3(one, w, i), vec3(two, w, i))
    return math.sqrt(dot(way, way))


@func
def _set_reach(space: Workspace, world: World, end: Swarm, budget: np.ndarray) -> None:
    """Set how far drones get in the substep, and which of them are looked at.

    These are all that are due, and who would be after one more such substep: one look serves both.
    """
    w = world.w
    for i in range(budget.shape[1]):
        motion = space.motions[i]
        motion.begun = False
        motion.due = False
        motion.reach = SLACK
        if world.alive[w, i] and not world.asleep[w, i]:
            motion.reach += _distance(end.position, world.start.position, w, i)
            motion.due = budget[w, i] < motion.reach


@allocating
def _collect_of(
    space: Workspace,
    world: World,
    end: Swarm,
    order: np.ndarray,
    rank: int,
    again: bool,
    pairs: np.ndarray,
    count: int,
) -> tuple[np.ndarray, int]:
    """Collect the pairs of one drone, and begin the motions of all in them; see `collect`."""
    old = count
    pairs, count = collect(
        world.scenery,
        space.motions,
        world.alive,
        world.w,
        order,
        rank,
        again,
        world.speed,
        pairs,
        count,
    )
    for p in range(old, count):
        _start_drone(space, world, end, pairs[p].a)
        _start_drone(space, world, end, pairs[p].b)
    return pairs, count


@allocating
def find_pairs(
    space: Workspace, world: World, end: Swarm, order: np.ndarray
) -> tuple[np.ndarray, int]:
    """Collect the pairs of all drones that are due, and of sleepers within their reach."""
    motions = space.motions
    for i in range(order.shape[0]):
        motions[i].member = False
        put_vector(motions[i].start, vec3(world.start.position, world.w, i))
    pairs = space.pairs
    count = 0
    for rank in range(order.shape[0]):
        if motions[order[rank]].due:
            pairs, count = _collect_of(space, world, end, order, rank, False, pairs, count)
    # A sleeper that is touched is held by what it lies on, which may be another one
    grown = True
    while grown:
        grown = False
        for rank in range(order.shape[0]):
            motion = motions[order[rank]]
            if motion.begun and not motion.due and world.asleep[world.w, order[rank]]:
                motion.due = True
                pairs, count = _collect_of(space, world, end, order, rank, True, pairs, count)
                grown = True
    return pairs, count


@allocating
def _widen(
    space: Workspace, world: World, end: Swarm, order: np.ndarray, pairs: np.ndarray, count: int
) -> tuple[np.ndarray, int]:
    """Collect the pairs of drones anew that were sent farther than was looked at."""
    for rank in range(order.shape[0]):
        motion = space.motions[order[rank]]
        if not motion.member:
            continue
        here = minus(vector(motion.position), vector(motion.start))
        there = plus(here, 1.0, vector(motion.move))
        way = math.sqrt(max(dot(here, here), dot(there, there)))
        if way > motion.reach or not motion.due:
            motion.reach = max(motion.reach, 1.5 * way + SLACK)
            motion.due = True
            pairs, count = _collect_of(space, world, end, order, rank, True, pairs, count)
    return pairs, count


@func
def _turn_on(space: Workspace, world: World, pair: np.record) -> int:
    """Let those of a pair whose way ends fly on; returns how many, they are in `space.island`."""
    members = 0
    for who in (pair.a, pair.b):
        if valid_until(world.scenery, space.motions, who) <= pair.time:
            members = join(space, world, members, who, pair.time)
    add_forces(space, members, pair.time, 1.0)
    for m in range(members):
        i = space.island[m]
        aim(space.motions[i], world.dt, world.parameters[world.w, i])
    add_forces(space, members, pair.time, -1.0)
    return members


@allocating
def _fly_through(
    space: Workspace,
    world: World,
    end: Swarm,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: Touches,
) -> bool:
    """Take the drones that are due through the touches of a substep, in the order of time."""
    order = space.order
    pairs, count = find_pairs(space, world, end, order)
    if count == 0:
        return False
    return _touch(space, world, end, pairs, count, stopped, changed, touches)


@deferred(types.boolean)
@allocating
def _touch(
    space: Workspace,
    world: World,
    end: Swarm,
    pairs: np.ndarray,
    count: int,
    stopped: np.ndarray,
    changed: np.ndarray,
    touches: Touches,
) -> bool:
    """Take pairs that may touch through a substep; returns whether any does."""
    w = world.w
    motions = space.motions
    order = space.order
    for p in range(count):
        _time_pair(space, world, pairs[p], 0.0)
    eventful = False
    while True:
        first = _next_pair(pairs, count)
        if first < 0:
            break
        time = pairs[first].time
        knot = pairs[first].knot
        if knot:
            members = _turn_on(space, world, pairs[first])
        elif world.stops:
            members = halt(space, world, pairs[first], time, touches, stopped)
        else:
            members = push_apart(space, world, pairs, count, first, time, touches)
        pairs, count = _widen(space, world, end, order, pairs, count)
        for p in range(count):
            b = pairs[p].b
            if motions[pairs[p].a].member or (b < motions.shape[0] and motions[b].member):
                _time_pair(space, world, pairs[p], time)
        for m in range(members):
            i = space.island[m]
            motions[i].member = False
            changed[w, i] = changed[w, i] or not knot
        eventful = eventful or not knot
    return eventful


@kernel
def resolve(
    space: Workspace,
    world: World,
    end: Swarm,
    budget: np.ndarray,
    turns: np.ndarray,
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
        turns: (W, N) bool, drones whose turns count there; changed.
        stopped: (W, N) bool, drones that stopped; changed.
        changed: (W, N) bool, drones whose state was changed; changed.
        touches: What was touched; added to.

    Returns:
        Whether anything was touched.
    """
    w = world.w
    order = space.order
    _set_reach(space, world, end, budget)
    set_order(order, world.start.position, w)
    eventful = False
    if not are_clear(space, world, end, budget, turns):
        eventful = _fly_through(space, world, end, stopped, changed, touches)
        for i in range(changed.shape[1]):
            if changed[w, i]:
                finish(space.motions[i], end, w, i, world.parameters[w, i])
            if space.motions[i].due and world.alive[w, i]:
                budget[w, i] = free_way(world.scenery, end, turns, w, i)
    for rank in range(order.shape[0]):
        i = order[rank]
        if space.motions[i].due and world.alive[w, i]:
            share_gaps(world.scenery, end, world.alive, budget, order, w, i)
            budget[w, i] -= world.speed
    return eventful
