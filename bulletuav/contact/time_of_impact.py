"""Time of impact of a pair, by conservative advancement on exact distances.

Two bounds give a safe time step. Both hold for arbitrarily thin or fast bodies. First, no motion
closes a distance faster than a bound along the present separating direction (B. Mirtich,
Impulse-based dynamic simulation of rigid body systems, 1996). Second, between two times at which a
plane separates the pair, no point crosses the plane by more than its maximum acceleration allows;
see `bulletuav.contact.separating_planes`. At small distances, Newton's method on the distance
finishes the search. A pair that is apart after a Newton step goes back to the safe time, unless a
plane shows that there was no contact in between.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.motion import compute_path_rates, get_segment_end, interpolate_pose
from bulletuav.contact.separating_planes import (
    bound_planes,
    compute_centre_direction,
    find_longest_plane,
    find_time_apart,
    is_separated_by_plane,
    measure_along_direction,
    rotate_normal,
)
from bulletuav.geometry.closest_features import closest_features
from bulletuav.geometry.gjk import gjk_distance
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus
from bulletuav.geometry.scenery import Scenery

CONTACT_DISTANCE = 1e-4
"""Distance below which shapes are in contact, m"""
MAX_CONTACT_DISTANCE = 1.01 * CONTACT_DISTANCE
"""Distance up to which contact points count as touching, m"""
TOI_TOLERANCE = 1e-13
"""Tolerance of the distance at the time of impact, m"""
REPEATED_TOI_TOLERANCE = 1e-7
"""Tolerance for pairs that touched before in the substep, m; well below `MAX_EXTRA_PENETRATION`"""
NEWTON_DISTANCE = 1e-3
"""Distance from contact below which Newton's method is used, m"""
LOOSE_TOI_TOLERANCE = 1e-9
"""Tolerance of searches that take more than `LOOSE_AFTER_STEPS`, m"""
LOOSE_AFTER_STEPS = 1_000
"""Steps after which the tolerance is relaxed; a typical search takes five"""
MAX_TOI_STEPS = 20_000
"""Maximum number of steps of a search; grazing by a micrometre may take a thousand"""
NO_IMPACT = 2.0
"""Time of impact of a pair that does not touch"""


@func
def measure_distance(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    guess: Vec3,
    scratch: np.ndarray,
    gjk_only: bool = False,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Measure the distance of a pair at a time in the substep.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        a: Shape index of a drone.
        b: Index of the other shape.
        time: Fraction of the substep.
        dt: Length of the substep, s.
        guess: Direction of an earlier separation, or zeros.
        scratch: Work array, see `bulletuav.geometry.minkowski.make_scratch`.
        gjk_only: True to use `gjk_distance` instead of `closest_features`, see
            `find_time_of_impact`.

    Returns:
        The signed distance, m, negative for the penetration depth of an overlap. The unit normal
        from b to a. The closest points on a and b, each relative to the position of its shape. All
        in world axes.
    """
    position_a, quaternion_a = interpolate_pose(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = interpolate_pose(scenery, motions, w, b, time, dt)
    offset = minus(position_b, position_a)
    turn_a = axes(quaternion_a)
    turn_b = axes(quaternion_b)
    if gjk_only:
        return gjk_distance(scenery.table, a, turn_a, b, turn_b, offset, guess, scratch)
    return closest_features(scenery.table, a, turn_a, b, turn_b, offset, guess, scratch)


@kernel
def find_time_of_impact(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    start: float,
    target_distance: float,
    has_touched: bool,
    dt: float,
    guess: Vec3,
    scratch: np.ndarray,
    gjk_only: bool = False,
) -> tuple[float, Vec3, bool]:
    """Find the time at which the distance of a pair falls to a target distance.

    Both bodies move along their present path segments.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        a: Shape index of a drone.
        b: Index of the other shape.
        start: Fraction of the substep at which the search starts.
        target_distance: Distance at which the pair counts as touching, m.
        has_touched: True if the pair touched before in this substep; a looser tolerance is used.
        dt: Length of the substep, s.
        guess: Direction of an earlier separation, or zeros.
        scratch: Work array, see `bulletuav.geometry.minkowski.make_scratch`.
        gjk_only: True for worlds whose drones stop at a contact (`ContactWorld.stops`): measures
            with `gjk_distance` and skips the test by a separating plane, because the results of
            kinematic flights must not change, not even in the last bit.

    Returns:
        Time of impact as a fraction of the substep: `start` if the pair is that close already and
        may approach, `NO_IMPACT` if there is none. The last separating direction. Whether the pair
        was measured to be in contact at `start`; False if a plane separates it, and then also for a
        pair in contact that `has_touched`.
    """
    if not gjk_only:
        # A pair that has touched is known to be in contact
        min_start_distance = -math.inf if has_touched else MAX_CONTACT_DISTANCE
        direction = guess if dot(guess, guess) > 0.0 else compute_centre_direction(motions, a, b)
        if is_separated_by_plane(
            scenery, motions, w, a, b, start, min_start_distance, target_distance, dt, direction
        ):
            return NO_IMPACT, direction, False
    tolerance = REPEATED_TOI_TOLERANCE if has_touched else TOI_TOLERANCE
    move_a, turn_a = compute_path_rates(scenery, motions, w, a, dt)
    move_b, turn_b = compute_path_rates(scenery, motions, w, b, dt)
    move = minus(move_a, move_b)
    radii = scenery.table.radius[a], scenery.table.radius[b]
    rotates = turn_a != (0.0, 0.0, 0.0) or turn_b != (0.0, 0.0, 0.0)
    is_turning = b < motions.shape[0] or turn_b != (0.0, 0.0, 0.0)
    uses_rotating_planes = is_turning and rotates
    end = min(get_segment_end(scenery, motions, a), get_segment_end(scenery, motions, b))
    time = start
    normal = guess
    in_contact = False
    # Bracket of the impact: the last time apart, and the first time too close
    apart, overlapping = start, NO_IMPACT
    safe, leapt = start, False
    for step_number in range(MAX_TOI_STEPS):
        if step_number == LOOSE_AFTER_STEPS:
            tolerance = max(tolerance, LOOSE_TOI_TOLERANCE)
        distance, normal, on_a, on_b = measure_distance(
            scenery, motions, w, a, b, time, dt, normal, scratch, gjk_only
        )
        in_contact = in_contact or (time == start and distance <= MAX_CONTACT_DISTANCE)
        left = distance - target_distance
        remaining = end - time
        # Bound the closing speed, and the curvature of the paths
        between = plus(minus(on_b, on_a), distance, normal)
        num_planes = 3 if uses_rotating_planes and left > 0.0 else 1
        planes = bound_planes(radii, normal, move, turn_a, turn_b, between, num_planes)
        plane, step = find_longest_plane(planes, left)
        bound, growth, deviation, _ = plane
        landed, leapt = leapt and left > 0.0, False
        if landed:
            # Other points than the closest ones may have touched and parted again in between
            then = rotate_normal(plane, normal, apart - time)
            before, _, _ = measure_along_direction(scenery, motions, w, a, b, apart, dt, then)
            if before - target_distance < 4.0 * deviation * (time - apart) ** 2:
                time = safe
                continue
        if left > (bound + 0.5 * growth * remaining) * remaining:
            return NO_IMPACT, normal, in_contact
        if left <= tolerance and (time == start or left >= -tolerance):
            return (time if bound + growth > 0.0 else NO_IMPACT), normal, in_contact
        if left > 0.0:
            apart = time
            step = find_time_apart(
                scenery,
                motions,
                w,
                a,
                b,
                time,
                dt,
                planes,
                num_planes,
                normal,
                distance,
                target_distance,
                step,
                remaining,
            )
            if step >= remaining:
                return NO_IMPACT, normal, in_contact
        else:
            overlapping = time
            step = left / bound
        if left < NEWTON_DISTANCE:
            surface = minus(cross(turn_a, on_a), cross(turn_b, on_b))
            closing = -dot(move, normal) - dot(surface, normal)
            # Newton goes back from an overlap; it goes ahead only as far as there is a single root
            if closing > 0.0:
                aimed = left / closing
                leapt = left > 0.0 and step < aimed and 4.0 * deviation * aimed * aimed <= left
                safe = time + step
                if left < 0.0 or leapt:
                    step = aimed
        time = min(end, time + step)
        if overlapping < NO_IMPACT:
            # Bisect where Newton's method would oscillate, as for grazing paths
            if not apart < time < overlapping:
                time = 0.5 * (apart + overlapping)
            bracket = overlapping - apart
            if (bound + 0.5 * growth * bracket) * bracket <= tolerance:
                break
    return time, normal, in_contact
