"""The velocity nearest to a wanted one among half-spaces within a sphere of speed; the least bad one where none is left.

Incremental linear programming: M. de Berg et al., Computational Geometry (2008), section 4.3, as used by J. van den Berg et
al., Reciprocal n-body collision avoidance (2011), section 5. A half-space (a, b, c, d) of unit normal n = (a, b, c) holds
the velocities v with n . v >= d.
"""

import math

import numpy as np

from bulletuav.geometry.rotation import dot, vec3
from bulletuav.kernel import func, kernel

DEPTH = 4  # space, plane, line, point: levels of half-spaces that `nearest` needs
ROUNDING = 1e-9  # m/s by which a half-space may be missed
PARALLEL = 1e-8  # sine of the angle below which two half-spaces are parallel


@func
def along(v, scale, direction):
    """Sum v + scale direction."""
    return v[0] + scale * direction[0], v[1] + scale * direction[1], v[2] + scale * direction[2]


@func
def write(rows, depth, k, vector, bound):
    """Half-space k: vector . v >= bound, with vector of any length; returns whether it has a direction."""
    length = math.sqrt(dot(vector, vector))
    for axis in range(3):
        rows[depth, k, axis] = vector[axis] / length
    rows[depth, k, 3] = bound / length
    return length > PARALLEL


@func
def missing(rows, depth, k, v):
    """How much velocity v lacks of half-space k, m/s; negative inside."""
    return rows[depth, k, 3] - dot(vec3(rows, depth, k), v)


@func
def within(wanted, centre, radius, linear):
    """Nearest to `wanted` in the ball; or, where `linear`, the farthest along the direction `wanted`."""
    way = wanted if linear else along(wanted, -1.0, centre)
    length = math.sqrt(dot(way, way))
    if length <= ROUNDING or (length <= radius and not linear):
        return centre if linear else wanted
    return along(centre, radius / length, way)


@func
def descend(rows, frame, depth, k, linear):
    """Pose the problem of `level` on the boundary of its half-space k, one level lower; how many half-spaces it has there.

    -1 where the boundary is out of the ball, or wholly outside one of the half-spaces 0 to k - 1.
    """
    n, bound, centre, radius = (
        vec3(rows, depth, k),
        rows[depth, k, 3],
        vec3(frame, depth, 0),
        frame[depth, 0, 3],
    )
    height, count, to_point = (
        bound - dot(n, centre),
        0,
        depth == DEPTH - 2,
    )  # a point has no directions, whatever rounding says
    if height > radius:
        return -1
    for j in range(k):
        other = vec3(rows, depth, j)
        share = dot(other, n)
        rest = rows[depth, j, 3] - share * bound
        if write(rows, depth + 1, count, along(other, -share, n), rest) and not to_point:
            count += 1
        elif rest > ROUNDING:
            return -1
    centre, wanted = along(centre, height, n), vec3(frame, depth, 1)
    wanted = along(wanted, (0.0 if linear else bound) - dot(n, wanted), n)
    pose(frame, depth + 1, wanted, centre, math.sqrt(radius * radius - height * height))
    return count


@func
def pose(frame, depth, wanted, centre, radius):
    """Write the ball and the wanted point (or direction) of a level."""
    for axis in range(3):
        frame[depth, 0, axis], frame[depth, 1, axis] = centre[axis], wanted[axis]
    frame[depth, 0, 3] = radius


@func
def start(frame, depth, linear):
    """The best point of a level's ball, without half-spaces."""
    return within(vec3(frame, depth, 1), vec3(frame, depth, 0), frame[depth, 0, 3], linear)


@kernel
def nearest(rows, count, wanted, radius, linear):
    """The point nearest to `wanted` (or farthest along it) in a ball and half-spaces; returns how many of them it meets, it.

    `rows` (DEPTH, M, 4): the half-spaces in rows[0, :count], and room. Where a half-space cuts off the best point so far,
    the new one is on its boundary: the same problem, one dimension lower. A loop over levels, as numba crashes when it
    loads recursive functions from its cache (numba issue 6061).
    """
    frame, counts, k = np.empty((DEPTH, 2, 4)), np.zeros(DEPTH, np.int64), np.zeros(DEPTH, np.int64)
    depth, counts[0] = 0, count
    pose(frame, 0, wanted, (0.0, 0.0, 0.0), radius)
    best = above = start(frame, 0, linear)
    while True:
        if k[depth] == counts[depth]:
            if depth == 0:
                return count, best
            depth -= 1
        elif missing(rows, depth, k[depth], best) > ROUNDING:
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
def least_violation(rows, spare, count, begin, best, radius):
    """Velocity within `radius` that misses the half-spaces rows[0, :count] by the least, m/s, at worst.

    `best` meets those before `begin`. `spare` is room like `rows`. Where half-space i is missed the most, the others
    are missed less than it: half-spaces again, on whose common part n_i . v is to be the largest.
    """
    worst = 0.0
    for i in range(begin, count):
        if missing(rows, 0, i, best) <= worst + ROUNDING:
            continue
        n, bound, fewer = vec3(rows, 0, i), rows[0, i, 3], 0
        for j in range(i):
            if write(spare, 0, fewer, along(vec3(rows, 0, j), -1.0, n), rows[0, j, 3] - bound):
                fewer += 1
        _, best = nearest(spare, fewer, n, radius, True)
        worst = missing(rows, 0, i, best)
    return best


@kernel
def best_velocity(rows, spare, count, wanted, max_speed):
    """The velocity nearest to `wanted` within half-spaces rows[0, :count] and max_speed, or that of `least_violation`."""
    met, best = nearest(rows, count, wanted, max_speed, False)
    if met == count:
        return best
    return least_violation(rows, spare, count, met, best, max_speed)
