"""Where the drones of one world are within a substep, and how their way changes at an impact.

Times are shares of the substep, from 0 to 1. Between impacts a drone moves straight and turns about
one axis; its forces act evenly. Angular momentum, not angular velocity, is what stays without
torque.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.compiled.plain import record_type
from bulletuav.contact.spin import (
    compute_angular_momentum,
    compute_angular_velocity,
    compute_rotation_between,
    integrate_free_rotation,
    rotate_by_fraction,
)
from bulletuav.geometry.rotation import (
    Quat4,
    Vec3,
    Vec3Like,
    dot,
    minus,
    normalised,
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

MAX_SEGMENT_ANGLE = 0.5
"""Angle by which a drone turns about one axis at most, rad; then it takes another"""
MAX_IMPACTS = 16
"""Impacts of a drone in a substep, after which it stays, or goes along with an obstacle"""
MIN_SEGMENT_FRACTION = 1.0 / 64.0
"""Share of the substep that it flies on at least, however fast it turns"""

MOTION = record_type(
    [
        ("time", "f8"),
        ("end_time", "f8"),
        ("position", "f8", 3),
        ("quaternion", "f8", 4),
        ("velocity", "f8", 3),
        ("spin", "f8", 3),
        ("displacement", "f8", 3),
        ("rotation", "f8", 3),
        ("velocity_change", "f8", 3),
        ("momentum_change", "f8", 3),
        ("impacts", "i8"),
        ("is_started", "?"),
        ("is_due", "?"),
        ("in_island", "?"),
        ("is_static", "?"),
        ("load", "f8", (2, 3)),
        ("start_position", "f8", 3),
        ("reach", "f8"),
        ("inverse_mass", "f8"),
        ("inverse_inertia", "f8", (3, 3)),
        ("saved_velocities", "f8", (2, 3)),
        ("unlimited_velocities", "f8", (2, 3)),
        ("free_position", "f8", 3),
        ("free_quaternion", "f8", 4),
        ("free_rotation_offset", "f8", 3),
    ]
)
"""Motion of a drone from a time within the substep to another, mostly to its end.

Attributes:
    time: Share of the substep from which on the rest holds.
    end_time: Share of the substep up to which it does.
    position: Centre of mass at that time, m.
    quaternion: Attitude at that time.
    velocity: At that time, m/s.
    spin: Angular velocity at that time, world axes, rad/s.
    displacement: Displacement from `time` to `until`, m.
    rotation: Rotation from `time` to `until`, as axis times angle, world axes, rad.
    velocity_change: Change of velocity by forces over the whole substep, m/s.
    momentum_change: Change of angular momentum by torques over the substep, world axes, N m s.
    impacts: How often the drone took part in an impact in this substep.
    is_started: Whether the above is set.
    is_due: Whether the drone is looked at, as its budget is used up or soon will be, or it is touched.
    in_island: Whether it is one of those that are solved together.
    is_static: Whether it sleeps, and bears who lies on it as the ground does.
    load: Impulse (N s) and angular impulse (N m s) on it of those who lie on it.
    start_position: Where it was at the beginning of the substep, m.
    reach: How far from there its pairs were collected, m.
    inverse_mass: Inverse mass, 1 / kg.
    inverse_inertia: Inverse inertia in world axes, 1 / (kg m^2).
    saved_velocities: Velocity and spin before an impact.
    unlimited_velocities: The same after one without rebound.
    free_position: Where it gets in the substep unless it touches anything, m.
    free_quaternion: Its attitude there.
    free_rotation_offset: Rotation to that attitude from where `start_segment` alone would get, world axes, rad.
"""


@func
def read_vec3(array: Vec3Like) -> Vec3:
    """Return an array of three numbers as a tuple."""
    return array[0], array[1], array[2]


@func
def write_vec3(array: np.ndarray, values: Vec3Like) -> None:
    """Write an array of three numbers."""
    array[0] = values[0]
    array[1] = values[1]
    array[2] = values[2]


@func
def read_quaternion(motion: np.record) -> Quat4:
    """Return the attitude of a drone at its time."""
    q = motion.quaternion
    return q[0], q[1], q[2], q[3]


@func
def _write_quaternion(array: np.ndarray, values: Quat4) -> None:
    """Write an attitude."""
    for k in range(4):
        array[k] = values[k]


@func
def start_motion(
    motion: np.record, before: Swarm, after: Swarm, w: int, i: int, row: np.record, dt: float
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
    quaternion = normalised(quat4(before.quaternion, w, i))
    later = quat4(after.quaternion, w, i)
    velocity = vec3(before.velocity, w, i)
    spin = to_world(quaternion, vec3(before.rates, w, i))
    # What torques did, and no error of the attitude: momentum would be held on as one
    gained = minus(vec3(after.rates, w, i), free_rates(vec3(before.rates, w, i), dt, row))
    motion.time = 0.0
    motion.impacts = 0
    motion.is_started = True
    write_vec3(motion.position, position)
    _write_quaternion(motion.quaternion, quaternion)
    write_vec3(motion.velocity, velocity)
    write_vec3(motion.spin, spin)
    write_vec3(motion.displacement, plus(vec3(after.position, w, i), -1.0, position))
    write_vec3(motion.rotation, compute_rotation_between(quaternion, later))
    write_vec3(motion.velocity_change, plus(vec3(after.velocity, w, i), -1.0, velocity))
    write_vec3(
        motion.momentum_change, compute_angular_momentum(later, to_world(later, gained), row)
    )
    motion.end_time = 1.0
    if dot(spin, spin) * dt * dt > MAX_SEGMENT_ANGLE * MAX_SEGMENT_ANGLE:
        write_vec3(motion.free_position, vec3(after.position, w, i))
        _write_quaternion(motion.free_quaternion, later)
        alone, _ = integrate_free_rotation(quaternion, spin, dt, row)
        write_vec3(motion.free_rotation_offset, compute_rotation_between(alone, later))
        start_segment(motion, dt, row)


@func
def _compute_path_fraction(motion: np.record, time: float) -> float:
    """Return the share of its way that a drone has gone at a time."""
    rest = motion.end_time - motion.time
    return (time - motion.time) / rest if rest > 0.0 else 0.0


@func
def advance_motion(motion: np.record, time: float, row: np.record) -> None:
    """Move a drone on to a time within the substep."""
    share = _compute_path_fraction(motion, time)
    elapsed = time - motion.time
    here = read_quaternion(motion)
    there = normalised(rotate_by_fraction(read_vec3(motion.rotation), share, here))
    spin = read_vec3(motion.spin)
    angular = compute_angular_momentum(here, spin, row)
    held = compute_angular_velocity(there, angular, row)
    # Its way is not quite that of a free body: energy must not grow by it
    had = dot(spin, angular)
    has = dot(held, angular)
    if has > had:
        scale = math.sqrt(had / has)
        held = (scale * held[0], scale * held[1], scale * held[2])
    twisted = compute_angular_velocity(there, read_vec3(motion.momentum_change), row)
    write_vec3(
        motion.position, plus(read_vec3(motion.position), share, read_vec3(motion.displacement))
    )
    _write_quaternion(motion.quaternion, there)
    write_vec3(
        motion.velocity,
        plus(read_vec3(motion.velocity), elapsed, read_vec3(motion.velocity_change)),
    )
    write_vec3(motion.spin, plus(held, elapsed, twisted))
    for k in range(3):
        motion.displacement[k] *= 1.0 - share
        motion.rotation[k] *= 1.0 - share
    motion.time = time


@func
def start_segment(motion: np.record, dt: float, row: np.record) -> None:
    """Let a drone fly on from its time with the velocities that it has, until it has turned far.

    Who has touched nothing goes where its dynamics took it: that is where it will be.
    """
    here = read_quaternion(motion)
    spin = read_vec3(motion.spin)
    left = 1.0 - motion.time
    motion.end_time = 1.0
    angle = math.sqrt(dot(spin, spin)) * dt
    if angle > MAX_SEGMENT_ANGLE:
        motion.end_time = min(
            1.0, motion.time + max(MIN_SEGMENT_FRACTION, MAX_SEGMENT_ANGLE / angle)
        )
    part = motion.end_time - motion.time
    there, turn = integrate_free_rotation(here, spin, part * dt, row)
    way = plus((0.0, 0.0, 0.0), part * dt, read_vec3(motion.velocity))
    if motion.impacts == 0:
        there = rotate_by_fraction(read_vec3(motion.free_rotation_offset), part, there)
        if motion.end_time == 1.0:
            q = motion.free_quaternion
            there = (q[0], q[1], q[2], q[3])
        turn = compute_rotation_between(here, there)
        share = part / left if left > 0.0 else 0.0
        way = minus(read_vec3(motion.free_position), read_vec3(motion.position))
        way = (share * way[0], share * way[1], share * way[2])
    write_vec3(motion.rotation, turn)
    write_vec3(motion.displacement, way)


@func
def is_at_impact_limit(motion: np.record) -> bool:
    """Tell whether a drone took part in too many impacts, so that it does not move by itself."""
    spent: bool = motion.impacts >= MAX_IMPACTS
    return spent


@func
def clamp_motion(motion: np.record) -> None:
    """Keep a drone where it is until the end of the substep; its velocities stay."""
    motion.end_time = 1.0
    for k in range(3):
        motion.displacement[k] = 0.0
        motion.rotation[k] = 0.0


@func
def write_end_state(motion: np.record, after: Swarm, w: int, i: int, row: np.record) -> None:
    """Write the state of drone i of world w at the end of the substep."""
    advance_motion(motion, 1.0, row)
    quaternion = read_quaternion(motion)
    rates = to_body(quaternion, read_vec3(motion.spin))
    for k in range(3):
        after.position[w, i, k] = motion.position[k]
        after.velocity[w, i, k] = motion.velocity[k]
        after.rates[w, i, k] = rates[k]
    for k in range(4):
        after.quaternion[w, i, k] = quaternion[k]


@func
def interpolate_pose(
    scenery: Scenery, motions: np.ndarray, w: int, shape: int, time: float, dt: float
) -> tuple[Vec3, Quat4]:
    """Return position and attitude of someone (number of a shape) at a time in the substep."""
    level = (0.0, 0.0, 0.0, 1.0)
    if shape < scenery.first_body:
        motion = motions[shape]
        share = _compute_path_fraction(motion, time)
        position = plus(read_vec3(motion.position), share, read_vec3(motion.displacement))
        return position, rotate_by_fraction(
            read_vec3(motion.rotation), share, read_quaternion(motion)
        )
    if shape < scenery.first_piece:
        k = shape - scenery.first_body
        turn = quat4(scenery.quaternion, w, k)
        velocity = vec3(scenery.velocity, w, k)
        return plus(vec3(scenery.place, w, k), time * dt, velocity), turn
    if shape < scenery.ground:
        return point(scenery.piece_place, shape - scenery.first_piece), level
    return (0.0, 0.0, 0.0), level


@func
def get_segment_end(scenery: Scenery, motions: np.ndarray, shape: int) -> float:
    """Return the share of the substep up to which the way of someone is known."""
    return motions[shape].end_time if shape < scenery.first_body else 1.0


@func
def compute_path_rates(
    scenery: Scenery, motions: np.ndarray, w: int, shape: int, dt: float
) -> tuple[Vec3, Vec3]:
    """Return displacement and rotation of someone on its way, per whole substep."""
    still = (0.0, 0.0, 0.0)
    if shape < scenery.first_body:
        motion = motions[shape]
        rest = motion.end_time - motion.time
        scale = 1.0 / rest if rest > 0.0 else 0.0
        return plus(still, scale, read_vec3(motion.displacement)), plus(
            still, scale, read_vec3(motion.rotation)
        )
    if shape < scenery.first_piece:
        velocity = vec3(scenery.velocity, w, shape - scenery.first_body)
        return plus(still, dt, velocity), still
    return still, still
