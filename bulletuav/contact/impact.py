"""Impacts: resolve the contacts of an island at one time of the substep."""

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.contact.clamping import (
    MIN_APPROACH_SPEED,
    clamp_spent_drones,
    compute_carried_displacement,
    remove_forces,
)
from bulletuav.contact.constraint import CONTACT_POINT, apply_inverse_inertia
from bulletuav.contact.contact_log import ContactLog, record_contact
from bulletuav.contact.energy_limit import (
    accumulate_impulses,
    compute_kinetic_energy,
    find_reference_velocity,
    limit_energy,
    reopen_impulses,
    save_velocities,
)
from bulletuav.contact.islands import build_island, is_pair_in_island, may_touch
from bulletuav.contact.manifold import (
    MAX_PUSH_OUT_SPEED,
    TARGET_SEPARATION,
    ContactWorkspace,
    ContactWorld,
    add_contact_points,
    measure_pair,
)
from bulletuav.contact.motion import is_at_impact_limit, read_vec3, start_segment
from bulletuav.contact.solver import (
    COLD_START,
    MULTI_BODY_TOLERANCE,
    RESUME,
    SINGLE_BODY_TOLERANCE,
    TIGHT_TOLERANCE,
    WARM_START,
    damp_tipping,
    solve_constraints,
)
from bulletuav.contact.speculative import find_speculative_point
from bulletuav.contact.time_of_impact import CONTACT_DISTANCE, MAX_CONTACT_DISTANCE
from bulletuav.contact.warm_start import store_impulses, warm_start_impulses
from bulletuav.geometry.contact_points import MAX_POINTS
from bulletuav.geometry.rotation import cross, plus

RESTITUTION_THRESHOLD = 0.02
"""Approach speed below which there is no restitution, m/s"""
MIN_CLOSING_SPEED = 1e-6
"""Approach speed below which touching shapes need no impulses for the impact itself, m/s"""
MAX_SPECULATIVE_PASSES = 4
"""Maximum number of passes of an impact that search for speculative contacts"""
MIN_SPECULATIVE_TIME = 1e-6
"""Rest of a substep below which there are no speculative contacts, s"""
UNCONSTRAINED_VELOCITY = -1e9
"""Target velocity of points that do not constrain the motion, m/s"""


@func
def _needs_restitution(point: np.record) -> bool:
    """Check whether a point is in contact and approaches fast enough for restitution."""
    found: bool = (
        point.distance <= MAX_CONTACT_DISTANCE and point.normal_velocity < -RESTITUTION_THRESHOLD
    )
    return found


@func
def _apply_restitution(
    space: ContactWorkspace, world: ContactWorld, members: int, points: np.ndarray, size: int
) -> bool:
    """Apply Newton's restitution to fast contacts without a gain of energy, and stop slow ones.

    Fast contacts without restitution are left to `_solve_resting_contacts`, since forces of this
    substep belong to the velocity before.

    Returns:
        True if all touching points are slow.
    """
    rebounds = False
    closes = False
    slow = True
    for k in range(size):
        point = points[k]
        point.target_velocity = UNCONSTRAINED_VELOCITY
        if point.distance > MAX_CONTACT_DISTANCE:
            continue
        point.target_velocity = 0.0
        closes = closes or point.normal_velocity < -MIN_CLOSING_SPEED
        if _needs_restitution(point):
            slow = False
            rebounds = rebounds or point.restitution > 0.0
            point.target_velocity = -point.restitution * point.normal_velocity
    if rebounds:
        frame = find_reference_velocity(points, size)
        had = compute_kinetic_energy(space, world, members, frame, 0.0)
        save_velocities(space, members, points, size)
        solve_constraints(points, size, space.motions, world.dt, TIGHT_TOLERANCE, COLD_START)
        accumulate_impulses(points, size)
        limit_energy(space, world, members, points, size, frame, had, 0.0)
    elif closes and slow:
        # Stopping an approach gains no energy
        solve_constraints(points, size, space.motions, world.dt, SINGLE_BODY_TOLERANCE, COLD_START)
        accumulate_impulses(points, size)
    return slow


@func
def _set_target_velocities(pairs: np.ndarray, points: np.ndarray, size: int, dt: float) -> None:
    """Set the velocity along the normal that each contact point may, or must, reach.

    Within a pair the target is linear in the distances, as the motion of rigid bodies is: a pair
    can therefore reach it at all of its points. A drone on a sleeping drone need not part from it
    unless they overlap, because a drone wedged between two others could not.
    """
    k = 0
    while k < size:
        end = k
        deepest = 0.0
        while end < size and points[end].pair == points[k].pair:
            deepest = max(deepest, TARGET_SEPARATION - points[end].distance)
            end += 1
        rate = 1.0 / max(dt, deepest / MAX_PUSH_OUT_SPEED)
        for m in range(k, end):
            point = points[m]
            point.target_velocity = rate * (TARGET_SEPARATION - point.distance)
            if pairs[point.pair].is_on_sleeper and deepest <= TARGET_SEPARATION:
                point.target_velocity = min(0.0, point.target_velocity)
            # A point that rebounds when it touches gets an impact of its own
            if (
                point.distance > MAX_CONTACT_DISTANCE
                and point.restitution > 0.0
                and point.normal_velocity < -RESTITUTION_THRESHOLD
            ):
                point.target_velocity = UNCONSTRAINED_VELOCITY
        k = end


@func
def apply_forces(space: ContactWorkspace, members: int, time: float, sign: float) -> None:
    """Add what forces do in the rest of the substep, times sign, to the velocities of an island."""
    rest = sign * (1.0 - time)
    for m in range(members):
        motion = space.motions[space.island[m]]
        angular_change = apply_inverse_inertia(motion, read_vec3(motion.momentum_change))
        for k in range(3):
            motion.velocity[k] += rest * motion.velocity_change[k]
            motion.spin[k] += rest * angular_change[k]


@func
def _use_mean_velocity(motion: np.record, time: float, dt: float) -> None:
    """Move a drone with the mean of its velocities at the start and the end of the segment.

    `start_segment` uses the velocity at the end, which is 1 % too far at the start of a slide.
    """
    rest = 1.0 - time
    share = (motion.end_time - time) / rest if rest > 0.0 else 0.0
    for k in range(3):
        began = motion.saved_velocities[0, k] - rest * motion.velocity_change[k]
        mean = began + 0.5 * share * (motion.velocity[k] - began)
        motion.displacement[k] = (motion.end_time - time) * dt * mean


@func
def _solve_resting_contacts(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    count: int,
    members: int,
    points: np.ndarray,
    size: int,
    time: float,
    slow: bool,
) -> int:
    """Solve the contacts of an island against forces for the rest of the substep.

    Also stops what approaches slowly. Where all contacts are slow and something supports the
    island, drones move with the mean of the velocities before and after, as forces act along the
    whole path. In free fall, moving with any other velocity than the present one would change the
    angular momentum.

    Contacts that would arise until the end of the substep get speculative points, which share the
    load with the present points.

    Returns:
        Number of points, speculative points included.
    """
    motions = space.motions
    _set_target_velocities(pairs, points, size, world.dt)
    frame = find_reference_velocity(points, size)
    had = compute_kinetic_energy(space, world, members, frame, MAX_PUSH_OUT_SPEED)
    apply_forces(space, members, time, 1.0)
    save_velocities(space, members, points, size)
    memory = world.memory
    radii = world.scenery.table.radius
    tolerance = SINGLE_BODY_TOLERANCE if members == 1 else MULTI_BODY_TOLERANCE
    is_single = members == 1
    is_supported = False
    for p in range(count):
        is_single = is_single and not (pairs[p].in_impact and pairs[p].is_on_sleeper)
        bears = pairs[p].is_on_sleeper or pairs[p].b >= motions.shape[0]
        is_supported = is_supported or (pairs[p].in_impact and bears)
    for trial in range(MAX_SPECULATIVE_PASSES + 1):
        if trial == 0:
            warm_start_impulses(memory, motions, radii, world.w, points, pairs, size, 1.0 - time)
            solve_constraints(points, size, motions, world.dt, tolerance, WARM_START)
            island = space.island
            store_impulses(
                memory, motions, world.w, island, members, points, pairs, size, 1.0 - time
            )
            accumulate_impulses(points, size)
            if damp_tipping(points, size, motions):
                solve_constraints(points, size, motions, world.dt, tolerance, COLD_START)
                accumulate_impulses(points, size)
        else:
            # A fast drone on its own leaves the contact before it would rock
            shares_load = slow or members > 1
            if shares_load:
                reopen_impulses(points, size)
            solve_constraints(
                points, size, motions, world.dt, tolerance, RESUME if shares_load else COLD_START
            )
            accumulate_impulses(points, size)
            limit_energy(space, world, members, points, size, frame, had, 1.0 - time)
        for m in range(members):
            i = space.island[m]
            motion = motions[i]
            start_segment(motion, world.dt, world.parameters[world.w, i])
            # At a later impact of a pile the saved velocities are not those of its path
            if is_supported and slow and trial == 0 and (is_single or motion.impacts == 1):
                _use_mean_velocity(motion, time, world.dt)
        before = size
        if trial < MAX_SPECULATIVE_PASSES and (1.0 - time) * world.dt > MIN_SPECULATIVE_TIME:
            for p in range(count):
                if pairs[p].in_impact and find_speculative_point(
                    space, world, pairs[p], time, points[size]
                ):
                    points[size].pair = p
                    size += 1
        if size == before:
            break
    # Restore the velocities at the time of the impact: forces are added along the path
    apply_forces(space, members, time, -1.0)
    return size


@func
def _record_point(
    touches: ContactLog, space: ContactWorkspace, w: int, point: np.record, other: int
) -> None:
    """Record a contact point on each drone of the pair."""
    place = plus(read_vec3(space.motions[point.a].position), 1.0, read_vec3(point.arm_a))
    normal, velocity = read_vec3(point.normal), read_vec3(point.relative_velocity)
    record_contact(
        touches, w, point.a, other, point.total_impulse[0], place, normal, velocity, 0.0, 1.0
    )
    # Also for a sleeping drone that supports a
    if other < space.motions.shape[0]:
        record_contact(
            touches, w, other, point.a, point.total_impulse[0], place, normal, velocity, 0.0, -1.0
        )


@func
def _add_load(motion: np.record, point: np.record) -> None:
    """Add the impulse of a point to the load of a sleeping drone."""
    normal = read_vec3(point.normal)
    pressed = plus((0.0, 0.0, 0.0), -point.total_impulse[0], normal)
    pressed = plus(pressed, -point.total_impulse[1], read_vec3(point.tangent[0]))
    pressed = plus(pressed, -point.total_impulse[2], read_vec3(point.tangent[1]))
    turned = cross(read_vec3(point.arm_b), pressed)
    for k in range(3):
        motion.load[0, k] += pressed[k]
        motion.load[1, k] += turned[k]


@deferred(types.int64)
@allocating
def resolve_impact(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    count: int,
    first: int,
    time: float,
    touches: ContactLog,
) -> int:
    """Resolve the impact of all drones that are connected to a pair by contacts.

    Returns the number of drones of the island. Their indices are in `space.island`, and they start
    a path segment with new velocities.
    """
    motions = space.motions
    members = build_island(space, world, pairs, count, first, time)
    # A drone at the impact limit does not move by itself until the next substep
    is_clamped = False
    for m in range(members):
        motion = motions[space.island[m]]
        motion.impacts += 1
        if is_at_impact_limit(motion):
            remove_forces(motion, time)
            is_clamped = True
    way = (0.0, 0.0, 0.0)
    if is_clamped:
        way = compute_carried_displacement(space, world, pairs, count, members, time)
    # Build the contact manifolds of all touching pairs of the island
    most = 0
    for p in range(count):
        pairs[p].in_impact = is_pair_in_island(motions, pairs[p]) and may_touch(pairs[p], time)
        if pairs[p].in_impact:
            most += MAX_POINTS + MAX_SPECULATIVE_PASSES
    points = np.empty(most, dtype=CONTACT_POINT)
    size = 0
    for p in range(count):
        more = size
        if pairs[p].in_impact:
            more = add_contact_points(space, world, pairs[p], time, points, size)
        for k in range(size, more):
            points[k].pair = p
        pairs[p].in_impact = more > size
        size = more
    slow = _apply_restitution(space, world, members, points, size)
    size = _solve_resting_contacts(space, world, pairs, count, members, points, size, time, slow)
    for k in range(size):
        # Skip points that part without an impulse
        if points[k].total_impulse[0] <= 0.0 and points[k].normal_velocity >= -MIN_APPROACH_SPEED:
            continue
        other = pairs[points[k].pair].b
        _record_point(touches, space, world.w, points[k], other)
        if other < motions.shape[0] and motions[other].is_static:
            _add_load(motions[other], points[k])
    clamp_spent_drones(space, members, time, way)
    return members


@kernel
def record_overlap(
    space: ContactWorkspace, world: ContactWorld, pair: np.record, touches: ContactLog
) -> None:
    """Record a pair that is in contact at the beginning of a substep, without an impulse."""
    distance, normal, on_a, _ = measure_pair(space, world, pair, 0.0)
    if distance > CONTACT_DISTANCE:
        return
    place = plus(read_vec3(space.motions[pair.a].position), 1.0, on_a)
    still = (0.0, 0.0, 0.0)
    depth = max(0.0, -distance)
    record_contact(touches, world.w, pair.a, pair.b, 0.0, place, normal, still, depth, 1.0)
    if pair.b < world.scenery.first_body:
        record_contact(touches, world.w, pair.b, pair.a, 0.0, place, normal, still, depth, -1.0)
