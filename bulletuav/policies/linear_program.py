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
TOLERANCE = 1e-9
"""Tolerance of half-spaces, m/s"""
PARALLEL = 1e-8
"""Sine of the angle below which two half-spaces count as parallel"""


@func
def write_half_space(rows: np.ndarray, depth: int, k: int, vector: Vec3, bound: float) -> bool:
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
def violation(rows: np.ndarray, depth: int, k: int, v: Vec3) -> float:
    """Return the violation of half-space k by velocity v, m/s; negative inside."""
    n = vec3(rows, depth, k)
    value: float = rows[depth, k, 3] - dot(n, v)
    return value


@func
def project_on_ball(target: Vec3, centre: Vec3, radius: float, linear: bool) -> Vec3:
    """Find the point of a ball nearest to a target, or the farthest point in a direction.

    Args:
        target: The target; if `linear`, the direction, of any length.
        centre: Centre of the ball.
        radius: Radius of the ball.
        linear: Whether the objective is a direction.
    """
    direction = target if linear else plus(target, -1.0, centre)
    length = math.sqrt(dot(direction, direction))
    if length <= TOLERANCE or (length <= radius and not linear):
        return centre if linear else target
    return plus(centre, radius / length, direction)


@func
def restrict_to_boundary(
    rows: np.ndarray, frame: np.ndarray, depth: int, k: int, linear: bool
) -> int:
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
    is_point = depth == DEPTH - 2
    for j in range(k):
        other = vec3(rows, depth, j)
        # Component of the other normal within the boundary
        cosine = dot(other, n)
        rest = rows[depth, j, 3] - cosine * bound
        within_boundary = plus(other, -cosine, n)
        has_direction = write_half_space(rows, depth + 1, count, within_boundary, rest)
        if has_direction and not is_point:
            count += 1
        # Parallel, and the boundary is outside of it
        elif rest > TOLERANCE:
            return -1
    # Intersect the ball with the boundary, and project the objective on it.
    centre = plus(centre, height, n)
    target = vec3(frame, depth, 1)
    target = plus(target, (0.0 if linear else bound) - dot(n, target), n)
    cut_radius = math.sqrt(radius * radius - height * height)
    write_problem(frame, depth + 1, target, centre, cut_radius)
    return count


@func
def write_problem(frame: np.ndarray, depth: int, target: Vec3, centre: Vec3, radius: float) -> None:
    """Write the ball and the objective of a depth."""
    for axis in range(3):
        frame[depth, 0, axis] = centre[axis]
        frame[depth, 1, axis] = target[axis]
    frame[depth, 0, 3] = radius


@func
def ball_optimum(frame: np.ndarray, depth: int, linear: bool) -> Vec3:
    """Find the optimum in the ball of a depth, without half-spaces."""
    target = vec3(frame, depth, 1)
    centre = vec3(frame, depth, 0)
    radius = frame[depth, 0, 3]
    return project_on_ball(target, centre, radius, linear)


@allocating
def solve_linear_program(
    rows: np.ndarray, count: int, target: Vec3, radius: float, linear: bool
) -> tuple[int, Vec3]:
    """Solve the incremental linear program in a ball around the origin.

    If a half-space excludes the current optimum, the new optimum lies on its boundary: the same
    problem, one dimension lower. The implementation loops over depths, as numba crashes when it
    loads recursive functions from its cache (numba issue 6061).

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count]; the rest is a work buffer.
        count: Number of half-spaces.
        target: Target point; if `linear`, the direction to maximise.
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
    write_problem(frame, 0, target, (0.0, 0.0, 0.0), radius)
    best = above = ball_optimum(frame, 0, linear)
    while True:
        if k[depth] == counts[depth]:
            # All half-spaces of this depth are satisfied: return to the depth above.
            if depth == 0:
                return count, best
            depth -= 1
        elif violation(rows, depth, k[depth], best) > TOLERANCE:
            # This half-space is violated: continue on its boundary.
            if depth == 0:
                above = best
            counts[depth + 1] = restrict_to_boundary(rows, frame, depth, k[depth], linear)
            if counts[depth + 1] < 0:
                return k[0], above
            depth += 1
            k[depth] = 0
            best = ball_optimum(frame, depth, linear)
            continue
        k[depth] += 1


@kernel
def minimize_violation(
    rows: np.ndarray, scratch: np.ndarray, count: int, first: int, best: Vec3, radius: float
) -> Vec3:
    """Find the velocity that minimises the maximum violation of the half-spaces.

    If half-space i has the maximum violation, those of the others are smaller. These conditions are
    half-spaces again, in whose intersection n_i . v is maximised.

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count].
        scratch: Work buffer with the shape of `rows`.
        count: Number of half-spaces.
        first: Number of leading half-spaces that `best` satisfies.
        best: Optimum in those half-spaces, m/s.
        radius: Speed limit, m/s.

    Returns:
        The velocity, m/s.
    """
    # Maximum violation so far.
    worst = 0.0
    for i in range(first, count):
        if violation(rows, 0, i, best) <= worst + TOLERANCE:
            continue
        # Half-spaces in which no earlier half-space is violated more than this one.
        n = vec3(rows, 0, i)
        bound = rows[0, i, 3]
        fewer = 0
        for j in range(i):
            other = vec3(rows, 0, j)
            difference = plus(other, -1.0, n)
            if write_half_space(scratch, 0, fewer, difference, rows[0, j, 3] - bound):
                fewer += 1
        # Reduce the violation of this half-space as far as these permit.
        _, best = solve_linear_program(scratch, fewer, n, radius, True)
        worst = violation(rows, 0, i, best)
    return best


@kernel
def solve_velocity(
    rows: np.ndarray, scratch: np.ndarray, count: int, target: Vec3, max_speed: float
) -> Vec3:
    """Find the permitted velocity nearest to a preferred one.

    If no velocity is permitted, the result minimises the maximum violation, see
    `minimize_violation`.

    Args:
        rows: (DEPTH, M, 4) half-spaces in rows[0, :count]; the rest is a work buffer.
        scratch: Work buffer with the shape of `rows`.
        count: Number of half-spaces.
        target: Preferred velocity, m/s.
        max_speed: Speed limit, m/s.

    Returns:
        The velocity, m/s.
    """
    satisfied, best = solve_linear_program(rows, count, target, max_speed, False)
    if satisfied == count:
        return best
    return minimize_violation(rows, scratch, count, satisfied, best, max_speed)
