"""Energy of an island and sums of its passes: what impulses gain is taken back."""

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
    """Return a drone's kinetic energy (J) with a velocity and spin, as seen from a frame."""
    bx, by, bz = axes(read_quaternion(motion))
    turning = read_vec3(spin)
    moving = minus(read_vec3(velocity), frame)
    total: float = 0.5 * row.mass * dot(moving, moving)
    total += 0.5 * row.inertia[0] * dot(bx, turning) ** 2
    total += 0.5 * row.inertia[1] * dot(by, turning) ** 2
    total += 0.5 * row.inertia[2] * dot(bz, turning) ** 2
    return total


@func
def find_reference_velocity(points: np.ndarray, size: int) -> Vec3:
    """Return the velocity of what does not yield, or zeros, m/s."""
    for k in range(size):
        if points[k].b < 0:
            return read_vec3(points[k].obstacle_velocity)
    return 0.0, 0.0, 0.0


@func
def save_velocities(space: ContactWorkspace, members: int, points: np.ndarray, size: int) -> None:
    """Keep velocities and impulses as they are before passes that may gain energy."""
    for m in range(members):
        motion = space.motions[space.island[m]]
        write_vec3(motion.saved_velocities[0], motion.velocity)
        write_vec3(motion.saved_velocities[1], motion.spin)
    for k in range(size):
        write_vec3(points[k].saved_impulse, points[k].total_impulse)
        write_vec3(points[k].total_rolling_impulse, (0.0, 0.0, 0.0))


@kernel
def reopen_impulses(points: np.ndarray, count: int) -> None:
    """Take the impulses since `save_velocities` from the totals, to be found again."""
    for k in range(count):
        for m in range(3):
            points[k].impulse[m] = points[k].total_impulse[m] - points[k].saved_impulse[m]
            points[k].total_impulse[m] = points[k].saved_impulse[m]
            points[k].rolling_impulse[m] = points[k].total_rolling_impulse[m]
            points[k].total_rolling_impulse[m] = 0.0


@kernel
def accumulate_impulses(points: np.ndarray, count: int) -> None:
    """Add the impulses of a pass to the totals."""
    for k in range(count):
        for m in range(3):
            points[k].total_impulse[m] += points[k].impulse[m]
            points[k].total_rolling_impulse[m] += points[k].rolling_impulse[m]


@func
def _interpolate(one: Vec3Like, two: Vec3Like, share: float) -> Vec3:
    """Return the vector at a share of the way from one to another."""
    start = read_vec3(one)
    return plus(start, share, minus(read_vec3(two), start))


@func
def compute_kinetic_energy(
    space: ContactWorkspace, world: ContactWorld, members: int, frame: Vec3, least: float
) -> float:
    """Return the kinetic energy of an island as seen from a frame, or what speed `least` has, J."""
    total = 0.0
    for m in range(members):
        motion = space.motions[space.island[m]]
        row = world.parameters[world.w, space.island[m]]
        moving = _compute_body_energy(motion, motion.velocity, motion.spin, frame, row)
        total += max(moving, 0.5 * row.mass * least * least)
    return total


@func
def _compute_work(
    space: ContactWorkspace, world: ContactWorld, members: int, frame: Vec3, rest: float
) -> float:
    """Return the work of forces on an island in the rest of the substep, seen from a frame, J."""
    total = 0.0
    for m in range(members):
        motion = space.motions[space.island[m]]
        mass = world.parameters[world.w, space.island[m]].mass
        total += mass * rest * dot(motion.velocity_change, minus(read_vec3(motion.velocity), frame))
    return total


@func
def limit_energy(
    space: ContactWorkspace,
    world: ContactWorld,
    members: int,
    points: np.ndarray,
    size: int,
    frame: Vec3,
    had: float,
    rest: float,
) -> None:
    """Take back what energy the passes since `save_velocities` gained, if any.

    What they did is mixed with what happens if all that closes is stopped, which gains none.
    Energy is a parabola over the share of the first: it is known from its values at 0, 1/2 and 1.

    Args:
        space: Arrays to work on.
        world: The world.
        members: Drones of the island.
        points: Rows of `POINT`.
        size: How many of them count.
        frame: From which energy is seen, m/s.
        had: Energy before, without forces, J.
        rest: Share of the substep in which forces have acted since.
    """
    motions = space.motions
    full = compute_kinetic_energy(space, world, members, frame, 0.0)
    if full <= had + _compute_work(space, world, members, frame, rest):
        return
    for m in range(members):
        motion = motions[space.island[m]]
        write_vec3(motion.unlimited_velocities[0], motion.velocity)
        write_vec3(motion.unlimited_velocities[1], motion.spin)
        write_vec3(motion.velocity, motion.saved_velocities[0])
        write_vec3(motion.spin, motion.saved_velocities[1])
    # Later passes do not ask for it again
    for k in range(size):
        points[k].target_velocity = min(points[k].target_velocity, 0.0)
    solve_constraints(points, size, motions, world.dt, TIGHT_TOLERANCE, COLD_START)
    had += _compute_work(space, world, members, frame, rest)
    calm = compute_kinetic_energy(space, world, members, frame, 0.0)
    half = 0.0
    for m in range(members):
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
    share = 0.0
    if left > 0.0 and square > 0.0:
        root = math.sqrt(linear * linear + 4.0 * square * left)
        share = min(1.0, max(0.0, 2.0 * left / (linear + root)))
    for m in range(members):
        motion = motions[space.island[m]]
        write_vec3(
            motion.velocity, _interpolate(motion.velocity, motion.unlimited_velocities[0], share)
        )
        write_vec3(motion.spin, _interpolate(motion.spin, motion.unlimited_velocities[1], share))
    for k in range(size):
        point = points[k]
        for m in range(3):
            stopping = point.saved_impulse[m] + point.impulse[m]
            point.total_impulse[m] = stopping + share * (point.total_impulse[m] - stopping)
            point.total_rolling_impulse[m] = point.rolling_impulse[m] + share * (
                point.total_rolling_impulse[m] - point.rolling_impulse[m]
            )
