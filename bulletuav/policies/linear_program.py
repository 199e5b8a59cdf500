"""Linear programming over half-spaces of velocities and a speed limit.

The solution is the permitted velocity nearest to a preferred one. If no velocity is permitted, it
is the velocity that minimises the maximum violation.

A half-space (a, b, c, d) with unit normal n = (a, b, c) contains the velocities v with n . v >= d.
Problems are posed at several depths: in space, on the boundary plane of a half-space, on a line in
that plane, and at a point on that line. Arrays `rows` (DEPTH, M, 4) contain the half-spaces of each
depth, and arrays `frame` (DEPTH, 2, 4) the ball and the objective of each depth: centre and radius,
then the target velocity or direction.

References:
    Incremental linear programming: M. de Berg et al., Computational Geometry (2008), section 4.3,
    as used by J. van den Berg et al., Reciprocal n-body collision avoidance (2011), section 5.
"""

import math

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.rotation import Vec3, dot, plus, vec3

DEPTH = 4
"""Number of depths: space, plane, line, point"""
ROUNDING = 1e-9
"""Tolerance of half-spaces, m/s"""
PARALLEL = 1e-8
"""Sine of the angle below which two half-spaces count as parallel"""


@func
def write(rows: np.ndarray, depth: int, k: int, vector: Vec3, bound: float) -> bool:
    """Write the half-space vector . v >= bound, normalised.

    Args:
        rows: (DEPTH, M, 4) half-spaces, modified in place.
        depth: Depth of the problem.
        k: Row of the half-space.
        vector: Normal, of any length.
        bound: Bound, in m/s times the length of the normal.

    Returns:
        Whether the vector is long enough to define a direction.
    """
    length = math.sqrt(dot(vector, vector))
    for axis in range(3):
        rows[depth, k, axis] = vector[axis] / length
    rows[depth, k, 3] = bound / length
    return length > PARALLEL


@func
def missing(rows: np.ndarray, depth: int, k: int, v: Vec3) -> float:
    """Return the violation of half-space k by velocity v, m/s; negative inside."""
    n = vec3(rows, depth, k)
    lack: float = rows[depth, k, 3] - dot(n, v)
    return lack


@func
def within(wanted: Vec3, centre: Vec3, radius: float, linear: bool) -> Vec3:
    """Find the point of a ball nearest to a target, or the farthest point in a direction.

    Args:
        wanted: The target; if `linear`, the direction, of any length.
        centre: Centre of the ball.
        radius: Radius of the ball.
        linear: Whether the objective is a direction.
    """
    way = wanted if linear else plus(wanted, -1.0, centre)
    length = math.sqrt(dot(way, way))
    if length <= ROUNDING or (length <= radius and not linear):
        return centre if linear else wanted
    return plus(centre, radius / length, way)


@func
def descend(rows: np.ndarray, frame: np.ndarray, depth: int, k: int, linear: bool) -> int:
    """Restrict the problem of a depth to the boundary of its half-space k, one depth lower.

    Args:
        rows: (DEPTH, M, 4) half-spaces; those of the lower depth are written.
        frame: (DEPTH, 2, 4) balls and objectives; those of the lower depth are written.
        depth: Depth of the problem.
        k: Index of the half-space.
        linear: Whether the objective is a direction.

    Returns:
        The number of half-spaces at the lower depth; -1 if the boundary does not intersect the
        ball, or lies outside one of the half-spaces 0 to k - 1.
    """
    # Signed distance of the boundary from the centre of the ball
    n = vec3(rows, depth, k)
    bound = rows[depth, k, 3]
    centre = vec3(frame, depth, 0)
    radius = frame[depth, 0, 3]
    height = bound - dot(n, centre)
    # The boundary does not intersect the ball.
    if height > radius:
        return -1
    # Intersect the earlier half-spaces with the boundary.
    count = 0
    # At a point there are no directions left; a non-zero normal is a rounding error.
    to_point = depth == DEPTH - 2
    for j in range(k):
        other = vec3(rows, depth, j)
        # Component of the other normal within the boundary
        share = dot(other, n)
        rest = rows[depth, j, 3] - share * bound
        within_boundary = plus(other, -share, n)
        has_direction = write(rows, depth + 1, count, within_boundary, rest)
        if has_direction and not to_point:
            count += 1
        # Parallel, and the boundary is outside of it
        elif rest > ROUNDING:
            return -1
    # Intersect the ball with the boundary, and project the objective on it.
    centre = plus(centre, height, n)
    wanted = vec3(frame, depth, 1)
    wanted = plus(wanted, (0.0 if linear else bound) - dot(n, wanted), n)
    cut_radius = math.sqrt(radius * radius - height * height)
    pose(frame, depth + 1, wanted, centre, cut_radius)
    return count


@func
def pose(frame: np.ndarray, depth: int, wanted: Vec3, centre: Vec3, radius: float) -> None:
    """Write the ball and the objective of a depth."""
    for axis in range(3):
        frame[depth, 0, axis] = centre[axis]
        frame[depth, 1, axis] = wanted[axis]
    frame[depth, 0, 3] = radius


@func
def start(frame: np.ndarray, depth: int, linear: bool) -> Vec3:
    """Find the optimum in the ball of a depth, without half-spaces."""
    wanted = vec3(frame, depth, 1)
    centre = vec3(frame, depth, 0)
    radius = frame[depth, 0, 3]
    return within(wanted, centre, radius, linear)


@allocating
def nearest(
    rows: np.ndarray, count: int, wanted: Vec3, radius: float, linear: bool
) -> tuple[int, Vec3]:
    """Solve the incremental linear program in a ball around the origin.

    If a half-space excludes the current optimum, the new optimum lies on its boundary: the same
    problem, one dimension lower. The implementation loops over depths, as numba crashes when it
    loads recursive functions from its cache (numba issue 6061).

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count]; the rest is a work buffer.
        count: Number of half-spaces.
        wanted: Target point; if `linear`, the direction to maximise.
        radius: Radius of the ball.
        linear: Whether the objective is a direction.

    Returns:
        The number of leading half-spaces that are satisfied, and the optimum in these.
    """
    frame = np.empty((DEPTH, 2, 4))
    # Number of half-spaces of each depth, and index of the next one.
    counts = np.zeros(DEPTH, np.int64)
    k = np.zeros(DEPTH, np.int64)
    depth = 0
    counts[0] = count
    pose(frame, 0, wanted, (0.0, 0.0, 0.0), radius)
    best = above = start(frame, 0, linear)
    while True:
        if k[depth] == counts[depth]:
            # All half-spaces of this depth are satisfied: return to the depth above.
            if depth == 0:
                return count, best
            depth -= 1
        elif missing(rows, depth, k[depth], best) > ROUNDING:
            # This half-space is violated: continue on its boundary.
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
    """Find the velocity that minimises the maximum violation of the half-spaces.

    If half-space i has the maximum violation, those of the others are smaller. These conditions are
    half-spaces again, in whose intersection n_i . v is maximised.

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count].
        spare: Work buffer with the shape of `rows`.
        count: Number of half-spaces.
        begin: Number of leading half-spaces that `best` satisfies.
        best: Optimum in those half-spaces, m/s.
        radius: Speed limit, m/s.

    Returns:
        The velocity, m/s.
    """
    # Maximum violation so far.
    worst = 0.0
    for i in range(begin, count):
        if missing(rows, 0, i, best) <= worst + ROUNDING:
            continue
        # Half-spaces in which no earlier half-space is violated more than this one.
        n = vec3(rows, 0, i)
        bound = rows[0, i, 3]
        fewer = 0
        for j in range(i):
            other = vec3(rows, 0, j)
            difference = plus(other, -1.0, n)
            if write(spare, 0, fewer, difference, rows[0, j, 3] - bound):
                fewer += 1
        # Reduce the violation of this half-space as far as these permit.
        _, best = nearest(spare, fewer, n, radius, True)
        worst = missing(rows, 0, i, best)
    return best


@kernel
def best_velocity(
    rows: np.ndarray, spare: np.ndarray, count: int, wanted: Vec3, max_speed: float
) -> Vec3:
    """Find the permitted velocity nearest to a preferred one.

    If no velocity is permitted, the result minimises the maximum violation, see
    `minimize_violation`.

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count]; the rest is a work buffer.
        spare: Work buffer with the shape of `rows`.
        count: Number of half-spaces.
        wanted: Preferred velocity, m/s.
        max_speed: Speed limit, m/s.

    Returns:
        The velocity, m/s.
    """
    met, best = nearest(rows, count, wanted, max_speed, False)
    if met == count:
        return best
    return least_violation(rows, spare, count, met, best, max_speed)
