"""Drones that stay where they are: for too many impacts, or because they stop at a touch."""

import math

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func
from bulletuav.contact.impulses import POINT
from bulletuav.contact.island import join, touching
from bulletuav.contact.motion import MOST_IMPACTS, change_rates, is_spent, put_vector, stay, vector
from bulletuav.contact.points import Workspace, World, add_points
from bulletuav.contact.touches import Touches, tell
from bulletuav.geometry.contact_points import MAX_POINTS
from bulletuav.geometry.rotation import Vec3, dot, minus, plus

STILL = 1e-9
"""Approach below which shapes in touch do not come closer, m/s"""


@func
def end_forces(motion: np.record, time: float) -> None:
    """Let no forces act on a drone any more, but for what they would take of its speed.

    What held it up gave it the speed that gravity takes in the rest of the substep. It would be
    left with that, and heaps would never rest. Forces never speed it up, as it does not move on.
    """
    push = vector(motion.push)
    square = dot(push, push)
    against = -dot(vector(motion.velocity), push)
    if against > 0.0:
        share = min(1.0 - time, against / square)
        put_vector(motion.velocity, plus(vector(motion.velocity), share, push))
    put_vector(motion.push, (0.0, 0.0, 0.0))
    put_vector(motion.twist, (0.0, 0.0, 0.0))


@func
def carried(
    space: Workspace,
    world: World,
    pairs: np.ndarray,
    count: int,
    members: int,
    time: float,
) -> Vec3:
    """Return how far an obstacle takes an island along in a substep that touched it, m.

    Whoever stays goes along, even who has just parted from it: it comes after. Those that go along
    already take the others with them.
    """
    still = (0.0, 0.0, 0.0)
    for m in range(members):
        i = space.island[m]
        # Who stays since an impact before this one
        if space.motions[i].impacts > MOST_IMPACTS:
            way, _ = change_rates(world.scenery, space.motions, world.w, i, world.dt)
            if way != still:
                return way
    for p in range(count):
        if space.motions[pairs[p].a].member and touching(pairs[p], time):
            way, _ = change_rates(world.scenery, space.motions, world.w, pairs[p].b, world.dt)
            if pairs[p].b >= world.scenery.first_body and way != still:
                return way
    return still


@func
def let_stay(
    space: Workspace,
    members: int,
    time: float,
    way: Vec3,
) -> None:
    """Let those of an island that had too many impacts stay, or go along a way (m a substep)."""
    for m in range(members):
        motion = space.motions[space.island[m]]
        if is_spent(motion):
            stay(motion)
            put_vector(motion.move, plus((0.0, 0.0, 0.0), 1.0 - time, way))


@func
def _way_velocity(
    space: Workspace,
    world: World,
    i: int,
    arm: Vec3,
) -> Vec3:
    """Return the velocity of a drone's surface on its way, whatever the dynamics tells, m/s."""
    move, turn = change_rates(world.scenery, space.motions, world.w, i, world.dt)
    x, y, z = arm
    return (
        (move[0] + turn[1] * z - turn[2] * y) / world.dt,
        (move[1] + turn[2] * x - turn[0] * z) / world.dt,
        (move[2] + turn[0] * y - turn[1] * x) / world.dt,
    )


@deferred(types.int64)
@allocating
def halt(
    space: Workspace,
    world: World,
    pair: np.record,
    time: float,
    touches: Touches,
    stopped: np.ndarray,
) -> int:
    """Stop the drones of a pair where they touch, if they come closer.

    Returns how many drones that are; they are in `space.island`.
    """
    motions = space.motions
    w = world.w
    members = join(space, world, 0, pair.a, time)
    members = join(space, world, members, pair.b, time)
    points = np.empty(MAX_POINTS, dtype=POINT)
    if add_points(space, world, pair, time, points, 0) == 0:
        return members
    point = points[0]
    normal = vector(point.normal)
    arm = vector(point.arm_a)
    velocity = minus(_way_velocity(space, world, pair.a, arm), vector(point.drift))
    if point.b >= 0:
        velocity = minus(velocity, _way_velocity(space, world, pair.b, vector(point.arm_b)))
    tried = 0
    for m in range(members):
        motions[space.island[m]].impacts += 1
        tried = max(tried, motions[space.island[m]].impacts)
    # Who turns may come closer elsewhere, but not for ever
    if dot(velocity, normal) > -STILL and tried < MOST_IMPACTS:
        return members
    place = plus(vector(motions[pair.a].position), 1.0, arm)
    for m in range(members):
        i = space.island[m]
        moving = _way_velocity(space, world, i, (0.0, 0.0, 0.0))
        impulse = world.parameters[w, i].mass * math.sqrt(dot(moving, moving))
        other = pair.b if i == pair.a else pair.a
        sign = 1.0 if i == pair.a else -1.0
        tell(touches, w, i, other, impulse, place, normal, velocity, 0.0, sign)
    for m in range(members):
        i = space.island[m]
        stopped[w, i] = True
        motion = motions[i]
        motion.impacts = MOST_IMPACTS
        stay(motion)
        for k in range(3):
            motion.velocity[k] = 0.0
            motion.spin[k] = 0.0
            motion.push[k] = 0.0
            motion.twist[k] = 0.0
    return members
