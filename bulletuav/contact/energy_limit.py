"""Energy limit: remove kinetic energy that the passes of the solver add to an island."""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.manifold import ContactWorkspace, ContactWorld
from bulletuav.contact.motion import read_quaternion, read_vec3, write_vec3
from bulletuav.contact.solver import COLD_START, TIGHT_TOLERANCE, solve_constraints
from bulletuav.geometry.rotation import Vec3, Vec3Like, axes, dot, minus, plus


@func
def _compute_body_energy(
    motion: np.record, velocity: Vec3Like, spin: Vec3Like, frame: Vec3, row: np.record
) -> float:
    """Return the kinetic energy of a drone in a reference frame, J.

    Args:
        motion: Row of `MOTION`; its attitude is read.
        velocity: Velocity, m/s.
        spin: Angular velocity, world axes, rad/s.
        frame: Velocity of the reference frame, m/s.
        row: Row of `PARAMETERS` of the drone.
    """
    bx, by, bz = axes(read_quaternion(motion))
    turning = read_vec3(spin)
    moving = minus(read_vec3(velocity), frame)
    total: float = 0.5 * row.mass * dot(moving, moving)
    total += 0.5 * row.inertia[0] * dot(bx, turning) ** 2
    total += 0.5 * row.inertia[1] * dot(by, turning) ** 2
    total += 0.5 * row.inertia[2] * dot(bz, turning) ** 2
    return total


@func
def find_reference_velocity(points: np.ndarray, num_points: int) -> Vec3:
    """Return the velocity of the first static body that is touched, or zeros, m/s."""
    for k in range(num_points):
        if points[k].b < 0:
            return read_vec3(points[k].obstacle_velocity)
    return 0.0, 0.0, 0.0


@func
def save_velocities(
    space: ContactWorkspace, num_members: int, points: np.ndarray, num_points: int
) -> None:
    """Save velocities and impulses before passes of the solver that may gain energy."""
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        write_vec3(motion.saved_velocities[0], motion.velocity)
        write_vec3(motion.saved_velocities[1], motion.spin)
    for k in range(num_points):
        write_vec3(points[k].saved_impulse, points[k].total_impulse)
        write_vec3(points[k].total_rolling_impulse, (0.0, 0.0, 0.0))


@kernel
def reopen_impulses(points: np.ndarray, num_points: int) -> None:
    """Move the impulses since `save_velocities` from the totals back to the present pass."""
    for k in range(num_points):
        for m in range(3):
            points[k].impulse[m] = points[k].total_impulse[m] - points[k].saved_impulse[m]
            points[k].total_impulse[m] = points[k].saved_impulse[m]
            points[k].rolling_impulse[m] = points[k].total_rolling_impulse[m]
            points[k].total_rolling_impulse[m] = 0.0


@kernel
def accumulate_impulses(points: np.ndarray, num_points: int) -> None:
    """Add the impulses of a pass to the totals."""
    for k in range(num_points):
        for m in range(3):
            points[k].total_impulse[m] += points[k].impulse[m]
            points[k].total_rolling_impulse[m] += points[k].rolling_impulse[m]


@func
def _interpolate(one: Vec3Like, two: Vec3Like, fraction: float) -> Vec3:
    """Interpolate linearly between two vectors."""
    start = read_vec3(one)
    return plus(start, fraction, minus(read_vec3(two), start))


@func
def compute_kinetic_energy(
    space: ContactWorkspace, world: ContactWorld, num_members: int, frame: Vec3, least: float
) -> float:
    """Return the kinetic energy of an island in a reference frame, J.

    Each drone counts at least as much as at the speed `least`.
    """
    total = 0.0
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        row = world.parameters[world.w, space.island[m]]
        moving = _compute_body_energy(motion, motion.velocity, motion.spin, frame, row)
        total += max(moving, 0.5 * row.mass * least * least)
    return total


@func
def _compute_work(
    space: ContactWorkspace, world: ContactWorld, num_members: int, frame: Vec3, remaining: float
) -> float:
    """Return the work of forces on an island in a fraction of the substep, in a moving frame, J."""
    total = 0.0
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        mass = world.parameters[world.w, space.island[m]].mass
        total += (
            mass * remaining * dot(motion.velocity_change, minus(read_vec3(motion.velocity), frame))
        )
    return total


@func
def limit_energy(
    space: ContactWorkspace,
    world: ContactWorld,
    num_members: int,
    points: np.ndarray,
    num_points: int,
    frame: Vec3,
    had: float,
    remaining: float,
) -> None:
    """Remove the energy that the passes since `save_velocities` added, if any.

    Their result is interpolated with that of stopping all approaches, which adds no energy. The
    energy is a quadratic function of the fraction: it follows from its values at 0, 1/2 and 1.

    Args:
        space: Arrays to work on.
        world: The world.
        num_members: Number of drones of the island.
        points: Rows of `CONTACT_POINT`.
        num_points: Number of points in use.
        frame: Velocity of the reference frame, m/s.
        had: Energy before, without forces, J.
        remaining: Fraction of the substep in which forces have acted since.
    """
    motions = space.motions
    full = compute_kinetic_energy(space, world, num_members, frame, 0.0)
    if full <= had + _compute_work(space, world, num_members, frame, remaining):
        return
    for m in range(num_members):
        motion = motions[space.island[m]]
        write_vec3(motion.unlimited_velocities[0], motion.velocity)
        write_vec3(motion.unlimited_velocities[1], motion.spin)
        write_vec3(motion.velocity, motion.saved_velocities[0])
        write_vec3(motion.spin, motion.saved_velocities[1])
    # Later passes must not push apart again
    for k in range(num_points):
        points[k].target_velocity = min(points[k].target_velocity, 0.0)
    solve_constraints(points, num_points, motions, world.dt, TIGHT_TOLERANCE, COLD_START)
    had += _compute_work(space, world, num_members, frame, remaining)
    calm = compute_kinetic_energy(space, world, num_members, frame, 0.0)
    half = 0.0
    for m in range(num_members):
        motion = motions[space.island[m]]
        velocity = _interpolate(motion.velocity, motion.unlimited_velocities[0], 0.5)
        spin = _interpolate(motion.spin, motion.unlimited_velocities[1], 0.5)
        half += _compute_body_energy(
            motion, velocity, spin, frame, world.parameters[world.w, space.island[m]]
        )
    # calm + linear s + square s^2 = had
    square = 2.0 * (full + calm) - 4.0 * half
    linear = full - calm - square
    left = had - calm
    fraction = 0.0
    if left > 0.0 and square > 0.0:
        root = math.sqrt(linear * linear + 4.0 * square * left)
        fraction = min(1.0, max(0.0, 2.0 * left / (linear + root)))
    for m in range(num_members):
        motion = motions[space.island[m]]
        write_vec3(
            motion.velocity, _interpolate(motion.velocity, motion.unlimited_velocities[0], fraction)
        )
        write_vec3(motion.spin, _interpolate(motion.spin, motion.unlimited_velocities[1], fraction))
    for k in range(num_points):
        point = points[k]
        for m in range(3):
            stopping = point.saved_impulse[m] + point.impulse[m]
            point.total_impulse[m] = stopping + fraction * (point.total_impulse[m] - stopping)
            point.total_rolling_impulse[m] = point.rolling_impulse[m] + fraction * (
                point.total_rolling_impulse[m] - point.rolling_impulse[m]
            )
