"""Separating planes: bound when a pair of shapes can first touch.

A plane across the present distance is either fixed, or rotates with one of the two bodies. Two
bodies that rotate together hardly move relative to a plane that rotates with them; where one body
rolls on the other, the face of the latter is the plane. The speed of any point relative to a plane
has an upper bound. Between two times, the deviation of its path from a straight line is bounded by
its maximum acceleration.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.contact.motion import (
    compute_path_rates,
    get_segment_end,
    interpolate_pose,
    read_vec3,
)
from bulletuav.contact.spin import rotate_by_fraction
from bulletuav.geometry.minkowski import shape_margin, support_point
from bulletuav.geometry.rotation import Vec3, axes, cross, dot, minus, plus, to_world
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HALF_SPACE

SeparatingPlane = tuple[float, float, float, Vec3]
"""Bounds of the motion of a pair relative to a plane.

The maximum closing speed, m per substep; how much that speed can grow, m per substep^2; the
maximum deviation of paths from straight lines over a whole substep, m; and the rotation of the
plane, rad per substep.
"""
SeparatingPlanes = tuple[SeparatingPlane, SeparatingPlane, SeparatingPlane]
"""A plane that rotates with b, one that rotates with a, and a fixed one"""
ORIGIN = (0.0, 0.0, 0.0)


@func
def _length(v: Vec3) -> float:
    return math.sqrt(dot(v, v))


@func
def measure_along_direction(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    normal: Vec3,
) -> tuple[float, Vec3, Vec3]:
    """Measure the signed distance of a pair along a direction.

    This is a lower bound of the distance of the shapes. It equals the distance if the direction is
    that of the closest features.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        a: Shape index of a drone.
        b: Index of the other shape.
        time: Fraction of the substep.
        dt: Length of the substep, s.
        normal: Unit vector from b to a; the normal of the plane if b is a half space.

    Returns:
        Signed distance (m), and the support points of a and b relative to their positions, in world
        axes.
    """
    table = scenery.table
    position_a, quaternion_a = interpolate_pose(scenery, motions, w, a, time, dt)
    position_b, quaternion_b = interpolate_pose(scenery, motions, w, b, time, dt)
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
def _bound_angular_sweep(radius: float, normal: Vec3, turn: Vec3) -> tuple[float, float]:
    """Bound the speed (m) and acceleration of any point of a rotating shape along `normal`.

    Both are per substep. A rotation about the normal moves no point along it.
    """
    across = _length(cross(normal, turn))
    if across == 0.0:
        return 0.0, 0.0
    return radius * across, radius * across * _length(turn)


@func
def bound_fixed_plane(
    radii: tuple[float, float], normal: Vec3, move: Vec3, turn_a: Vec3, turn_b: Vec3
) -> SeparatingPlane:
    """Bound the motion of a pair relative to a fixed plane.

    Args:
        radii: Bounding radii of a and b, m.
        normal: Unit vector from b to a.
        move: Displacement of a relative to b, m per substep.
        turn_a: Rotation of a, rad per substep.
        turn_b: Rotation of b, rad per substep.
    """
    bound_a, deviation_a = _bound_angular_sweep(radii[0], normal, turn_a)
    bound_b, deviation_b = _bound_angular_sweep(radii[1], normal, turn_b)
    bound = max(0.0, -dot(move, normal)) + bound_a + bound_b
    return bound, 0.0, 0.125 * (deviation_a + deviation_b), (0.0, 0.0, 0.0)


@func
def bound_rotating_plane(
    radius: float, normal: Vec3, move: Vec3, turn_a: Vec3, turn_b: Vec3, between: Vec3
) -> SeparatingPlane:
    """Bound the motion of a pair relative to a plane that rotates with b, in the frame of b.

    A point of a at r from its centre moves in that frame by u + w x r, with w = turn_a - turn_b and
    u = move - turn_b x between. By the laws of rotating frames its acceleration is
    w x (turn_a x r) + turn_b x (w x r) - turn_b x (turn_b x between) - 2 turn_b x (u + w x r).

    Args:
        radius: Bounding radius of a, m.
        normal: Unit vector from b to a.
        move: Displacement of a relative to b, m per substep.
        turn_a: Rotation of a, rad per substep.
        turn_b: Rotation of b, rad per substep.
        between: Vector from the position of b to that of a, m.
    """
    against = minus(turn_a, turn_b)
    shift = minus(move, cross(turn_b, between))
    bound = max(0.0, -dot(shift, normal)) + radius * _length(cross(against, normal))
    spin, move_length = _length(turn_b), _length(move)
    sweep_speed = radius * _length(against)
    # Include the growth of u and of the distance within the substep
    growth = sweep_speed * (_length(turn_a) + spin) + spin * spin * (_length(between) + move_length)
    growth += 2.0 * spin * (_length(shift) + spin * move_length + sweep_speed)
    return bound, growth, 0.125 * growth, turn_b


@func
def bound_planes(
    radii: tuple[float, float],
    normal: Vec3,
    move: Vec3,
    turn_a: Vec3,
    turn_b: Vec3,
    between: Vec3,
    num_planes: int,
) -> SeparatingPlanes:
    """Bound the motion of a pair relative to planes that rotate with b, with a, and a fixed one.

    Args:
        radii: Bounding radii of a and b, m.
        normal: Unit vector from b to a.
        move: Displacement of a relative to b, m per substep.
        turn_a: Rotation of a, rad per substep.
        turn_b: Rotation of b, rad per substep.
        between: Vector from the position of b to that of a, m.
        num_planes: Number of planes to compute, from the last: 1 (the fixed plane) or 3.
    """
    still = bound_fixed_plane(radii, normal, move, turn_a, turn_b)
    if num_planes == 1:
        return still, still, still
    with_b = bound_rotating_plane(radii[0], normal, move, turn_a, turn_b, between)
    back = minus(ORIGIN, normal), minus(ORIGIN, move), minus(ORIGIN, between)
    with_a = bound_rotating_plane(radii[1], back[0], back[1], turn_b, turn_a, back[2])
    return with_b, with_a, still


@func
def find_longest_plane(planes: SeparatingPlanes, distance: float) -> tuple[SeparatingPlane, float]:
    """Find the plane that separates a pair longest that is at a distance, m, from contact.

    Returns:
        The plane, and the fraction of the substep that `compute_safe_time` returns for it.
    """
    plane = planes[2]
    time = compute_safe_time(plane, distance)
    for k in range(2):
        other = compute_safe_time(planes[k], distance)
        if other > time:
            plane = planes[k]
            time = other
    return plane, time


@func
def compute_safe_time(plane: SeparatingPlane, distance: float) -> float:
    """Compute the fraction of a substep within which a distance, m, cannot close."""
    bound, growth, _, _ = plane
    return 2.0 * distance / (bound + math.sqrt(bound * bound + 2.0 * growth * distance))


@func
def rotate_normal(plane: SeparatingPlane, normal: Vec3, fraction: float) -> Vec3:
    """Return the normal of a plane after a fraction of the substep."""
    turn = plane[3]
    if turn == (0.0, 0.0, 0.0):
        return normal
    return to_world(rotate_by_fraction(turn, fraction, (0.0, 0.0, 0.0, 1.0)), normal)


@func
def find_time_apart(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    time: float,
    dt: float,
    planes: SeparatingPlanes,
    num_planes: int,
    normal: Vec3,
    distance: float,
    min_distance: float,
    step: float,
    remaining: float,
) -> float:
    """Find how long a separating plane keeps a pair apart, up to the end of the substep.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        a: Shape index of a drone.
        b: Index of the other shape.
        time: Fraction of the substep at which the search starts.
        dt: Length of the substep, s.
        planes: Bounds of the motion, see `bound_planes`.
        num_planes: Number of planes in use, from the last.
        normal: Normal of the planes at `time`, unit vector from b to a.
        distance: Distance of the pair at `time`, m; more than `min_distance`.
        min_distance: Distance that the pair must keep, m.
        step: Fraction of the substep for which the pair is already known to keep it.
        remaining: Remaining fraction of the substep.

    Returns:
        Fraction of the substep, at least `step`.
    """
    left = distance - min_distance
    for k in range(3 - num_planes, 3):
        plane = planes[k]
        deviation = plane[2]
        # Without curved paths `step` is exact
        if deviation == 0.0:
            continue
        max_span = math.sqrt(0.5 * left / deviation)
        span = remaining
        while span > step:
            ahead = rotate_normal(plane, normal, span)
            later, _, _ = measure_along_direction(scenery, motions, w, a, b, time + span, dt, ahead)
            sag = deviation * span * span
            if later >= min_distance and (
                left >= 4.0 * sag or min(distance, later) - sag >= min_distance
            ):
                step = span
                break
            # A pair that is too close there gets so along a parabola, or earlier
            part = 0.5 if later >= min_distance else 0.9 * math.sqrt(left / (distance - later))
            span = min(max_span, part * span)
    return step


@func
def compute_centre_direction(motions: np.ndarray, a: int, b: int) -> Vec3:
    """Return the unit vector from drone b to drone a.

    Returns zeros if b is no drone, or if both are at the same position.
    """
    if b >= motions.shape[0]:
        return 0.0, 0.0, 0.0
    between = minus(read_vec3(motions[a].position), read_vec3(motions[b].position))
    length = _length(between)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return between[0] / length, between[1] / length, between[2] / length


@func
def is_separated_by_plane(
    scenery: Scenery,
    motions: np.ndarray,
    w: int,
    a: int,
    b: int,
    start: float,
    start_distance: float,
    min_distance: float,
    dt: float,
    normal: Vec3,
) -> bool:
    """Check whether a single fixed plane separates a pair on its whole path.

    Args:
        scenery: All shapes.
        motions: (N,) rows of `MOTION`.
        w: Index of the world.
        a: Shape index of a drone.
        b: Index of the other shape.
        start: Fraction of the substep at which the path starts.
        start_distance: Distance that the pair must exceed at the start, m.
        min_distance: Distance that the pair must keep, m.
        dt: Length of the substep, s.
        normal: Normal of the plane, unit vector from b to a; zeros for no plane.
    """
    if dot(normal, normal) == 0.0:
        return False
    end = min(get_segment_end(scenery, motions, a), get_segment_end(scenery, motions, b))
    before, _, _ = measure_along_direction(scenery, motions, w, a, b, start, dt, normal)
    if before <= max(start_distance, min_distance):
        return False
    after, _, _ = measure_along_direction(scenery, motions, w, a, b, end, dt, normal)
    move_a, turn_a = compute_path_rates(scenery, motions, w, a, dt)
    move_b, turn_b = compute_path_rates(scenery, motions, w, b, dt)
    radii = scenery.table.radius[a], scenery.table.radius[b]
    _, _, deviation, _ = bound_fixed_plane(radii, normal, minus(move_a, move_b), turn_a, turn_b)
    return min(before, after) - deviation * (end - start) ** 2 > min_distance
