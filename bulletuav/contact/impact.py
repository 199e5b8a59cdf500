"""Impacts: resolve the contacts of an island at one time of the substep."""

import numpy as np
from numba import types

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.contact.clamping import (
    MIN_APPROACH_SPEED,
    clamp_drones_at_limit,
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
"""Remaining substep below which there are no speculative contacts, s"""
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
    space: ContactWorkspace,
    world: ContactWorld,
    num_members: int,
    points: np.ndarray,
    num_points: int,
) -> bool:
    """Apply Newton's restitution to fast contacts without a gain of energy, or stop slow ones.

    If any fast contact has restitution, all touching points are solved. If all touching points are
    slow, their approach is stopped. Otherwise all points are left to `_solve_resting_contacts`,
    since forces of this substep belong to the velocity before.

    Args:
        space: Arrays to work on; `island` has the drones of the island.
        world: The world.
        num_members: Number of drones of the island.
        points: Rows of `CONTACT_POINT`; impulses and target velocities are written.
        num_points: Number of points in use.

    Returns:
        True if all touching points are slow: none approaches faster than `RESTITUTION_THRESHOLD`.
    """
    rebounds = False
    closes = False
    slow = True
    for k in range(num_points):
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
        frame = find_reference_velocity(points, num_points)
        had = compute_kinetic_energy(space, world, num_members, frame, 0.0)
        save_velocities(space, num_members, points, num_points)
        solve_constraints(points, num_points, space.motions, world.dt, TIGHT_TOLERANCE, COLD_START)
        accumulate_impulses(points, num_points)
        limit_energy(space, world, num_members, points, num_points, frame, had, 0.0)
    elif closes and slow:
        # Stopping an approach gains no energy
        solve_constraints(
            points, num_points, space.motions, world.dt, SINGLE_BODY_TOLERANCE, COLD_START
        )
        accumulate_impulses(points, num_points)
    return slow


@func
def _set_target_velocities(
    pairs: np.ndarray, points: np.ndarray, num_points: int, dt: float
) -> None:
    """Set the lower bound of the velocity along the normal at each contact point.

    Within a pair the target is linear in the distances, as the motion of rigid bodies is: a pair
    can therefore reach it at all of its points. A drone on a sleeping drone need not part from it
    unless they overlap, because a drone wedged between two others could not.
    """
    k = 0
    while k < num_points:
        end = k
        deepest = 0.0
        while end < num_points and points[end].pair == points[k].pair:
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
def apply_forces(space: ContactWorkspace, num_members: int, time: float, sign: float) -> None:
    """Change the velocities of an island as its forces do in the remaining substep.

    Args:
        space: Arrays to work on; `island` has the drones of the island.
        num_members: Number of drones of the island.
        time: Present time, as a fraction of the substep.
        sign: 1 to add the change, -1 to subtract it.
    """
    remaining = sign * (1.0 - time)
    for m in range(num_members):
        motion = space.motions[space.island[m]]
        angular_change = apply_inverse_inertia(motion, read_vec3(motion.momentum_change))
        for k in range(3):
            motion.velocity[k] += remaining * motion.velocity_change[k]
            motion.spin[k] += remaining * angular_change[k]


@func
def _use_mean_velocity(motion: np.record, time: float, dt: float) -> None:
    """Set the displacement of a path segment from the mean of its start and end velocities.

    `start_segment` uses the end velocity, which is 1 % too far at the start of a slide.
    """
    remaining = 1.0 - time
    fraction = (motion.end_time - time) / remaining if remaining > 0.0 else 0.0
    for k in range(3):
        began = motion.saved_velocities[0, k] - remaining * motion.velocity_change[k]
        mean = began + 0.5 * fraction * (motion.velocity[k] - began)
        motion.displacement[k] = (motion.end_time - time) * dt * mean


@func
def _solve_resting_contacts(
    space: ContactWorkspace,
    world: ContactWorld,
    pairs: np.ndarray,
    num_members: int,
    points: np.ndarray,
    num_points: int,
    time: float,
    slow: bool,
) -> int:
    """Solve the contacts of an island against forces for the remaining substep.

    This also stops points that approach slowly. Drones start a path segment with the velocity that
    they would have at the end of the substep. If all contacts are slow and something supports the
    island, they move with the mean of the velocities before and after instead, as forces act along
    the whole path. A drone in a pile does so only at its first impact in the substep: later its
    saved velocity is not that of its path. In free fall, moving with any other velocity than the
    present one would change the angular momentum.

    Contacts that would arise until the end of the substep get speculative points. They share the
    load with the present points, except for a fast drone on its own, which leaves the contact
    before it would rock.

    The velocities at `time` are restored at the end, changed by the impulses alone, because forces
    are added along the path.

    Args:
        space: Arrays to work on; `island` has the drones of the island.
        world: The world.
        pairs: Rows of `PAIR`.
        num_members: Number of drones of the island.
        points: Rows of `CONTACT_POINT`; impulses are written, speculative points added.
        num_points: Number of points in use.
        time: Time of the impact, as a fraction of the substep.
        slow: Result of `_apply_restitution`.

    Returns:
        Number of points, including the speculative ones.
    """
    motions = space.motions
    _set_target_velocities(pairs, points, num_points, world.dt)
    frame = find_reference_velocity(points, num_points)
    had = compute_kinetic_energy(space, world, num_members, frame, MAX_PUSH_OUT_SPEED)
    apply_forces(space, num_members, time, 1.0)
    save_velocities(space, num_members, points, num_points)
    memory = world.memory
    radii = world.scenery.table.radius
    tolerance = SINGLE_BODY_TOLERANCE if num_members == 1 else MULTI_BODY_TOLERANCE
    is_single = num_members == 1
    is_supported = False
    # All pairs of the impact have points, in the order of the pairs
    num_touching = num_points
    for k in range(num_touching):
        pair = pairs[points[k].pair]
        is_single = is_single and not pair.is_on_sleeper
        is_supported = is_supported or pair.is_on_sleeper or pair.b >= motions.shape[0]
    for trial in range(MAX_SPECULATIVE_PASSES + 1):
        if trial == 0:
            warm_start_impulses(
                memory, motions, radii, world.w, points, pairs, num_points, 1.0 - time
            )
            solve_constraints(points, num_points, motions, world.dt, tolerance, WARM_START)
            island = space.island
            store_impulses(
                memory, motions, world.w, island, num_members, points, pairs, num_points, 1.0 - time
            )
            accumulate_impulses(points, num_points)
            if damp_tipping(points, num_points, motions):
                solve_constraints(points, num_points, motions, world.dt, tolerance, COLD_START)
                accumulate_impulses(points, num_points)
        else:
            # A fast drone on its own leaves the contact before it would rock
            shares_load = slow or num_members > 1
            if shares_load:
                reopen_impulses(points, num_points)
            solve_constraints(
                points,
                num_points,
                motions,
                world.dt,
                tolerance,
                RESUME if shares_load else COLD_START,
            )
            accumulate_impulses(points, num_points)
            limit_energy(space, world, num_members, points, num_points, frame, had, 1.0 - time)
        for m in range(num_members):
            i = space.island[m]
            motion = motions[i]
            start_segment(motion, world.dt, world.parameters[world.w, i])
            # At a later impact of a pile the saved velocities are not those of its path
            if is_supported and slow and trial == 0 and (is_single or motion.impacts == 1):
                _use_mean_velocity(motion, time, world.dt)
        before = num_points
        if trial < MAX_SPECULATIVE_PASSES and (1.0 - time) * world.dt > MIN_SPECULATIVE_TIME:
            for k in range(num_touching):
                p = points[k].pair
                if k > 0 and points[k - 1].pair == p:
                    continue
                if find_speculative_point(space, world, pairs[p], time, points[num_points]):
                    points[num_points].pair = p
                    num_points += 1
        if num_points == before:
            break
    # Restore the velocities at the time of the impact: forces are added along the path
    apply_forces(space, num_members, time, -1.0)
    return num_points


@func
def _record_point(
    touches: ContactLog, space: ContactWorkspace, w: int, point: np.record, b: int
) -> None:
    """Record a contact point on each drone of the pair.

    Args:
        touches: Contact log, added to.
        space: Arrays to work on.
        w: Index of the world.
        point: Row of `CONTACT_POINT`.
        b: Index of the other shape of the pair, also if it is a static body.
    """
    place = plus(read_vec3(space.motions[point.a].position), 1.0, read_vec3(point.arm_a))
    normal, velocity = read_vec3(point.normal), read_vec3(point.relative_velocity)
    record_contact(
        touches, w, point.a, b, point.total_impulse[0], place, normal, velocity, 0.0, 1.0
    )
    # Also for a sleeping drone that supports a
    if b < space.motions.shape[0]:
        record_contact(
            touches, w, b, point.a, point.total_impulse[0], place, normal, velocity, 0.0, -1.0
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
    num_pairs: int,
    first: int,
    time: float,
    touches: ContactLog,
) -> int:
    """Resolve the impact of all drones that are connected to a pair by contacts (an island).

    These drones start a path segment with new velocities.

    Args:
        space: Arrays to work on; `island` and the motions of the island are written.
        world: The world.
        pairs: Rows of `PAIR`; changed.
        num_pairs: Number of pairs in use.
        first: Index of the pair whose impact it is.
        time: Time of the impact, as a fraction of the substep.
        touches: Contact log, added to.

    Returns:
        Number of drones of the island; their indices are in `space.island`.
    """
    motions = space.motions
    num_members = build_island(space, world, pairs, num_pairs, first, time)
    # A drone at the impact limit does not move by itself until the next substep
    is_clamped = False
    for m in range(num_members):
        motion = motions[space.island[m]]
        motion.impacts += 1
        if is_at_impact_limit(motion):
            remove_forces(motion, time)
            is_clamped = True
    carried_displacement = (0.0, 0.0, 0.0)
    if is_clamped:
        carried_displacement = compute_carried_displacement(
            space, world, pairs, num_pairs, num_members, time
        )
    # Build the contact manifolds of all touching pairs of the island
    most = 0
    for p in range(num_pairs):
        pairs[p].in_impact = is_pair_in_island(motions, pairs[p]) and may_touch(pairs[p], time)
        if pairs[p].in_impact:
            most += MAX_POINTS + MAX_SPECULATIVE_PASSES
    points = np.empty(most, dtype=CONTACT_POINT)
    num_points = 0
    for p in range(num_pairs):
        more = num_points
        if pairs[p].in_impact:
            more = add_contact_points(space, world, pairs[p], time, points, num_points)
        for k in range(num_points, more):
            points[k].pair = p
        pairs[p].in_impact = more > num_points
        num_points = more
    slow = _apply_restitution(space, world, num_members, points, num_points)
    num_points = _solve_resting_contacts(
        space, world, pairs, num_members, points, num_points, time, slow
    )
    for k in range(num_points):
        # Skip points that part without an impulse
        if points[k].total_impulse[0] <= 0.0 and points[k].normal_velocity >= -MIN_APPROACH_SPEED:
            continue
        b = pairs[points[k].pair].b
        _record_point(touches, space, world.w, points[k], b)
        if b < motions.shape[0] and motions[b].is_static:
            _add_load(motions[b], points[k])
    clamp_drones_at_limit(space, num_members, time, carried_displacement)
    return num_members


@kernel
def record_overlap(
    space: ContactWorkspace, world: ContactWorld, pair: np.record, touches: ContactLog
) -> None:
    """Record a pair that is in contact at the beginning of a substep, without an impulse.

    Args:
        space: Arrays to work on; the motions of the pair must be started.
        world: The world.
        pair: Row of `PAIR`; its normal is written.
        touches: Contact log, added to.
    """
    distance, normal, on_a, _ = measure_pair(space, world, pair, 0.0)
    if distance > CONTACT_DISTANCE:
        return
    place = plus(read_vec3(space.motions[pair.a].position), 1.0, on_a)
    still = (0.0, 0.0, 0.0)
    depth = max(0.0, -distance)
    record_contact(touches, world.w, pair.a, pair.b, 0.0, place, normal, still, depth, 1.0)
    if pair.b < world.scenery.first_body:
        record_contact(touches, world.w, pair.b, pair.a, 0.0, place, normal, still, depth, -1.0)
