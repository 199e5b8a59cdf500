"""Impacts: who hangs together at a touch, and how they push each other apart."""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.contact.impulses import POINT, ease_of, energy, keep, prepare, relax, slip, vector
from bulletuav.contact.motion import (
    Motions,
    advance_to,
    aim,
    along,
    change_rates,
    make_motions,
    pose_at,
    stay,
)
from bulletuav.contact.pairs import Pairs
from bulletuav.contact.touch import TOUCH, gap_at, separation_along
from bulletuav.contact.touches import Touches, tell
from bulletuav.geometry.contact_points import MOST_POINTS, contact_points
from bulletuav.geometry.gjk import make_room
from bulletuav.geometry.rotation import Vec3, axes, dot, minus, point, to_body, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HALF_SPACE
from bulletuav.kernel import func, kernel
from bulletuav.vehicle.swarm import Swarm

MOST_IMPACTS = 16
"""Impacts of a drone in a substep, after which it stays where it is until the next"""
SLOW = 0.02
"""Approach below which nothing rebounds, m/s"""
STILL = 1e-9
"""Approach below which shapes in touch do not come closer, m/s"""
MIDDLE = 0.5 * TOUCH
"""Distance that a touch leaves, m"""
LIFT = 2e-3
"""Fastest that shapes which are too close are moved apart, m/s"""
NEARBY = 5 * TOUCH
"""Points of a pair in touch that are farther apart play no part, m"""
FORESIGHT = 4
"""How often an impact looks what its pairs will touch with at the end of the substep"""
SHORTEST = 1e-6
"""Rest of a substep below which nothing is foreseen, s"""
SLIP = 2e-6
"""How much closer shapes may come that are too close already, m"""
TRUSTED = 5e-4
"""Depth of an overlap up to which its direction is that of the contact, m"""


class Workspace(NamedTuple):
    """Arrays that a substep of one world works on.

    Attributes:
        motions: How the drones move.
        begun: (N,) bool, drones whose motion is set.
        due: (N,) bool, drones whose budget is used up.
        reach: (N,) how far from its start a drone's pairs were collected, m.
        island: (N,) drones that are solved together.
        member: (N,) bool, the same.
        ease: (N, 3, 3) inverse inertias in world axes, 1 / (kg m^2).
        lightness: (N,) inverse masses, 1 / kg.
        before: (2, N, 3) velocities and spins before an impact.
        after: (2, N, 3) the same after one without rebound.
        room: Scratch of `gap`.
        found: Scratch of `contact_points`.
    """

    motions: Motions
    begun: np.ndarray
    due: np.ndarray
    reach: np.ndarray
    island: np.ndarray
    member: np.ndarray
    ease: np.ndarray
    lightness: np.ndarray
    before: np.ndarray
    after: np.ndarray
    room: np.ndarray
    found: np.ndarray


def make_workspace(num_drones: int) -> Workspace:
    """Make room for the substep of a world of N drones."""
    return Workspace(
        motions=make_motions(num_drones),
        begun=np.zeros(num_drones, dtype=bool),
        due=np.zeros(num_drones, dtype=bool),
        reach=np.zeros(num_drones),
        island=np.zeros(num_drones, dtype=np.int64),
        member=np.zeros(num_drones, dtype=bool),
        ease=np.zeros((num_drones, 3, 3)),
        lightness=np.zeros(num_drones),
        before=np.zeros((2, num_drones, 3)),
        after=np.zeros((2, num_drones, 3)),
        room=make_room(),
        found=np.zeros((MOST_POINTS, 4)),
    )


class World(NamedTuple):
    """One world in a substep.

    Attributes:
        w: Its index.
        dt: Length of the substep, s.
        speed: How far the fastest obstacle gets in the substep, m.
        friction: Coefficient of friction of the ground and of buildings.
        restitution: Their coefficient of restitution.
        scenery: What stands.
        start: State of all drones at the beginning.
        alive: (W, N) bool, drones that can be touched.
        parameters: (W, N) rows of `PARAMETERS`.
    """

    w: int
    dt: float
    speed: float
    friction: float
    restitution: float
    scenery: Scenery
    start: Swarm
    alive: np.ndarray
    parameters: np.ndarray


@func
def _join(space: Workspace, world: World, members: int, i: int, time: float) -> int:
    """Bring a drone to the time of an impact, as one of its island; returns how many there are."""
    if i >= world.scenery.first_body or space.member[i]:
        return members
    row = world.parameters[world.w, i]
    space.member[i] = True
    space.island[members] = i
    advance_to(space.motions, i, time, row)
    ease_of(space.motions, i, row, space.ease)
    space.lightness[i] = 1.0 / row.mass
    return members + 1


@func
def _touching(pairs: Pairs, p: int, time: float) -> bool:
    """Tell whether a pair may be in touch at a time."""
    return pairs.held[p] or pairs.time[p] <= time


@kernel
def _gather(
    space: Workspace, world: World, pairs: Pairs, count: int, first: int, time: float
) -> int:
    """Find all drones that hang together with a pair at the time of its touch.

    Returns their number; they are in `space.island`.
    """
    members = _join(space, world, 0, pairs.who[first, 0], time)
    members = _join(space, world, members, pairs.who[first, 1], time)
    grown = True
    while grown:
        grown = False
        for p in range(count):
            a = pairs.who[p, 0]
            b = pairs.who[p, 1]
            if b >= world.scenery.first_body or space.member[a] == space.member[b]:
                continue
            if _touching(pairs, p, time):
                distance, normal, _, _ = gap_at(
                    world.scenery,
                    space.motions,
                    world.w,
                    a,
                    b,
                    time,
                    world.dt,
                    point(pairs.normal, p),
                    space.room,
                )
                for k in range(3):
                    pairs.normal[p, k] = normal[k]
                if distance <= 1.01 * TOUCH:
                    members = _join(space, world, members, a, time)
                    members = _join(space, world, members, b, time)
                    grown = True
    return members


@func
def _drift(space: Workspace, world: World, b: int) -> Vec3:
    """Return the velocity of what does not yield, m/s."""
    if b >= world.scenery.first_body:
        move, _ = change_rates(world.scenery, space.motions, world.w, b, world.dt)
        return move[0] / world.dt, move[1] / world.dt, move[2] / world.dt
    return 0.0, 0.0, 0.0


@func
def _surface(world: World, who: int) -> tuple[float, float]:
    """Return the coefficients of friction and restitution of someone."""
    scenery = world.scenery
    if who < scenery.first_body:
        row = world.parameters[world.w, who]
        return row.friction, row.restitution
    if who < scenery.first_piece:
        k = who - scenery.first_body
        return scenery.friction[k], scenery.restitution[k]
    return world.friction, world.restitution


@func
def _fill_point(space: Workspace, world: World, row: np.record, a: int, b: int) -> None:
    """Fill in whose a point of contact is, its surfaces and masses; normal and arms are there."""
    row.a = a
    row.b = b if b < world.scenery.first_body else -1
    drift = _drift(space, world, b)
    for k in range(3):
        row.drift[k] = drift[k]
    # Of two surfaces the geometric mean counts
    rough, lively = _surface(world, a)
    rough_b, lively_b = _surface(world, b)
    row.friction = math.sqrt(rough * rough_b)
    row.restitution = math.sqrt(lively * lively_b)
    prepare(row, space.ease, space.lightness)


@kernel
def _add_points(
    space: Workspace,
    world: World,
    pairs: Pairs,
    p: int,
    time: float,
    points: np.ndarray,
    size: int,
) -> int:
    """Add the points of contact of a pair in touch; returns how many there are now."""
    a = pairs.who[p, 0]
    b = pairs.who[p, 1]
    scenery = world.scenery
    position_a, quaternion_a = pose_at(scenery, space.motions, world.w, a, time, world.dt)
    position_b, quaternion_b = pose_at(scenery, space.motions, world.w, b, time, world.dt)
    offset = minus(position_b, position_a)
    distance, normal, on_a, on_b = gap_at(
        scenery,
        space.motions,
        world.w,
        a,
        b,
        time,
        world.dt,
        point(pairs.normal, p),
        space.room,
    )
    if distance > 1.01 * TOUCH:
        return size
    # From now on it counts as a touch anew only when it gets closer than now
    pairs.held[p] = True
    if distance > 1e-6:
        pairs.floor[p] = 0.25 * min(distance, TOUCH)
    else:
        pairs.floor[p] = distance - SLIP
    found = contact_points(
        scenery.table,
        a,
        axes(quaternion_a),
        b,
        axes(quaternion_b),
        offset,
        normal,
        on_a,
        on_b,
        NEARBY,
        space.found,
        space.room,
    )
    for m in range(found):
        row = points[size + m]
        for k in range(3):
            row.normal[k] = normal[k]
            row.arm_a[k] = space.found[m, k]
            row.arm_b[k] = space.found[m, k] - offset[k]
        _fill_point(space, world, row, a, b)
        row.distance = space.found[m, 3]
        row.approach = dot(slip(row, space.motions.velocity, space.motions.spin), normal)
    return size + found


@kernel
def _rebound(space: Workspace, world: World, members: int, points: np.ndarray, size: int) -> None:
    """Let the impact act: velocities at its time change, with what restitution there is.

    First all that closes is stopped, then rebounds (Newton). What would gain energy that way, as
    friction allows, is a mean of both that gains none.
    """
    motions = space.motions
    rebounds = False
    for k in range(size):
        row = points[k]
        closes = row.distance <= 1.01 * TOUCH and row.approach < -SLOW
        rebounds = rebounds or (closes and row.restitution > 0.0)
    if not rebounds:
        return
    frame = (0.0, 0.0, 0.0)
    for k in range(size):
        row = points[k]
        row.least = -1e9 if row.distance > 1.01 * TOUCH else 0.0
        if row.b < 0 and dot(frame, frame) == 0.0:
            frame = (row.drift[0], row.drift[1], row.drift[2])
    for m in range(members):
        i = space.island[m]
        for k in range(3):
            space.before[0, i, k] = motions.velocity[i, k]
            space.before[1, i, k] = motions.spin[i, k]
    # Without rebound
    relax(points, size, motions.velocity, motions.spin, space.ease, space.lightness)
    for m in range(members):
        i = space.island[m]
        for k in range(3):
            space.after[0, i, k] = motions.velocity[i, k]
            space.after[1, i, k] = motions.spin[i, k]
            motions.velocity[i, k] = space.before[0, i, k]
            motions.spin[i, k] = space.before[1, i, k]
    for k in range(size):
        points[k].total[:] = points[k].impulse
        row = points[k]
        if row.distance <= 1.01 * TOUCH and row.approach < -SLOW:
            row.least = -row.restitution * row.approach
    # With rebound, from the beginning
    relax(points, size, motions.velocity, motions.spin, space.ease, space.lightness)
    share = _lossless_share(space, world, members, frame)
    for m in range(members):
        i = space.island[m]
        for k in range(3):
            calm = space.after[0, i, k]
            motions.velocity[i, k] = calm + share * (motions.velocity[i, k] - calm)
            calm = space.after[1, i, k]
            motions.spin[i, k] = calm + share * (motions.spin[i, k] - calm)
    for k in range(size):
        row = points[k]
        for m in range(3):
            calm = row.total[m]
            row.total[m] = calm + share * (row.impulse[m] - calm)


@func
def _lossless_share(space: Workspace, world: World, members: int, frame: Vec3) -> float:
    """Return how much of a rebound may act, 0 to 1, without a gain of energy.

    Energy is a parabola over that share: it is known from its values at 0, 1/2 and 1.
    """
    motions = space.motions
    w = world.w
    rows = world.parameters
    had = energy(space.island, members, space.before[0], space.before[1], frame, motions, rows, w)
    full = energy(space.island, members, motions.velocity, motions.spin, frame, motions, rows, w)
    if full <= had:
        return 1.0
    calm = energy(space.island, members, space.after[0], space.after[1], frame, motions, rows, w)
    for m in range(members):
        i = space.island[m]
        for k in range(3):
            space.before[0, i, k] = 0.5 * (space.after[0, i, k] + motions.velocity[i, k])
            space.before[1, i, k] = 0.5 * (space.after[1, i, k] + motions.spin[i, k])
    half = energy(space.island, members, space.before[0], space.before[1], frame, motions, rows, w)
    # calm + linear s + square s^2 = had
    square = 2.0 * (full + calm) - 4.0 * half
    linear = full - calm - square
    left = had - calm
    if left <= 0.0 or square <= 0.0:
        return 0.0
    root = math.sqrt(linear * linear + 4.0 * square * left)
    return min(1.0, max(0.0, 2.0 * left / (linear + root)))


@kernel
def _allow(points: np.ndarray, size: int, dt: float) -> None:
    """Set how fast the points of contact may close, or have to part."""
    for k in range(size):
        row = points[k]
        missing = row.distance - MIDDLE
        if missing > 0.0:
            row.least = -missing / dt
        else:
            row.least = min(LIFT, -0.1 * missing / dt)
        # What rebounds when it arrives is left to its own impact
        if row.distance > 1.01 * TOUCH and row.restitution > 0.0 and row.approach < -SLOW:
            row.least = -1e9


@kernel
def _add_forces(space: Workspace, members: int, time: float, sign: float) -> None:
    """Add what forces do to the velocities of an island in the rest of the substep, or take it."""
    motions = space.motions
    rest = sign * (1.0 - time)
    for m in range(members):
        i = space.island[m]
        for k in range(3):
            spun = 0.0
            for n in range(3):
                spun += space.ease[i, k, n] * motions.twist[i, n]
            motions.velocity[i, k] += rest * motions.push[i, k]
            motions.spin[i, k] += rest * spun


@func
def _as_now(
    scenery: Scenery, motions: Motions, w: int, who: int, time: float, dt: float, arm: Vec3
) -> Vec3:
    """Return where a point of someone is now that is at `arm` at the end of the substep, m."""
    position, before = pose_at(scenery, motions, w, who, time, dt)
    _, after = pose_at(scenery, motions, w, who, 1.0, dt)
    return along(position, 1.0, to_world(before, to_body(after, arm)))


@kernel
def _foresee(
    space: Workspace,
    world: World,
    pairs: Pairs,
    p: int,
    time: float,
    points: np.ndarray,
    size: int,
) -> int:
    """Add the point at which a pair would be too close at the end of the substep, if there is one.

    Velocities are those at the end, and `aim` was called. Of a pair that turns, other points than
    those of now may come together: without them it would sink, and take many impacts to stop.

    Returns:
        The number of points.
    """
    a = pairs.who[p, 0]
    b = pairs.who[p, 1]
    scenery = world.scenery
    motions = space.motions
    w = world.w
    dt = world.dt
    normal = point(pairs.normal, p)
    now, _, _ = separation_along(scenery, motions, w, a, b, time, dt, normal)
    later, on_a, on_b = separation_along(scenery, motions, w, a, b, 1.0, dt, normal)
    wanted = min(now, MIDDLE)
    enough = 0.5 * wanted if wanted > 0.0 else wanted - SLIP
    if later >= enough:
        return size
    if scenery.table.kind[b] != HALF_SPACE:
        # They may pass each other, for example over an edge
        later, new, on_a, on_b = gap_at(scenery, motions, w, a, b, 1.0, dt, normal, space.room)
        if later >= enough:
            return size
        # The direction of a deep overlap misleads: keep that of the touch
        if later > -TRUSTED:
            normal = new
    place = _as_now(scenery, motions, w, a, time, dt, on_a)
    position_b, _ = pose_at(scenery, motions, w, b, time, dt)
    if b < scenery.first_body:
        other = _as_now(scenery, motions, w, b, time, dt, on_b)
        place = along(place, 0.5, minus(other, place))
    row = points[size]
    for k in range(3):
        row.normal[k] = normal[k]
        row.arm_a[k] = place[k] - motions.position[a, k]
        row.arm_b[k] = place[k] - position_b[k]
    _fill_point(space, world, row, a, b)
    closing = dot(slip(row, motions.velocity, motions.spin), normal)
    row.distance = now
    row.approach = 0.0
    row.least = closing + (wanted - later) / ((1.0 - time) * dt)
    return size + 1


@kernel
def _hold(
    space: Workspace,
    world: World,
    pairs: Pairs,
    active: np.ndarray,
    members: int,
    points: np.ndarray,
    owner: np.ndarray,
    size: int,
    time: float,
) -> int:
    """Let contacts hold against forces for the rest of the substep, and what closes stop.

    Returns the number of points, those that were foreseen among them.
    """
    motions = space.motions
    _allow(points, size, world.dt)
    _add_forces(space, members, time, 1.0)
    for trial in range(FORESIGHT + 1):
        relax(points, size, motions.velocity, motions.spin, space.ease, space.lightness)
        keep(points, size)
        for m in range(members):
            i = space.island[m]
            aim(motions, i, world.dt, world.parameters[world.w, i])
        before = size
        if trial < FORESIGHT and (1.0 - time) * world.dt > SHORTEST:
            for k in range(active.shape[0]):
                more = _foresee(space, world, pairs, active[k], time, points, size)
                owner[size:more] = active[k]
                size = more
        if size == before:
            break
    # Back to velocities at the time of the impact: forces are added on the way
    _add_forces(space, members, time, -1.0)
    return size


@func
def _tell_point(
    touches: Touches,
    space: Workspace,
    w: int,
    row: np.record,
    other: int,
    velocity: Vec3,
) -> None:
    """Tell a point of contact, for both sides if both are drones."""
    place = along(point(space.motions.position, row.a), 1.0, vector(row.arm_a))
    normal = vector(row.normal)
    tell(touches, w, row.a, other, row.total[0], place, normal, velocity, 1.0)
    if row.b >= 0:
        tell(touches, w, row.b, row.a, row.total[0], place, normal, velocity, -1.0)


@kernel
def push_apart(
    space: Workspace,
    world: World,
    pairs: Pairs,
    count: int,
    first: int,
    time: float,
    touches: Touches,
) -> int:
    """Push apart all who hang together with a pair at the time of its touch.

    Returns how many drones that are; they are in `space.island`, and fly on with new velocities.
    """
    members = _gather(space, world, pairs, count, first, time)
    # A drone that took part in too many impacts stays: time does not go on for it
    for m in range(members):
        i = space.island[m]
        space.motions.impacts[i] += 1
        if space.motions.impacts[i] >= MOST_IMPACTS:
            for k in range(3):
                space.motions.push[i, k] = 0.0
                space.motions.twist[i, k] = 0.0
    # Points of all pairs of the island that are in touch
    active = np.empty(count, dtype=np.int64)
    touching = 0
    for p in range(count):
        if space.member[pairs.who[p, 0]] and _touching(pairs, p, time):
            active[touching] = p
            touching += 1
    active = active[:touching]
    points = np.zeros(touching * (MOST_POINTS + FORESIGHT), dtype=POINT)
    owner = np.empty(points.shape[0], dtype=np.int64)
    size = 0
    given = 0
    for k in range(touching):
        more = _add_points(space, world, pairs, active[k], time, points, size)
        owner[size:more] = active[k]
        if more > size:
            active[given] = active[k]
            given += 1
        size = more
    active = active[:given]
    # Velocities before, of which the first point of a pair is told
    slips = np.zeros((points.shape[0], 3))
    for k in range(size):
        moving = slip(points[k], space.motions.velocity, space.motions.spin)
        for m in range(3):
            slips[k, m] = moving[m]
    _rebound(space, world, members, points, size)
    size = _hold(space, world, pairs, active, members, points, owner, size, time)
    for k in range(size):
        p = owner[k]
        _tell_point(touches, space, world.w, points[k], pairs.who[p, 1], point(slips, k))
    for m in range(members):
        i = space.island[m]
        if space.motions.impacts[i] >= MOST_IMPACTS:
            stay(space.motions, i)
    return members


@kernel
def tell_pair(space: Workspace, world: World, pairs: Pairs, p: int, touches: Touches) -> None:
    """Tell a pair that is in touch at the beginning of a substep, without an impulse."""
    a = pairs.who[p, 0]
    b = pairs.who[p, 1]
    motions = space.motions
    w = world.w
    guess = point(pairs.normal, p)
    distance, normal, on_a, _ = gap_at(
        world.scenery, motions, w, a, b, 0.0, world.dt, guess, space.room
    )
    if distance > TOUCH:
        return
    place = along(point(motions.position, a), 1.0, on_a)
    still = (0.0, 0.0, 0.0)
    tell(touches, w, a, b, 0.0, place, normal, still, 1.0)
    if b < world.scenery.first_body:
        tell(touches, w, b, a, 0.0, place, normal, still, -1.0)


@kernel
def halt(
    space: Workspace,
    world: World,
    pairs: Pairs,
    p: int,
    time: float,
    touches: Touches,
    stopped: np.ndarray,
) -> int:
    """Stop the drones of a pair where they touch, if they come closer.

    Returns how many drones that are; they are in `space.island`.
    """
    motions = space.motions
    w = world.w
    members = _join(space, world, 0, pairs.who[p, 0], time)
    members = _join(space, world, members, pairs.who[p, 1], time)
    points = np.zeros(MOST_POINTS, dtype=POINT)
    if _add_points(space, world, pairs, p, time, points, 0) == 0:
        return members
    # Velocities of the way count, which need not be those that the dynamics tells
    for m in range(members):
        i = space.island[m]
        move, turn = change_rates(world.scenery, motions, w, i, world.dt)
        for k in range(3):
            motions.velocity[i, k] = move[k] / world.dt
            motions.spin[i, k] = turn[k] / world.dt
    row = points[0]
    velocity = slip(row, motions.velocity, motions.spin)
    normal = vector(row.normal)
    if dot(velocity, normal) > -STILL:
        return members
    place = along(point(motions.position, row.a), 1.0, vector(row.arm_a))
    for m in range(members):
        i = space.island[m]
        speed = motions.velocity[i, 0] ** 2 + motions.velocity[i, 1] ** 2
        speed = math.sqrt(speed + motions.velocity[i, 2] ** 2)
        impulse = world.parameters[w, i].mass * speed
        other = pairs.who[p, 1] if m == 0 else pairs.who[p, 0]
        tell(touches, w, i, other, impulse, place, normal, velocity, 1.0 if m == 0 else -1.0)
    for m in range(members):
        i = space.island[m]
        stopped[w, i] = True
        stay(motions, i)
        for k in range(3):
            motions.velocity[i, k] = 0.0
            motions.spin[i, k] = 0.0
            motions.push[i, k] = 0.0
            motions.twist[i, k] = 0.0
    return members
