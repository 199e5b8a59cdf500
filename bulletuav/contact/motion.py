"""Motion of the drones of one world within a substep, and its changes at impacts.

Times are fractions of the substep, from 0 to 1. Between impacts a drone moves straight and rotates
about one axis, and its forces act evenly. Without torque the angular momentum is constant, not the
angular velocity.
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
    cross,
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

MAX_SEGMENT_ANGLE = 0.5
"""Maximum rotation about one axis in a path segment, rad; the next segment takes another axis"""
MAX_IMPACTS = 16
"""Impacts of a drone in a substep after which it is clamped, or moves with an obstacle"""
MIN_SEGMENT_FRACTION = 1.0 / 64.0
"""Minimum length of a path segment as a fraction of the substep, however fast the drone rotates"""

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
        ("range", "f8"),
        ("inverse_mass", "f8"),
        ("inverse_inertia", "f8", (3, 3)),
        ("saved_velocities", "f8", (2, 3)),
        ("unlimited_velocities", "f8", (2, 3)),
        ("free_position", "f8", 3),
        ("free_quaternion", "f8", 4),
        ("free_rotation_offset", "f8", 3),
    ]
)
"""Path segment of a drone from one time in the substep to another, mostly its end.

Attributes:
    time: Fraction of the substep at which the segment starts.
    end_time: Fraction of the substep at which it ends.
    position: Centre of mass at `time`, m.
    quaternion: Attitude at `time`.
    velocity: Velocity at `time`, m/s.
    spin: Angular velocity at `time`, world axes, rad/s.
    displacement: Displacement from `time` to `end_time`, m.
    rotation: Rotation from `time` to `end_time`, axis times angle, world axes, rad.
    velocity_change: Change of velocity by forces over the whole substep, m/s.
    momentum_change: Change of angular momentum by torques over the substep, world axes, N m s.
    impacts: Number of impacts of the drone in this substep.
    is_started: Whether the fields above are set.
    is_due: Whether the drone has to be checked, because its budget is or soon will be used up, or
        because it is touched.
    in_island: Whether the drone belongs to the present island.
    is_static: Whether the drone sleeps, and supports others like the ground does.
    load: Impulse (N s) and angular impulse (N m s) that the drones on it exert on it.
    start_position: Position at the beginning of the substep, m.
    range: Distance from there within which its pairs were collected, m.
    inverse_mass: 1 / kg.
    inverse_inertia: In world axes, 1 / (kg m^2).
    saved_velocities: Velocity and angular velocity before passes of the solver that may gain
        energy.
    unlimited_velocities: Velocity and angular velocity after them, before energy is limited.
    free_position: Position at the end of the substep if the drone touches nothing, m.
    free_quaternion: Attitude at the end of the substep if the drone touches nothing.
    free_rotation_offset: Rotation from the attitude that `start_segment` alone would reach to
        that attitude, world axes, rad.
"""


@func
def read_vec3(array: Vec3Like) -> Vec3:
    """Return an array of three numbers as a tuple."""
    return array[0], array[1], array[2]


@func
def write_vec3(array: np.ndarray, values: Vec3Like) -> None:
    """Write three numbers into an array."""
    array[0] = values[0]
    array[1] = values[1]
    array[2] = values[2]


@func
def read_quaternion(motion: np.record) -> Quat4:
    """Return the attitude of a drone at the start of its path segment."""
    q = motion.quaternion
    return q[0], q[1], q[2], q[3]


@func
def _write_quaternion(array: np.ndarray, values: Quat4) -> None:
    for k in range(4):
        array[k] = values[k]


@func
def start_motion(
    motion: np.record, before: Swarm, after: Swarm, w: int, i: int, row: np.record, dt: float
) -> None:
    """Start the contact-free motion of drone i of world w through a substep.

    Args:
        motion: Row of `MOTION`, written.
        before: State at the beginning of the substep.
        after: State at the end of the substep.
        w: Index of the world.
        i: Index of the drone.
        row: Row of `PARAMETERS` of the drone.
        dt: Length of the substep, s.
    """
    position = vec3(before.position, w, i)
    # Quaternions of states that users set may be off by a millionth
    quaternion = normalise_quaternion(quat4(before.quaternion, w, i))
    later = quat4(after.quaternion, w, i)
    velocity = vec3(before.velocity, w, i)
    spin = to_world(quaternion, vec3(before.rates, w, i))
    # Only the effect of torques: an error of the attitude must not count as momentum
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
    """Return the fraction of the path segment that a drone has covered at a time."""
    remaining = motion.end_time - motion.time
    return (time - motion.time) / remaining if remaining > 0.0 else 0.0


@func
def advance_motion(motion: np.record, time: float, row: np.record) -> None:
    """Advance a drone along its path segment to a time within the substep."""
    fraction = _compute_path_fraction(motion, time)
    elapsed = time - motion.time
    here = read_quaternion(motion)
    there = normalise_quaternion(rotate_by_fraction(read_vec3(motion.rotation), fraction, here))
    spin = read_vec3(motion.spin)
    angular = compute_angular_momentum(here, spin, row)
    held = compute_angular_velocity(there, angular, row)
    # The path deviates slightly from that of a free body: energy must not grow by this
    had = dot(spin, angular)
    has = dot(held, angular)
    if has > had:
        scale = math.sqrt(had / has)
        held = (scale * held[0], scale * held[1], scale * held[2])
    twisted = compute_angular_velocity(there, read_vec3(motion.momentum_change), row)
    write_vec3(
        motion.position, plus(read_vec3(motion.position), fraction, read_vec3(motion.displacement))
    )
    _write_quaternion(motion.quaternion, there)
    write_vec3(
        motion.velocity,
        plus(read_vec3(motion.velocity), elapsed, read_vec3(motion.velocity_change)),
    )
    write_vec3(motion.spin, plus(held, elapsed, twisted))
    for k in range(3):
        motion.displacement[k] *= 1.0 - fraction
        motion.rotation[k] *= 1.0 - fraction
    motion.time = time


@func
def start_segment(motion: np.record, dt: float, row: np.record) -> None:
    """Start the next path segment of a drone with its present velocities.

    The segment ends when the drone has rotated by `MAX_SEGMENT_ANGLE`. A drone that has had no
    impact moves to where its dynamics took it.
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
    displacement = plus((0.0, 0.0, 0.0), part * dt, read_vec3(motion.velocity))
    if motion.impacts == 0:
        there = rotate_by_fraction(read_vec3(motion.free_rotation_offset), part, there)
        if motion.end_time == 1.0:
            q = motion.free_quaternion
            there = (q[0], q[1], q[2], q[3])
        turn = compute_rotation_between(here, there)
        fraction = part / left if left > 0.0 else 0.0
        displacement = minus(read_vec3(motion.free_position), read_vec3(motion.position))
        displacement = (
            fraction * displacement[0],
            fraction * displacement[1],
            fraction * displacement[2],
        )
    write_vec3(motion.rotation, turn)
    write_vec3(motion.displacement, displacement)


@func
def is_at_impact_limit(motion: np.record) -> bool:
    """Check whether a drone had `MAX_IMPACTS` impacts, so that it no longer moves by itself."""
    reached: bool = motion.impacts >= MAX_IMPACTS
    return reached


@func
def clamp_motion(motion: np.record) -> None:
    """Keep a drone at its position until the end of the substep; its velocities do not change."""
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
    """Return the position and attitude of a shape at a time in the substep."""
    level = (0.0, 0.0, 0.0, 1.0)
    if shape < scenery.first_body:
        motion = motions[shape]
        fraction = _compute_path_fraction(motion, time)
        position = plus(read_vec3(motion.position), fraction, read_vec3(motion.displacement))
        return position, rotate_by_fraction(
            read_vec3(motion.rotation), fraction, read_quaternion(motion)
        )
    if shape < scenery.first_piece:
        k = shape - scenery.first_body
        turn = quat4(scenery.quaternion, w, k)
        velocity = vec3(scenery.velocity, w, k)
        spin = vec3(scenery.spin, w, k)
        if spin != (0.0, 0.0, 0.0):
            turn = rotate_by_fraction(spin, time * dt, turn)
        return plus(vec3(scenery.place, w, k), time * dt, velocity), turn
    if shape < scenery.ground:
        return point(scenery.piece_place, shape - scenery.first_piece), level
    return (0.0, 0.0, 0.0), level


@func
def get_segment_end(scenery: Scenery, motions: np.ndarray, shape: int) -> float:
    """Return the fraction of the substep up to which the path of a shape is known."""
    return motions[shape].end_time if shape < scenery.first_body else 1.0


@func
def compute_path_rates(
    scenery: Scenery, motions: np.ndarray, w: int, shape: int, dt: float
) -> tuple[Vec3, Vec3]:
    """Return the displacement and rotation of a shape on its path, per whole substep."""
    still = (0.0, 0.0, 0.0)
    if shape < scenery.first_body:
        motion = motions[shape]
        remaining = motion.end_time - motion.time
        scale = 1.0 / remaining if remaining > 0.0 else 0.0
        return plus(still, scale, read_vec3(motion.displacement)), plus(
            still, scale, read_vec3(motion.rotation)
        )
    if shape < scenery.first_piece:
        k = shape - scenery.first_body
        velocity, turning = vec3(scenery.velocity, w, k), vec3(scenery.spin, w, k)
        return plus(still, dt, velocity), plus(still, dt, turning)
    return still, still


@func
def compute_path_displacement(
    scenery: Scenery, motions: np.ndarray, w: int, shape: int, rider: int, dt: float
) -> Vec3:
    """Return the displacement of a shape at the position of a drone `rider`, per whole substep, m.

    That is the displacement of the point of a turning body which carries the drone.
    """
    move, turn = compute_path_rates(scenery, motions, w, shape, dt)
    if shape < scenery.first_body or turn == (0.0, 0.0, 0.0):
        return move
    arm = minus(
        read_vec3(motions[rider].position), vec3(scenery.place, w, shape - scenery.first_body)
    )
    return plus(move, 1.0, cross(turn, arm))
