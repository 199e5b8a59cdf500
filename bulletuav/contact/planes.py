"""Planes that keep a pair apart, and what they tell of the time that it takes to touch.

A plane across the present distance stays as it is, or turns with one of the two. Two that turn
together hardly move against a plane that does so, too; and where one rolls on the other, the face
of that one is the plane. Points move against a plane no faster than a bound, and between two times
they get beyond it by no more than their greatest acceleration bends their ways.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.motion import change_rates, pose_at, valid_until, vector
from bulletuav.contact.spin import turned
from bulletuav.geometry.minkowski import shape_margin, support_point
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HALF_SPACE

Plane = tuple[float, float, float, Vec3]
"""How a pair moves against a plane: how fast the gap closes at most, m per substep, how much faster
that gets per substep, how far ways bend in a whole one, m, and how the plane turns, rad per substep
"""
Planes = tuple[Plane, Plane, Plane]
"""Against a plane that turns with b, one that turns with a, and one that does not turn"""
ORIGIN = (0.0, 0.0, 0.0)


@func
def _length(v: Vec3) -> float:
    """Return the length of a vector."""
    return math.sqrt(dot(v, v))


@func
def separation_along(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    normal: Vec3,
) -> tuple[float, Vec3, Vec3]:
    """Measure a pair along a direction: below its distance, unless the direction is that of it.

    Args:
        scenery: What stands, and all shapes.
        motions: (N,) rows of `MOTION`.
        w: The world.
        a: Number of the shape of a drone.
        b: Number of the other shape.
        time: Share of the substep.
        dt: Length of the substep, s.
        normal: Unit vector from b to a; that of the plane if b is a half space.

    Returns:
        Signed distance (m), and the extreme points on a and b, from their positions, world axes.
    """
    table = scenery.table
    position_a, quaternion_a = pose_at(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = pose_at(scenery, motions, w, b, time, dt)
    offset = minus(position_b, position_a)
    back = (-normal[0], -normal[1], -normal[2])
    on_a = plus(support_point(table, a, axes(quaternion_a), back), -shape_margin(table, a), normal)
    on_b = (0.0, 0.0, 0.0)
    if table.kind[b] != HALF_SPACE:
        on_b = plus(
            support_point(table, b, axes(quaternion_b), normal), shape_margin(table, b), normal
        )
    return dot(normal, minus(on_a, offset)) - dot(normal, on_b), on_a, on_b


@func
def _swing(
    radius: float,
    normal: Vec3,
    turn: Vec3,
) -> tuple[float, float]:
    """Bound how fast, m, and with which acceleration, a rotation moves a shape along `normal`.

    Both are per substep, for any of its points. A turn about the normal itself moves none.
    """
    across = _length(cross(normal, turn))
    if across == 0.0:
        return 0.0, 0.0
    return radius * across, radius * across * _length(turn)


@func
def plane_at_rest(
    radii: tuple[float, float],
    normal: Vec3,
    move: Vec3,
    turn_a: Vec3,
    turn_b: Vec3,
) -> Plane:
    """Bound how a pair moves against a plane that stays as it is.

    Args:
        radii: Of the spheres about a and b, m.
        normal: Unit vector from b to a.
        move: Displacement of a against b, m per substep.
        turn_a: Rotation of a, rad per substep.
        turn_b: Rotation of b, rad per substep.
    """
    bound_a, bend_a = _swing(radii[0], normal, turn_a)
    bound_b, bend_b = _swing(radii[1], normal, turn_b)
    bound = max(0.0, -dot(move, normal)) + bound_a + bound_b
    return bound, 0.0, 0.125 * (bend_a + bend_b), (0.0, 0.0, 0.0)


@func
def plane_turning(
    radius: float,
    normal: Vec3,
    move: Vec3,
    turn_a: Vec3,
    turn_b: Vec3,
    between: Vec3,
) -> Plane:
    """Bound how a pair moves against a plane that turns with b, in whose frame b is at rest.

    A point of a at r from its centre moves there by u + w x r, with w = turn_a - turn_b and
    u = move - turn_b x between. By the laws of moving frames its acceleration is
    w x (turn_a x r) + turn_b x (w x r) - turn_b x (turn_b x between) - 2 turn_b x (u + w x r).

    Args:
        radius: Of the sphere about a, m.
        normal: Unit vector from b to a.
        move: As in `plane_at_rest`.
        turn_a: As there.
        turn_b: As there.
        between: From the position of b to that of a, m.
    """
    against = minus(turn_a, turn_b)
    shift = minus(move, cross(turn_b, between))
    bound = max(0.0, -dot(shift, normal)) + radius * _length(cross(against, normal))
    spin, way = _length(turn_b), _length(move)
    swing = radius * _length(against)
    # With what u and the distance of both may grow to within the substep
    growth = swing * (_length(turn_a) + spin) + spin * spin * (_length(between) + way)
    growth += 2.0 * spin * (_length(shift) + spin * way + swing)
    return bound, growth, 0.125 * growth, turn_b


@func
def planes_between(
    radii: tuple[float, float],
    normal: Vec3,
    move: Vec3,
    turn_a: Vec3,
    turn_b: Vec3,
    between: Vec3,
    count: int,
) -> Planes:
    """Bound how a pair moves against planes that turn with b, with a, and not at all.

    Args:
        radii: As this and others are in `plane_at_rest`.
        normal: As there.
        move: As there.
        turn_a: As there.
        turn_b: As there.
        between: From the position of b to that of a, m.
        count: How many are wanted, the last ones: 1, or 3.
    """
    still = plane_at_rest(radii, normal, move, turn_a, turn_b)
    if count == 1:
        return still, still, still
    with_b = plane_turning(radii[0], normal, move, turn_a, turn_b, between)
    back = minus(ORIGIN, normal), minus(ORIGIN, move), minus(ORIGIN, between)
    with_a = plane_turning(radii[1], back[0], back[1], turn_b, turn_a, back[2])
    return with_b, with_a, still


@func
def longest(planes: Planes, left: float) -> tuple[Plane, float]:
    """Return the plane against which a gap of `left` metres stays open longest, and `safe_time`."""
    plane = planes[2]
    time = safe_time(plane, left)
    for k in range(2):
        other = safe_time(planes[k], left)
        if other > time:
            plane = planes[k]
            time = other
    return plane, time


@func
def safe_time(plane: Plane, left: float) -> float:
    """Return the share of the substep within which a gap does not close, of `left` metres."""
    bound, growth, _, _ = plane
    return 2.0 * left / (bound + math.sqrt(bound * bound + 2.0 * growth * left))


@func
def normal_after(plane: Plane, normal: Vec3, share: float) -> Vec3:
    """Return the normal of a plane after a share of the substep."""
    turn = plane[3]
    if turn == (0.0, 0.0, 0.0):
        return normal
    return to_world(turned(turn, share, (0.0, 0.0, 0.0, 1.0)), normal)


@func
def time_apart(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    planes: Planes,
    count: int,
    normal: Vec3,
    distance: float,
    floor: float,
    step: float,
    rest: float,
) -> float:
    """Return how long some plane keeps a pair apart: to the end, or as far as ways bend.

    Args:
        scenery: As this and others are in `touch_time`.
        motions: As there.
        w: As there.
        a: As there.
        b: As there.
        time: Share of the substep.
        dt: As there.
        planes: See `planes_between`.
        count: How many of them, the last ones.
        normal: Their unit vector at that time, from b to a.
        distance: What is between the pair then, m; more than `floor`.
        floor: Distance that it must keep, m.
        step: Share of the substep in which it is known to keep it.
        rest: What is left of the substep.

    Returns:
        Share of the substep, at least `step`.
    """
    left = distance - floor
    for k in range(3 - count, 3):
        plane = planes[k]
        bend = plane[2]
        # Without bends that is `step`
        if bend == 0.0:
            continue
        reach = math.sqrt(0.5 * left / bend)
        span = rest
        while span > step:
            ahead = normal_after(plane, normal, span)
            later, _, _ = separation_along(scenery, motions, w, a, b, time + span, dt, ahead)
            dip = bend * span * span
            if later >= floor and (left >= 4.0 * dip or min(distance, later) - dip >= floor):
                step = span
                break
            # Who is too close there comes so by a parabola, or sooner
            part = 0.5 if later >= floor else 0.9 * math.sqrt(left / (distance - later))
            span = min(reach, part * span)
    return step


@func
def line_of(motions: np.ndarray, a: int, b: int) -> Vec3:
    """Return the direction from drone b to drone a; zeros if b is none, or in the same place."""
    if b >= motions.shape[0]:
        return 0.0, 0.0, 0.0
    way = minus(vector(motions[a].position), vector(motions[b].position))
    length = _length(way)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return way[0] / length, way[1] / length, way[2] / length


@func
def is_kept_apart(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    start: float,
    least: float,
    floor: float,
    dt: float,
    normal: Vec3,
) -> bool:
    """Tell whether one plane tells already that a pair does not touch on its way.

    Args:
        scenery: As this and others are in `touch_time`.
        motions: As there.
        w: As there.
        a: As there.
        b: As there.
        start: As there.
        least: Distance that they must have at the start, m.
        floor: Distance that they must keep, m.
        dt: As there.
        normal: Unit vector across the plane, from b to a, or zeros.
    """
    if dot(normal, normal) == 0.0:
        return False
    end = min(valid_until(scenery, motions, a), valid_until(scenery, motions, b))
    before, _, _ = separation_along(scenery, motions, w, a, b, start, dt, normal)
    if before <= max(least, floor):
        return False
    after, _, _ = separation_along(scenery, motions, w, a, b, end, dt, normal)
    move_a, turn_a = change_rates(scenery, motions, w, a, dt)
    move_b, turn_b = change_rates(scenery, motions, w, b, dt)
    radii = scenery.table.radius[a], scenery.table.radius[b]
    _, _, bend, _ = plane_at_rest(radii, normal, minus(move_a, move_b), turn_a, turn_b)
    return min(before, after) - bend * (end - start) ** 2 > floor
