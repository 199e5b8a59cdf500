"""Impacts: how drones that touch at one time push each other and what stands."""

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.contact.foresight import foresee
from bulletuav.contact.gain import frame_of, keep, lose_gain, moving_energy, remember_before, reopen
from bulletuav.contact.impulses import POINT, eased
from bulletuav.contact.island import gather, in_island, touching
from bulletuav.contact.memory import note, recall
from bulletuav.contact.motion import aim, is_spent, vector
from bulletuav.contact.points import (
    LIFT,
    MIDDLE,
    Workspace,
    World,
    add_points,
    measure,
)
from bulletuav.contact.relax import (
    FIRM,
    FIRM_ENOUGH,
    FIRM_IN_HEAPS,
    FROM_BEFORE,
    FROM_MEMORY,
    FROM_NOTHING,
    damp_tipping,
    relax,
)
from bulletuav.contact.staying import STILL, carried, end_forces, let_stay
from bulletuav.contact.touch import IN_TOUCH, TOUCH
from bulletuav.contact.touches import Touches, tell
from bulletuav.geometry.contact_points import MAX_POINTS
from bulletuav.geometry.rotation import cross, plus

SLOW = 0.02
"""Approach below which nothing rebounds, m/s"""
CLOSING = 1e-6
"""Approach below which what touches needs no impact of its own, m/s"""
FORESIGHT = 4
"""How often an impact looks what its pairs will touch with at the end of the substep"""
SHORTEST = 1e-6
"""Rest of a substep below which nothing is foreseen, s"""
FREE = -1e9
"""Velocity that a point may have which does not count, m/s"""


@func
def _rebounds(point: np.record) -> bool:
    """Tell whether a point is in touch and closes fast enough to rebound."""
    found: bool = point.distance <= IN_TOUCH and point.approach < -SLOW
    return found


@func
def _rebound(
    space: Workspace,
    world: World,
    members: int,
    points: np.ndarray,
    size: int,
) -> bool:
    """Let what closes fast rebound (Newton), without a gain of energy, and stop what is slow.

    What closes fast and does not rebound is left to `_hold`: forces of this substep belong to the
    velocity before.

    Returns:
        Whether all that is in touch is slow.
    """
    lively = False
    closes = False
    slow = True
    for k in range(size):
        point = points[k]
        point.least = FREE
        if point.distance > IN_TOUCH:
            continue
        point.least = 0.0
        closes = closes or point.approach < -CLOSING
        if _rebounds(point):
            slow = False
            lively = lively or point.restitution > 0.0
            point.least = -point.restitution * point.approach
    if lively:
        frame = frame_of(points, size)
        had = moving_energy(space, world, members, frame, 0.0)
        remember_before(space, members, points, size)
        relax(points, size, space.motions, world.dt, FIRM, FROM_NOTHING)
        keep(points, size)
        lose_gain(space, world, members, points, size, frame, had, 0.0)
    elif closes and slow:
        # What is only stopped gains no energy
        relax(points, size, space.motions, world.dt, FIRM_ENOUGH, FROM_NOTHING)
        keep(points, size)
    return slow


@func
def _allow(
    pairs: np.ndarray,
    points: np.ndarray,
    size: int,
    dt: float,
) -> None:
    """Set how fast the points of contact may close, or have to part.

    What is allowed to a pair is linear in the distances, as its motion is: it can reach it at all
    of its points, however many they are. From a sleeper nobody has to part unless they overlap:
    who is wedged between two could not.
    """
    k = 0
    while k < size:
        end = k
        deepest = 0.0
        while end < size and points[end].pair == points[k].pair:
            deepest = max(deepest, MIDDLE - points[end].distance)
            end += 1
        rate = 1.0 / max(dt, deepest / LIFT)
        for m in range(k, end):
            point = points[m]
            point.least = rate * (MIDDLE - point.distance)
            if pairs[point.pair].leans and deepest <= MIDDLE:
                point.least = min(0.0, point.least)
            # What rebounds when it arrives is left to its own impact
            if point.distance > IN_TOUCH and point.restitution > 0.0 and point.approach < -SLOW:
                point.least = FREE
        k = end


@func
def add_forces(
    space: Workspace,
    members: int,
    time: float,
    sign: float,
) -> None:
    """Add what forces do to the velocities of an island in the rest of the substep, or take it."""
    rest = sign * (1.0 - time)
    for m in range(members):
        motion = space.motions[space.island[m]]
        spun = eased(motion, vector(motion.twist))
        for k in range(3):
            motion.velocity[k] += rest * motion.push[k]
            motion.spin[k] += rest * spun[k]


@func
def _take_mean(
    motion: np.record,
    time: float,
    dt: float,
) -> None:
    """Let a drone fly on with the mean of its velocities at the beginning and the end.

    `aim` takes that at the end, which is 1 % too far in a slide that begins.
    """
    rest = 1.0 - time
    share = (motion.until - time) / rest if rest > 0.0 else 0.0
    for k in range(3):
        began = motion.before[0, k] - rest * motion.push[k]
        mean = began + 0.5 * share * (motion.velocity[k] - began)
        motion.move[k] = (motion.until - time) * dt * mean


@func
def _hold(
    space: Workspace,
    world: World,
    pairs: np.ndarray,
    count: int,
    members: int,
    points: np.ndarray,
    size: int,
    time: float,
    slow: bool,
) -> int:
    """Let contacts hold against forces for the rest of the substep, and what closes stop.

    Where all is slow and something bears them they fly on with the mean of velocities before and
    after, as forces act all the way. In free fall nothing does, and to move by another velocity
    than they have would change their angular momentum.

    What would touch at the end of the substep gets points, too, which share what others hold.

    Returns the number of points, those that were foreseen among them.
    """
    motions = space.motions
    _allow(pairs, points, size, world.dt)
    frame = frame_of(points, size)
    had = moving_energy(space, world, members, frame, LIFT)
    add_forces(space, members, time, 1.0)
    remember_before(space, members, points, size)
    memory = world.memory
    radii = world.scenery.table.radius
    firm = FIRM_ENOUGH if members == 1 else FIRM_IN_HEAPS
    alone = members == 1
    held = False
    for p in range(count):
        alone = alone and not (pairs[p].joins and pairs[p].leans)
        bears = pairs[p].leans or pairs[p].b >= motions.shape[0]
        held = held or (pairs[p].joins and bears)
    for trial in range(FORESIGHT + 1):
        if trial == 0:
            recall(memory, motions, radii, world.w, points, pairs, size, 1.0 - time)
            relax(points, size, motions, world.dt, firm, FROM_MEMORY)
            island = space.island
            note(memory, motions, world.w, island, members, points, pairs, size, 1.0 - time)
            keep(points, size)
            if damp_tipping(points, size, motions):
                relax(points, size, motions, world.dt, firm, FROM_NOTHING)
                keep(points, size)
        else:
            # Who is fast and alone flies on before it would rock
            shares = slow or members > 1
            if shares:
                reopen(points, size)
            relax(points, size, motions, world.dt, firm, FROM_BEFORE if shares else FROM_NOTHING)
            keep(points, size)
            lose_gain(space, world, members, points, size, frame, had, 1.0 - time)
        for m in range(members):
            i = space.island[m]
            motion = motions[i]
            aim(motion, world.dt, world.parameters[world.w, i])
            # At a later impact of a heap velocities before are what holds it, and no way it goes
            if held and slow and trial == 0 and (alone or motion.impacts == 1):
                _take_mean(motion, time, world.dt)
        before = size
        if trial < FORESIGHT and (1.0 - time) * world.dt > SHORTEST:
            for p in range(count):
                if pairs[p].joins and foresee(space, world, pairs[p], time, points[size]):
                    points[size].pair = p
                    size += 1
        if size == before:
            break
    # Back to velocities at the time of the impact: forces are added on the way
    add_forces(space, members, time, -1.0)
    return size


@func
def _tell_point(
    touches: Touches,
    space: Workspace,
    w: int,
    point: np.record,
    other: int,
) -> None:
    """Tell a point of contact, for both sides if both are drones."""
    place = plus(vector(space.motions[point.a].position), 1.0, vector(point.arm_a))
    normal, velocity = vector(point.normal), vector(point.slip)
    tell(touches, w, point.a, other, point.total[0], place, normal, velocity, 0.0, 1.0)
    # Also who sleeps and bears it
    if other < space.motions.shape[0]:
        tell(touches, w, other, point.a, point.total[0], place, normal, velocity, 0.0, -1.0)


@func
def _load(motion: np.record, point: np.record) -> None:
    """Add the impulse of a point to what a sleeper bears."""
    normal = vector(point.normal)
    pressed = plus((0.0, 0.0, 0.0), -point.total[0], normal)
    pressed = plus(pressed, -point.total[1], vector(point.tangent[0]))
    pressed = plus(pressed, -point.total[2], vector(point.tangent[1]))
    turned = cross(vector(point.arm_b), pressed)
    for k in range(3):
        motion.load[0, k] += pressed[k]
        motion.load[1, k] += turned[k]


@deferred(types.int64)
@allocating
def push_apart(
    space: Workspace,
    world: World,
    pairs: np.ndarray,
    count: int,
    first: int,
    time: float,
    touches: Touches,
) -> int:
    """Push apart all who hang together with a pair at the time of its touch.

    Returns how many drones that are; they are in `space.island`, and fly on with new velocities.
    """
    motions = space.motions
    members = gather(space, world, pairs, count, first, time)
    # A drone that took part in too many impacts does not move by itself until the next substep
    stays = False
    for m in range(members):
        motion = motions[space.island[m]]
        motion.impacts += 1
        if is_spent(motion):
            end_forces(motion, time)
            stays = True
    way = (0.0, 0.0, 0.0)
    if stays:
        way = carried(space, world, pairs, count, members, time)
    # Points of all pairs of the island that are in touch
    most = 0
    for p in range(count):
        pairs[p].joins = in_island(motions, pairs[p]) and touching(pairs[p], time)
        if pairs[p].joins:
            most += MAX_POINTS + FORESIGHT
    points = np.empty(most, dtype=POINT)
    size = 0
    for p in range(count):
        more = size
        if pairs[p].joins:
            more = add_points(space, world, pairs[p], time, points, size)
        for k in range(size, more):
            points[k].pair = p
        pairs[p].joins = more > size
        size = more
    slow = _rebound(space, world, members, points, size)
    size = _hold(space, world, pairs, count, members, points, size, time, slow)
    for k in range(size):
        # Who parts was near, but touches nothing
        if points[k].total[0] <= 0.0 and points[k].approach >= -STILL:
            continue
        other = pairs[points[k].pair].b
        _tell_point(touches, space, world.w, points[k], other)
        if other < motions.shape[0] and motions[other].bears:
            _load(motions[other], points[k])
    let_stay(space, members, time, way)
    return members


@kernel
def tell_pair(
    space: Workspace,
    world: World,
    pair: np.record,
    touches: Touches,
) -> None:
    """Tell a pair that is in touch at the beginning of a substep, without an impulse."""
    distance, normal, on_a, _ = measure(space, world, pair, 0.0)
    if distance > TOUCH:
        return
    place = plus(vector(space.motions[pair.a].position), 1.0, on_a)
    still = (0.0, 0.0, 0.0)
    depth = max(0.0, -distance)
    tell(touches, world.w, pair.a, pair.b, 0.0, place, normal, still, depth, 1.0)
    if pair.b < world.scenery.first_body:
        tell(touches, world.w, pair.b, pair.a, 0.0, place, normal, still, depth, -1.0)
