"""When a pair first touches: conservative advancement on exact distances.

No motion closes a gap faster than its bound, so steps of gap / bound skip nothing, however thin or
fast (B. Mirtich, Impulse-based dynamic simulation of rigid body systems, 1996). The bound is that
along the present separating direction: whatever slides or turns across it costs nothing. Where the
pair is close already, Newton's method on the distance ends the search.
"""

import math

import numpy as np

from bulletuav.contact.motion import Motions, change_rates, pose_at
from bulletuav.geometry.gjk import gap
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus
from bulletuav.geometry.scenery import Scenery
from bulletuav.kernel import func, kernel

TOUCH = 1e-4
"""Shapes that are closer touch, m"""
EXACT = 1e-11
"""Precision of the distance at which a touch is found, m"""
NEAR = 1e-3
"""Distance from a touch at which Newton's method takes over, m"""
BOLD = 4.0
"""Most that a step of Newton's method takes, in conservative steps"""
MOST_STEPS = 200
"""Most steps to a touch"""
NEVER = 2.0
"""Time of a touch that does not happen"""


@func
def gap_at(
    scenery: Scenery,
    motions: Motions,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    guess: Vec3,
    room: np.ndarray,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Measure a pair at a time in the substep; see `bulletuav.geometry.gjk.gap`."""
    position_a, quaternion_a = pose_at(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = pose_at(scenery, motions, w, b, time, dt)
    offset = minus(position_b, position_a)
    return gap(scenery.table, a, axes(quaternion_a), b, axes(quaternion_b), offset, guess, room)


@func
def _length(v: Vec3) -> float:
    """Return the length of a vector."""
    return math.sqrt(dot(v, v))


@func
def _turn_bound(radius: float, normal: Vec3, turn: Vec3) -> float:
    """Bound how far a rotation moves any point of a shape along `normal`, m."""
    bound = _length(cross(normal, turn))
    return radius * bound if bound > 0.0 else 0.0


@kernel
def touch_time(
    scenery: Scenery,
    motions: Motions,
    w: int,
    a: int,
    b: int,
    start: float,
    floor: float,
    dt: float,
    guess: Vec3,
    room: np.ndarray,
) -> tuple[float, Vec3]:
    """Find when a pair comes within a distance.

    Args:
        scenery: What stands, and all shapes.
        motions: How the drones move.
        w: The world.
        a: Number of the shape of a drone.
        b: Number of the other shape.
        start: Share of the substep from which on to look.
        floor: The distance, m.
        dt: Length of the substep, s.
        guess: Direction of an earlier separation, or zeros.
        room: See `bulletuav.geometry.gjk.make_room`.

    Returns:
        Share of the substep, `start` where they are as close already and may come closer, NEVER
        where they do not; and the direction of the last separation.
    """
    move_a, turn_a = change_rates(scenery, motions, w, a, dt)
    move_b, turn_b = change_rates(scenery, motions, w, b, dt)
    move = minus(move_a, move_b)
    time = start
    normal = guess
    for _ in range(MOST_STEPS):
        distance, normal, on_a, on_b = gap_at(scenery, motions, w, a, b, time, dt, normal, room)
        # How fast the gap can close, and how fast its closest points do approach
        bound = max(0.0, -dot(move, normal))
        bound += _turn_bound(scenery.table.radius[a], normal, turn_a)
        bound += _turn_bound(scenery.table.radius[b], normal, turn_b)
        left = distance - floor
        if left > bound * (1.0 - time):
            return NEVER, normal
        if left <= EXACT and (time == start or left >= -EXACT):
            return (time if bound > 0.0 else NEVER), normal
        step = left / bound
        if left < NEAR:
            surface = minus(cross(turn_a, on_a), cross(turn_b, on_b))
            closing = -dot(move, normal) - dot(surface, normal)
            if closing > 0.0:
                newton = left / closing
                # Back from too far by Newton alone, ahead no further than is safe to try
                step = newton if left < 0.0 or newton < BOLD * step else BOLD * step
        time += step
        if time > 1.0:
            time = 1.0
        if time < start:
            time = start
    return time, normal
