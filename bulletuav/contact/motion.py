"""Where the drones of one world are within a substep, and how their way changes at an impact.

Times are shares of the substep, from 0 to 1. Between impacts a drone moves straight and turns about
one axis; its forces act evenly. Angular momentum, not angular velocity, is what stays without
torque.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import record_type
from bulletuav.contact.spin import momentum, rotation_between, spin_of, spun, turned
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    Vec3Like,
    dot,
    minus,
    normalise_quaternion,
    plus,
    point,
    quat4,
    to_body,
    to_world,
    vec3,
)
from bulletuav.geometry.scenery import Scenery
from bulletuav.vehicle.swarm import Swarm
from bulletuav.vehicle.wrench import free_rates

FAR_TURN = 0.5
"""Angle by which a drone turns about one axis at most, rad; then it takes another"""
MOST_IMPACTS = 16
"""Impacts of a drone in a substep, after which it stays, or goes along with an obstacle"""
SHORTEST_LEG = 1.0 / 64.0
"""Share of the substep that it flies on at least, however fast it turns"""

MOTION = record_type(
    [
        ("time", "f8"),
        ("until", "f8"),
        ("position", "f8", 3),
        ("quaternion", "f8", 4),
        ("velocity", "f8", 3),
        ("spin", "f8", 3),
        ("move", "f8", 3),
        ("turn", "f8", 3),
        ("push", "f8", 3),
        ("twist", "f8", 3),
        ("impacts", "i8"),
        ("begun", "?"),
        ("due", "?"),
        ("member", "?"),
        ("bears", "?"),
        ("load", "f8", (2, 3)),
        ("start", "f8", 3),
        ("reach", "f8"),
        ("lightness", "f8"),
        ("ease", "f8", (3, 3)),
        ("before", "f8", (2, 3)),
        ("after", "f8", (2, 3)),
        ("goal", "f8", 3),
        ("heading", "f8", 4),
        ("stray", "f8", 3),
    ]
)
"""Motion of a drone from a time within the substep to another, mostly to its end.

Attributes:
    time: Share of the substep from which on the rest holds.
    until: Share of the substep up to which it does.
    position: Centre of mass at that time, m.
    quaternion: Attitude at that time.
    velocity: At that time, m/s.
    spin: Angular velocity at that time, world axes, rad/s.
    move: Displacement from `time` to `until`, m.
    turn: Rotation from `time` to `until`, as axis times angle, world axes, rad.
    push: Change of velocity by forces over the whole substep, m/s.
    twist: Change of angular momentum by torques over the substep, world axes, N m s.
    impacts: How often the drone took part in an impact in this substep.
    begun: Whether the above is set.
    due: Whether the drone is looked at, as its budget is used up or soon will be, or it is touched.
    member: Whether it is one of those that are solved together.
    bears: Whether it sleeps, and bears who lies on it as the ground does.
    load: Impulse (N s) and angular impulse (N m s) on it of those who lie on it.
    start: Where it was at the beginning of the substep, m.
    reach: How far from there its pairs were collected, m.
    lightness: Inverse mass, 1 / kg.
    ease: Inverse inertia in world axes, 1 / (kg m^2).
    before: Velocity and spin before an impact.
    after: The same after one without rebound.
    goal: Where it gets in the substep unless it touches anything, m.
    heading: Its attitude there.
    stray: Rotation to that attitude from where `aim` alone would get, world axes, rad.
"""


@func
def vector(array: Vec3Like) -> Vec3:
    """Return an array of three numbers as a tuple."""
    return array[0], array[1], array[2]


@func
def put_vector(array: np.ndarray, values: Vec3Like) -> None:
    """Write an array of three numbers."""
    array[0] = values[0]
    array[1] = values[1]
    array[2] = values[2]


@func
def quaternion_of(motion: np.record) -> Quat4:
    """Return the attitude of a drone at its time."""
    q = motion.quaternion
    return q[0], q[1], q[2], q[3]


@func
def _put_quaternion(array: np.ndarray, values: Quat4) -> None:
    """Write an attitude."""
    for k in range(4):
        array[k] = values[k]


@func
def begin(
    motion: np.record,
    before: Swarm,
    after: Swarm,
    w: int,
    i: int,
    row: np.record,
    dt: float,
) -> None:
    """Start drone i of world w on its way through a substep in which it touches nothing.

    Args:
        motion: Row of `MOTION`, written.
        before: State at the beginning of the substep.
        after: State at its end.
        w: The world.
        i: The drone.
        row: Row of `PARAMETERS` of the drone.
        dt: Length of the substep, s.
    """
    position = vec3(before.position, w, i)
    # States that are set may be off by a millionth
    quaternion = normalise_quaternion(quat4(before.quaternion, w, i))
    later = quat4(after.quaternion, w, i)
    velocity = vec3(before.velocity, w, i)
    spin = to_world(quaternion, vec3(before.rates, w, i))
    # What torques did, and no error of the attitude: momentum would be held on as one
    gained = minus(vec3(after.rates, w, i), free_rates(vec3(before.rates, w, i), dt, row))
    motion.time = 0.0
    motion.impacts = 0
    motion.begun = True
    put_vector(motion.position, position)
    _put_quaternion(motion.quaternion, quaternion)
    put_vector(motion.velocity, velocity)
    put_vector(motion.spin, spin)
    put_vector(motion.move, plus(vec3(after.position, w, i), -1.0, position))
    put_vector(motion.turn, rotation_between(quaternion, later))
    put_vector(motion.push, plus(vec3(after.velocity, w, i), -1.0, velocity))
    put_vector(motion.twist, momentum(later, to_world(later, gained), row))
    motion.until = 1.0
    if dot(spin, spin) * dt * dt > FAR_TURN * FAR_TURN:
        put_vector(motion.goal, vec3(after.position, w, i))
        _put_quaternion(motion.heading, later)
        alone, _ = spun(quaternion, spin, dt, row)
        put_vector(motion.stray, rotation_between(alone, later))
        aim(motion, dt, row)


@func
def _share(motion: np.record, time: float) -> float:
    """Return the share of its way that a drone has gone at a time."""
    rest = motion.until - motion.time
    return (time - motion.time) / rest if rest > 0.0 else 0.0


@func
def advance_to(
    motion: np.record,
    time: float,
    row: np.record,
) -> None:
    """Move a drone on to a time within the substep."""
    share = _share(motion, time)
    elapsed = time - motion.time
    here = quaternion_of(motion)
    there = normalise_quaternion(turned(vector(motion.turn), share, here))
    spin = vector(motion.spin)
    angular = momentum(here, spin, row)
    held = spin_of(there, angular, row)
    # Its way is not quite that of a free body: energy must not grow by it
    had = dot(spin, angular)
    has = dot(held, angular)
    if has > had:
        scale = math.sqrt(had / has)
        held = (scale * held[0], scale * held[1], scale * held[2])
    twisted = spin_of(there, vector(motion.twist), row)
    put_vector(motion.position, plus(vector(motion.position), share, vector(motion.move)))
    _put_quaternion(motion.quaternion, there)
    put_vector(motion.velocity, plus(vector(motion.velocity), elapsed, vector(motion.push)))
    put_vector(motion.spin, plus(held, elapsed, twisted))
    for k in range(3):
        motion.move[k] *= 1.0 - share
        motion.turn[k] *= 1.0 - share
    motion.time = time


@func
def aim(
    motion: np.record,
    dt: float,
    row: np.record,
) -> None:
    """Let a drone fly on from its time with the velocities that it has, until it has turned far.

    Who has touched nothing goes where its dynamics took it: that is where it will be.
    """
    here = quaternion_of(motion)
    spin = vector(motion.spin)
    left = 1.0 - motion.time
    motion.until = 1.0
    angle = math.sqrt(dot(spin, spin)) * dt
    if angle > FAR_TURN:
        motion.until = min(1.0, motion.time + max(SHORTEST_LEG, FAR_TURN / angle))
    part = motion.until - motion.time
    there, turn = spun(here, spin, part * dt, row)
    way = plus((0.0, 0.0, 0.0), part * dt, vector(motion.velocity))
    if motion.impacts == 0:
        there = turned(vector(motion.stray), part, there)
        if motion.until == 1.0:
            q = motion.heading
            there = (q[0], q[1], q[2], q[3])
        turn = rotation_between(here, there)
        share = part / left if left > 0.0 else 0.0
        way = minus(vector(motion.goal), vector(motion.position))
        way = (share * way[0], share * way[1], share * way[2])
    put_vector(motion.turn, turn)
    put_vector(motion.move, way)


@func
def is_spent(motion: np.record) -> bool:
    """Tell whether a drone took part in too many impacts, so that it does not move by itself."""
    spent: bool = motion.impacts >= MOST_IMPACTS
    return spent


@func
def stay(motion: np.record) -> None:
    """Keep a drone where it is until the end of the substep; its velocities stay."""
    motion.until = 1.0
    for k in range(3):
        motion.move[k] = 0.0
        motion.turn[k] = 0.0


@func
def finish(
    motion: np.record,
    after: Swarm,
    w: int,
    i: int,
    row: np.record,
) -> None:
    """Write the state of drone i of world w at the end of the substep."""
    advance_to(motion, 1.0, row)
    quaternion = quaternion_of(motion)
    rates = to_body(quaternion, vector(motion.spin))
    for k in range(3):
        after.position[w, i, k] = motion.position[k]
        after.velocity[w, i, k] = motion.velocity[k]
        after.rates[w, i, k] = rates[k]
    for k in range(4):
        after.quaternion[w, i, k] = quaternion[k]


@func
def pose_at(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    who: int,
    time: float,
    dt: float,
) -> tuple[Vec3, Quat4]:
    """Return position and attitude of someone (number of a shape) at a time in the substep."""
    level = (0.0, 0.0, 0.0, 1.0)
    if who < scenery.first_body:
        motion = motions[who]
        share = _share(motion, time)
        position = plus(vector(motion.position), share, vector(motion.move))
        return position, turned(vector(motion.turn), share, quaternion_of(motion))
    if who < scenery.first_piece:
        k = who - scenery.first_body
        turn = quat4(scenery.quaternion, w, k)
        velocity = vec3(scenery.velocity, w, k)
        return plus(vec3(scenery.place, w, k), time * dt, velocity), turn
    if who < scenery.ground:
        return point(scenery.piece_place, who - scenery.first_piece), level
    return (0.0, 0.0, 0.0), level


@func
def valid_until(
    scenery: Scenery,
    motions: np.ndarray,
    who: int,
) -> float:
    """Return the share of the substep up to which the way of someone is known."""
    return motions[who].until if who < scenery.first_body else 1.0


@func
def change_rates(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    who: int,
    dt: float,
) -> tuple[Vec3, Vec3]:
    """Return displacement and rotation of someone on its way, per whole substep."""
    still = (0.0, 0.0, 0.0)
    if who < scenery.first_body:
        motion = motions[who]
        rest = motion.until - motion.time
        scale = 1.0 / rest if rest > 0.0 else 0.0
        return plus(still, scale, vector(motion.move)), plus(still, scale, vector(motion.turn))
    if who < scenery.first_piece:
        velocity = vec3(scenery.velocity, w, who - scenery.first_body)
        return plus(still, dt, velocity), still
    return still, still
