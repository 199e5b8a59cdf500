"""Search for the best velocity within half-spaces and a limit of speed.

It is the velocity nearest to a wanted one, or where none is left the one that misses the
half-spaces by the least. Incremental linear programming: M. de Berg et al., Computational
Geometry (2008), section 4.3, as used by J. van den Berg et al., Reciprocal n-body collision
avoidance (2011), section 5.

A half-space (a, b, c, d) of unit normal n = (a, b, c) holds the velocities v with n . v >= d.
Problems are posed at several depths: in space, on the plane that bounds a half-space, on a line of
that plane, and at a point of that line. Arrays `rows` (DEPTH, M, 4) hold the half-spaces of each
depth, and arrays `frame` (DEPTH, 2, 4) its ball and aim: centre and radius, then the wanted
velocity or direction.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, dot, plus, vec3

DEPTH = 4
"""Depths of problems: space, plane, line, point"""
ROUNDING = 1e-9
"""Velocity by which a half-space may be missed, m/s"""
PARALLEL = 1e-8
"""Sine of the angle below which two half-spaces are parallel"""


@func
def write(rows: np.ndarray, depth: int, k: int, vector: Vec3, bound: float) -> bool:
    """Write the half-space vector . v >= bound, with a vector of any length.

    Args:
        rows: (DEPTH, M, 4) half-spaces, changed in place.
        depth: Depth of the problem.
        k: Row of the half-space.
        vector: Its normal, of any length.
        bound: Its bound, in m/s times that length.

    Returns:
        Whether the vector is long enough to have a direction.
    """
    length = math.sqrt(dot(vector, vector))
    for axis in range(3):
        rows[depth, k, axis] = vector[axis] / length
    rows[depth, k, 3] = bound / length
    return length > PARALLEL


@func
def missing(rows: np.ndarray, depth: int, k: int, v: Vec3) -> float:
    """Compute by how much velocity v misses half-space k, m/s; negative inside."""
    n = vec3(rows, depth, k)
    lack: float = rows[depth, k, 3] - dot(n, v)
    return lack


@func
def within(wanted: Vec3, centre: Vec3, radius: float, linear: bool) -> Vec3:
    """Find the point of a ball nearest to a wanted one, or the farthest in a wanted direction.

    Args:
        wanted: The point; where `linear`, the direction, of any length.
        centre: Centre of the ball.
        radius: Radius of the ball.
        linear: Whether a direction is wanted.
    """
    way = wanted if linear else plus(wanted, -1.0, centre)
    length = math.sqrt(dot(way, way))
    if length <= ROUNDING or (length <= radius and not linear):
        return centre if linear else wanted
    return plus(centre, radius / length, way)


@func
def descend(rows: np.ndarray, frame: np.ndarray, depth: int, k: int, linear: bool) -> int:
    """Pose the problem of a depth on the boundary of its half-space k, one depth lower.

    Args:
        rows: (DEPTH, M, 4) half-spaces; those of the lower depth are written.
        frame: (DEPTH, 2, 4) balls and aims; those of the lower depth are written.
        depth: Depth of the problem.
        k: The half-space.
        linear: Whether the aim is a direction.

    Returns:
        How many half-spaces the lower depth has; -1 where the boundary is out of the ball, or
        wholly outside one of the half-spaces 0 to k - 1.
    """
    # How far the boundary is from the middle of the ball, along its normal
    n = vec3(rows, depth, k)
    bound = rows[depth, k, 3]
    centre = vec3(frame, depth, 0)
    radius = frame[depth, 0, 3]
    height = bound - dot(n, centre)
    # The boundary does not meet the ball.
    if height > radius:
        return -1
    # Cut the earlier half-spaces with the boundary.
    count = 0
    # A point has no directions, whatever rounding says.
    to_point = depth == DEPTH - 2
    for j in range(k):
        other = vec3(rows, depth, j)
        # What is left of the other's normal within the boundary
        share = dot(other, n)
        rest = rows[depth, j, 3] - share * bound
        within_boundary = plus(other, -share, n)
        has_direction = write(rows, depth + 1, count, within_boundary, rest)
        if has_direction and not to_point:
            count += 1
        # Parallel, and the whole boundary is outside of it
        elif rest > ROUNDING:
            return -1
    # Cut the ball with it, and project the aim onto it.
    centre = plus(centre, height, n)
    wanted = vec3(frame, depth, 1)
    wanted = plus(wanted, (0.0 if linear else bound) - dot(n, wanted), n)
    # A smaller ball, by Pythagoras
    cut_radius = math.sqrt(radius * radius - height * height)
    pose(frame, depth + 1, wanted, centre, cut_radius)
    return count


@func
def pose(frame: np.ndarray, depth: int, wanted: Vec3, centre: Vec3, radius: float) -> None:
    """Write the ball of a depth, and its wanted point or direction."""
    for axis in range(3):
        frame[depth, 0, axis] = centre[axis]
        frame[depth, 1, axis] = wanted[axis]
    frame[depth, 0, 3] = radius


@func
def start(frame: np.ndarray, depth: int, linear: bool) -> Vec3:
    """Find the best point of a depth's ball, without half-spaces."""
    wanted = vec3(frame, depth, 1)
    centre = vec3(frame, depth, 0)
    radius = frame[depth, 0, 3]
    return within(wanted, centre, radius, linear)


@allocating
def nearest(
    rows: np.ndarray, count: int, wanted: Vec3, radius: float, linear: bool
) -> tuple[int, Vec3]:
    """Find the best point in a ball about the origin and half-spaces.

    Where a half-space cuts off the best point so far, the new one is on its boundary: the same
    problem, one dimension lower. It is a loop over depths, as numba crashes when it loads
    recursive functions from its cache (numba issue 6061).

    Args:
        rows: (DEPTH, M, 4) the half-spaces in rows[0, :count], and room.
        count: How many half-spaces there are.
        wanted: The point to be nearest to; where `linear`, the direction to go farthest.
        radius: Radius of the ball.
        linear: Whether a direction is wanted.

    Returns:
        How many half-spaces are met, from the first on, and the best point in these.
    """
    frame = np.empty((DEPTH, 2, 4))
    # At each depth: how many half-spaces there are, and which one is next.
    counts = np.zeros(DEPTH, np.int64)
    k = np.zeros(DEPTH, np.int64)
    depth = 0
    counts[0] = count
    pose(frame, 0, wanted, (0.0, 0.0, 0.0), radius)
    best = above = start(frame, 0, linear)
    while True:
        if k[depth] == counts[depth]:
            # All half-spaces of this depth are met: the point is the best one above it, too.
            if depth == 0:
                return count, best
            depth -= 1
        elif missing(rows, depth, k[depth], best) > ROUNDING:
            # This one is missed: go on along its boundary.
            if depth == 0:
                above = best
            counts[depth + 1] = descend(rows, frame, depth, k[depth], linear)
            if counts[depth + 1] < 0:
                return k[0], above
            depth += 1
            k[depth] = 0
            best = start(frame, depth, linear)
            continue
        k[depth] += 1


@kernel
def least_violation(
    rows: np.ndarray, spare: np.ndarray, count: int, begin: int, best: Vec3, radius: float
) -> Vec3:
    """Find the velocity that misses half-spaces by the least, at worst.

    Where half-space i is missed the most, the others are missed less than it: half-spaces again,
    on whose common part n_i . v is to be the largest.

    Args:
        rows: (DEPTH, M, 4) the half-spaces in rows[0, :count].
        spare: Room like `rows`.
        count: How many half-spaces there are.
        begin: How many of them `best` meets, from the first on.
        best: The best velocity in those, m/s.
        radius: Limit of the speed, m/s.

    Returns:
        The velocity, m/s.
    """
    # How much the half-space is missed that is missed the most so far.
    worst = 0.0
    for i in range(begin, count):
        if missing(rows, 0, i, best) <= worst + ROUNDING:
            continue
        # Where each earlier half-space is missed by no more than this one.
        n = vec3(rows, 0, i)
        bound = rows[0, i, 3]
        fewer = 0
        for j in range(i):
            other = vec3(rows, 0, j)
            difference = plus(other, -1.0, n)
            if write(spare, 0, fewer, difference, rows[0, j, 3] - bound):
                fewer += 1
        # Go as far into this one as these permit.
        _, best = nearest(spare, fewer, n, radius, True)
        worst = missing(rows, 0, i, best)
    return best


@kernel
def best_velocity(
    rows: np.ndarray, spare: np.ndarray, count: int, wanted: Vec3, max_speed: float
) -> Vec3:
    """Find the velocity nearest to a wanted one, or that of `least_violation` if none is left.

    Args:
        rows: (DEPTH, M, 4) the half-spaces in rows[0, :count], and room.
        spare: Room like `rows`.
        count: How many half-spaces there are.
        wanted: The wanted velocity, m/s.
        max_speed: Limit of the speed, m/s.

    Returns:
        The velocity, m/s.
    """
    met, best = nearest(rows, count, wanted, max_speed, False)
    if met == count:
        return best
    return least_violation(rows, spare, count, met, best, max_speed)
