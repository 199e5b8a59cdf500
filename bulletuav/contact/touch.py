"""When a pair first touches: conservative advancement on exact distances.

Two bounds tell how far it is safe to go; both hold however thin or fast things are. No motion
closes a gap faster than a bound along the present separating direction (B. Mirtich, Impulse-based
dynamic simulation of rigid body systems, 1996). And between two times at which a plane separates
the pair, no point can get beyond it by more than its greatest acceleration bends its way; see
`bulletuav.contact.planes`. Where the pair is close already, Newton's method on the distance ends
the search; who is apart after such a leap goes back unless a plane tells that there was no touch on
the way.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func, kernel
from bulletuav.contact.motion import change_rates, pose_at, valid_until
from bulletuav.contact.planes import (
    is_kept_apart,
    line_of,
    longest,
    normal_after,
    planes_between,
    separation_along,
    time_apart,
)
from bulletuav.geometry.closest_features import closest_features
from bulletuav.geometry.gjk import gjk_distance
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus
from bulletuav.geometry.scenery import Scenery

TOUCH = 1e-4
"""Shapes that are closer touch, m"""
IN_TOUCH = 1.01 * TOUCH
"""Distance up to which points are in touch, m"""
EXACT = 1e-13
"""Precision of the distance at which a touch is found, m"""
ROUGH = 1e-7
"""The same of shapes that touched already, m; well below `SLIP` in `points`"""
NEAR = 1e-3
"""Distance from a touch at which Newton's method takes over, m"""
NEARLY = 1e-9
"""The same for ways that take more than `MANY_STEPS`, m"""
MANY_STEPS = 1_000
"""Steps after which nanometres do not matter any more; mostly a search takes five"""
MOST_STEPS = 20_000
"""Most steps to a touch; who grazes by a micrometre may take a thousand"""
NEVER = 2.0
"""Time of a touch that does not happen"""


@func
def gap_at(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    guess: Vec3,
    room: np.ndarray,
    plain: bool = False,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Measure a pair at a time in the substep, by `gjk_distance` if plain or `closest_features`."""
    position_a, quaternion_a = pose_at(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = pose_at(scenery, motions, w, b, time, dt)
    offset = minus(position_b, position_a)
    turn_a = axes(quaternion_a)
    turn_b = axes(quaternion_b)
    if plain:
        return gjk_distance(scenery.table, a, turn_a, b, turn_b, offset, guess, room)
    return closest_features(scenery.table, a, turn_a, b, turn_b, offset, guess, room)


@kernel
def touch_time(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    start: float,
    floor: float,
    held: bool,
    dt: float,
    guess: Vec3,
    room: np.ndarray,
    plain: bool = False,
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
        plain: Whether `gjk_distance` measures, with bits that kinematic flights keep.

    Returns:
        Share of the substep, `start` where they are as close already and may come closer, NEVER
        where they do not; the direction of the last separation; and whether they are in touch at
        `start`.
    """
    if not plain:
        # Of a pair that is held it is known that it is in touch
        least = -math.inf if held else IN_TOUCH
        across = guess if dot(guess, guess) > 0.0 else line_of(motions, a, b)
        if is_kept_apart(scenery, motions, w, a, b, start, least, floor, dt, across):
            return NEVER, across, False
    exact = ROUGH if held else EXACT
    move_a, turn_a = change_rates(scenery, motions, w, a, dt)
    move_b, turn_b = change_rates(scenery, motions, w, b, dt)
    move = minus(move_a, move_b)
    radii = scenery.table.radius[a], scenery.table.radius[b]
    turns = b < motions.shape[0] and (turn_a != (0.0, 0.0, 0.0) or turn_b != (0.0, 0.0, 0.0))
    end = min(valid_until(scenery, motions, a), valid_until(scenery, motions, b))
    time = start
    normal = guess
    near = False
    # The touch is between a time at which they were apart and one at which they were too close
    apart, close = start, NEVER
    safe, leapt = start, False
    for step_number in range(MOST_STEPS):
        if step_number == MANY_STEPS:
            exact = max(exact, NEARLY)
        distance, normal, on_a, on_b = gap_at(
            scenery, motions, w, a, b, time, dt, normal, room, plain
        )
        near = near or (time == start and distance <= IN_TOUCH)
        left = distance - floor
        rest = end - time
        # How fast the gap can close, and how far ways bend in between
        between = plus(minus(on_b, on_a), distance, normal)
        count = 3 if turns and left > 0.0 else 1
        planes = planes_between(radii, normal, move, turn_a, turn_b, between, count)
        plane, step = longest(planes, left)
        bound, growth, bend, _ = plane
        landed, leapt = leapt and left > 0.0, False
        if landed:
            # Others than the nearest points may have touched on the way, and parted again
            then = normal_after(plane, normal, apart - time)
            before, _, _ = separation_along(scenery, motions, w, a, b, apart, dt, then)
            if before - floor < 4.0 * bend * (time - apart) ** 2:
                time = safe
                continue
        if left > (bound + 0.5 * growth * rest) * rest:
            return NEVER, normal, near
        if left <= exact and (time == start or left >= -exact):
            return (time if bound + growth > 0.0 else NEVER), normal, near
        if left > 0.0:
            apart = time
            step = time_apart(
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
                floor,
                step,
                rest,
            )
            if step >= rest:
                return NEVER, normal, near
        else:
            close = time
            step = left / bound
        if left < NEAR:
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
        if close < NEVER:
            # Newton's method may go back and forth for ever where a way only just grazes
            if not apart < time < close:
                time = 0.5 * (apart + close)
            bracket = close - apart
            if (bound + 0.5 * growth * bracket) * bracket <= exact:
                break
    return time, normal, near
