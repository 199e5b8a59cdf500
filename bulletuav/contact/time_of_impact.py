"""When a pair first touches: conservative advancement on exact distances.

Two bounds tell how far it is safe to go; both hold however thin or fast things are. No motion
closes a gap faster than a bound along the present separating direction (B. Mirtich, Impulse-based
dynamic simulation of rigid body systems, 1996). And between two times at which a plane separates
the pair, no point can get beyond it by more than its greatest acceleration bends its way; see
`bulletuav.contact.separating_planes`. Where the pair is close already, Newton's method on the distance ends
the search; who is apart after such a leap goes back unless a plane tells that there was no touch on
the way.
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
from bulletuav.geometry.gjk import gap
from bulletuav.geometry.nearest import nearest
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus
from bulletuav.geometry.scenery import Scenery

CONTACT_DISTANCE = 1e-4
"""Shapes that are closer touch, m"""
MAX_CONTACT_DISTANCE = 1.01 * CONTACT_DISTANCE
"""Distance up to which points are in touch, m"""
TOI_TOLERANCE = 1e-13
"""Precision of the distance at which a touch is found, m"""
REPEATED_TOI_TOLERANCE = 1e-7
"""The same of shapes that touched already, m; well below `SLIP` in `points`"""
NEWTON_DISTANCE = 1e-3
"""Distance from a touch at which Newton's method takes over, m"""
LOOSE_TOI_TOLERANCE = 1e-9
"""The same for ways that take more than `LOOSE_AFTER_STEPS`, m"""
LOOSE_AFTER_STEPS = 1_000
"""Steps after which nanometres do not matter any more; mostly a search takes five"""
MAX_TOI_STEPS = 20_000
"""Most steps to a touch; who grazes by a micrometre may take a thousand"""
NO_IMPACT = 2.0
"""Time of a touch that does not happen"""


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
    """Measure a pair at a time in the substep, with `nearest`, or `gap` if it is to be plain."""
    position_a, quaternion_a = interpolate_pose(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = interpolate_pose(scenery, motions, w, b, time, dt)
    offset = minus(position_b, position_a)
    turn_a = axes(quaternion_a)
    turn_b = axes(quaternion_b)
    if gjk_only:
        return gap(scenery.table, a, turn_a, b, turn_b, offset, guess, scratch)
    return nearest(scenery.table, a, turn_a, b, turn_b, offset, guess, scratch)


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
    """Find when a pair comes within a distance, while both fly on straight.

    Args:
        scenery: What stands, and all shapes.
        motions: (N,) rows of `MOTION`.
        w: The world.
        a: Number of the shape of a drone.
        b: Number of the other shape.
        start: Share of the substep from which on to look.
        floor: The distance, m.
        held: Whether they touched already in this substep, so that no exact time is needed.
        dt: Length of the substep, s.
        guess: Direction of an earlier separation, or zeros.
        room: See `bulletuav.geometry.gjk.make_room`.
        plain: Whether `gap` measures, with bits that kinematic flights keep.

    Returns:
        Share of the substep, `start` where they are as close already and may come closer, NEVER
        where they do not; the direction of the last separation; and whether they are in touch at
        `start`.
    """
    if not gjk_only:
        # Of a pair that is held it is known that it is in touch
        least = -math.inf if has_touched else MAX_CONTACT_DISTANCE
        across = guess if dot(guess, guess) > 0.0 else compute_centre_direction(motions, a, b)
        if is_separated_by_plane(
            scenery, motions, w, a, b, start, least, target_distance, dt, across
        ):
            return NO_IMPACT, across, False
    exact = REPEATED_TOI_TOLERANCE if has_touched else TOI_TOLERANCE
    move_a, turn_a = compute_path_rates(scenery, motions, w, a, dt)
    move_b, turn_b = compute_path_rates(scenery, motions, w, b, dt)
    move = minus(move_a, move_b)
    radii = scenery.table.radius[a], scenery.table.radius[b]
    turns = b < motions.shape[0] and (turn_a != (0.0, 0.0, 0.0) or turn_b != (0.0, 0.0, 0.0))
    end = min(get_segment_end(scenery, motions, a), get_segment_end(scenery, motions, b))
    time = start
    normal = guess
    in_contact = False
    # The touch is between a time at which they were apart and one at which they were too close
    apart, close = start, NO_IMPACT
    safe, leapt = start, False
    for step_number in range(MAX_TOI_STEPS):
        if step_number == LOOSE_AFTER_STEPS:
            exact = max(exact, LOOSE_TOI_TOLERANCE)
        distance, normal, on_a, on_b = measure_distance(
            scenery, motions, w, a, b, time, dt, normal, scratch, gjk_only
        )
        in_contact = in_contact or (time == start and distance <= MAX_CONTACT_DISTANCE)
        left = distance - target_distance
        rest = end - time
        # How fast the gap can close, and how far ways bend in between
        between = plus(minus(on_b, on_a), distance, normal)
        count = 3 if turns and left > 0.0 else 1
        planes = bound_planes(radii, normal, move, turn_a, turn_b, between, count)
        plane, step = find_longest_plane(planes, left)
        bound, growth, bend, _ = plane
        landed, leapt = leapt and left > 0.0, False
        if landed:
            # Others than the nearest points may have touched on the way, and parted again
            then = rotate_normal(plane, normal, apart - time)
            before, _, _ = measure_along_direction(scenery, motions, w, a, b, apart, dt, then)
            if before - target_distance < 4.0 * bend * (time - apart) ** 2:
                time = safe
                continue
        if left > (bound + 0.5 * growth * rest) * rest:
            return NO_IMPACT, normal, in_contact
        if left <= exact and (time == start or left >= -exact):
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
                count,
                normal,
                distance,
                target_distance,
                step,
                rest,
            )
            if step >= rest:
                return NO_IMPACT, normal, in_contact
        else:
            close = time
            step = left / bound
        if left < NEWTON_DISTANCE:
            surface = minus(cross(turn_a, on_a), cross(turn_b, on_b))
            closing = -dot(move, normal) - dot(surface, normal)
            # Back from too far by Newton alone; ahead as far as there is but one touch
            if closing > 0.0:
                aimed = left / closing
                leapt = left > 0.0 and step < aimed and 4.0 * bend * aimed * aimed <= left
                safe = time + step
                if left < 0.0 or leapt:
                    step = aimed
        time = min(end, time + step)
        if close < NO_IMPACT:
            # Newton's method may go back and forth for ever where a way only just grazes
            if not apart < time < close:
                time = 0.5 * (apart + close)
            bracket = close - apart
            if (bound + 0.5 * growth * bracket) * bracket <= exact:
                break
    return time, normal, in_contact
