"""Penetration depth of two overlapping convex shapes by the expanding polytope algorithm (EPA).

A polytope inside the Minkowski difference of the shapes is expanded at its face closest to the
origin. The support of the difference along a face's normal is an upper bound of the penetration
depth: moving the shapes apart by it separates them. The result is the bound of the last face,
or the smallest bound found if the arrays are full, so it is never less than the true depth.

References:
    G. van den Bergen, Proximity queries and penetration depth computation on 3D game objects
    (2001).
"""

import math

import numpy as np

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.minkowski import (
    DISTANCE_RESULT,
    MAX_FACES,
    MAX_VERTICES,
    Mat3,
    minkowski_support,
    scratch_vec3,
)
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus

ABSOLUTE_TOLERANCE = 1e-9
"""Difference of the upper and lower bounds of the depth at which EPA has converged, m"""
RELATIVE_TOLERANCE = 1e-3
"""The same as a fraction of the depth"""
VISIBILITY_TOLERANCE = 1e-10
"""Height over a triangle above which the triangle is visible from a point, m: more than rounding
errors
"""
FIRST_FACE_ROW = MAX_VERTICES
"""First row of the triangles: normal, distance from the origin, rows of the three vertices"""
FIRST_EDGE_ROW = MAX_VERTICES + MAX_FACES
"""First row of the horizon edges: rows of the two vertices"""
UP = (0.0, 0.0, 1.0)


@func
def _most_perpendicular_axis(v: Vec3) -> Vec3:
    """Return the coordinate axis whose angle to a vector is closest to 90 degrees."""
    x = abs(v[0])
    y = abs(v[1])
    z = abs(v[2])
    if x <= y and x <= z:
        return 1.0, 0.0, 0.0
    return (0.0, 1.0, 0.0) if y <= z else (0.0, 0.0, 1.0)


@func
def _simplex_extent(scratch: np.ndarray, count: int, w: Vec3) -> float:
    """Return how far a new vertex extends a simplex of `count` vertices.

    This is the squared length (m^2) for one vertex, four times the squared area of the triangle
    (m^4) for two, and six times the volume of the tetrahedron (m^3) for three.
    """
    base = scratch_vec3(scratch, 0, 0)
    new = minus(w, base)
    if count == 1:
        return dot(new, new)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    across = cross(one, new)
    if count == 2:
        return dot(across, across)
    return abs(dot(across, minus(scratch_vec3(scratch, 2, 0), base)))


@func
def _expansion_direction(scratch: np.ndarray, count: int, m: int) -> Vec3:
    """Return the m-th direction in which to look for an independent point."""
    sign = 1.0 if m % 2 == 0 else -1.0
    if count == 1:
        return (
            sign if m // 2 == 0 else 0.0,
            sign if m // 2 == 1 else 0.0,
            sign if m // 2 == 2 else 0.0,
        )
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    if count == 2:
        across = cross(one, _most_perpendicular_axis(one))
        if m // 2 == 1:
            across = cross(one, across)
    else:
        across = cross(one, minus(scratch_vec3(scratch, 2, 0), base))
    return sign * across[0], sign * across[1], sign * across[2]


@func
def _expand_to_tetrahedron(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3Like,
    count: int,
    scratch: np.ndarray,
) -> int:
    """Add support points to the simplex until four span a volume; return the number of points."""
    while count < 4:
        # Of the support points to all sides, use the one that increases the extent most
        best = (0.0, 0.0, 0.0)
        most = 0.0
        for m in range(8 - 2 * count):
            d = _expansion_direction(scratch, count, m)
            if dot(d, d) == 0.0:
                continue
            w = minkowski_support(table, a, rotation_a, b, rotation_b, offset, d, scratch, count)
            wide = _simplex_extent(scratch, count, w)
            if wide > most:
                most = wide
                best = d
        if most == 0.0:
            return count
        minkowski_support(table, a, rotation_a, b, rotation_b, offset, best, scratch, count)
        count += 1
    return count


@func
def _write_face(scratch: np.ndarray, row: int, i: int, j: int, k: int) -> None:
    """Write the normal, distance from the origin and vertices of a triangle to a row.

    The vertices i, j, k are counterclockwise seen from outside. The distance of a degenerate
    triangle is inf.
    """
    base = scratch_vec3(scratch, i, 0)
    normal = cross(
        minus(scratch_vec3(scratch, j, 0), base), minus(scratch_vec3(scratch, k, 0), base)
    )
    size = math.sqrt(dot(normal, normal))
    # A degenerate triangle is never the closest one
    scratch[row, 3] = np.inf
    if size > 0.0:
        for n in range(3):
            scratch[row, n] = normal[n] / size
        scratch[row, 3] = dot(scratch_vec3(scratch, row, 0), base)
    scratch[row, 4] = i
    scratch[row, 5] = j
    scratch[row, 6] = k


@func
def _toggle_horizon_edge(scratch: np.ndarray, edges: int, i: float, j: float) -> int:
    """Add an edge to the horizon, or remove the opposite edge; return the number of edges."""
    for row in range(FIRST_EDGE_ROW, FIRST_EDGE_ROW + edges):
        if scratch[row, 0] == j and scratch[row, 1] == i:
            last = FIRST_EDGE_ROW + edges - 1
            scratch[row, 0] = scratch[last, 0]
            scratch[row, 1] = scratch[last, 1]
            return edges - 1
    scratch[FIRST_EDGE_ROW + edges, 0] = i
    scratch[FIRST_EDGE_ROW + edges, 1] = j
    return edges + 1


@func
def _expand_polytope(scratch: np.ndarray, faces: int, new: int) -> int:
    """Replace the triangles that are visible from a new vertex by triangles to this vertex.

    Returns:
        The number of triangles; 0 if there would be more than MAX_FACES.
    """
    w = scratch_vec3(scratch, new, 0)
    edges = 0
    row = FIRST_FACE_ROW
    while row < FIRST_FACE_ROW + faces:
        if dot(scratch_vec3(scratch, row, 0), w) - scratch[row, 3] > VISIBILITY_TOLERANCE:
            edges = _toggle_horizon_edge(scratch, edges, scratch[row, 4], scratch[row, 5])
            edges = _toggle_horizon_edge(scratch, edges, scratch[row, 5], scratch[row, 6])
            edges = _toggle_horizon_edge(scratch, edges, scratch[row, 6], scratch[row, 4])
            # Fill the row of the removed triangle with the last one
            faces -= 1
            for k in range(7):
                scratch[row, k] = scratch[FIRST_FACE_ROW + faces, k]
        else:
            row += 1
    if faces + edges > MAX_FACES:
        return 0
    for edge in range(FIRST_EDGE_ROW, FIRST_EDGE_ROW + edges):
        _write_face(
            scratch, FIRST_FACE_ROW + faces, int(scratch[edge, 0]), int(scratch[edge, 1]), new
        )
        faces += 1
    return faces


@func
def _make_tetrahedron(scratch: np.ndarray) -> int:
    """Write the four triangles of the first four vertices; return their number."""
    base = scratch_vec3(scratch, 0, 0)
    one = minus(scratch_vec3(scratch, 1, 0), base)
    two = minus(scratch_vec3(scratch, 2, 0), base)
    inside = dot(cross(one, two), minus(scratch_vec3(scratch, 3, 0), base)) < 0.0
    j, k = (1, 2) if inside else (2, 1)
    _write_face(scratch, FIRST_FACE_ROW, 0, j, k)
    _write_face(scratch, FIRST_FACE_ROW + 1, 0, k, 3)
    _write_face(scratch, FIRST_FACE_ROW + 2, k, j, 3)
    _write_face(scratch, FIRST_FACE_ROW + 3, j, 0, 3)
    return 4


@func
def _closest_face(scratch: np.ndarray, faces: int) -> int:
    """Return the row of the triangle whose plane is closest to the origin."""
    best = FIRST_FACE_ROW
    for row in range(FIRST_FACE_ROW + 1, FIRST_FACE_ROW + faces):
        if scratch[row, 3] < scratch[best, 3]:
            best = row
    return best


@func
def _barycentric_weights(scratch: np.ndarray, i: int, j: int, k: int, foot: Vec3) -> Vec3:
    """Return the barycentric weights of a point in the plane of a triangle, clamped at 0."""
    p = scratch_vec3(scratch, i, 0)
    q = scratch_vec3(scratch, j, 0)
    r = scratch_vec3(scratch, k, 0)
    normal = cross(minus(q, p), minus(r, p))
    x = max(dot(cross(minus(q, foot), minus(r, foot)), normal), 0.0)
    y = max(dot(cross(minus(r, foot), minus(p, foot)), normal), 0.0)
    z = max(dot(cross(minus(p, foot), minus(q, foot)), normal), 0.0)
    whole = x + y + z
    if whole == 0.0:
        return 1.0, 0.0, 0.0
    return x / whole, y / whole, z / whole


@func
def _interpolate_face(
    scratch: np.ndarray, i: int, j: int, k: int, weights: Vec3, column: int
) -> Vec3:
    """Return the barycentric mean of three columns over the three vertices of a triangle.

    Args:
        scratch: Scratch array of `make_scratch`.
        i: Row of the first vertex.
        j: Row of the second vertex.
        k: Row of the third vertex.
        weights: Barycentric weights.
        column: First of the three columns: 0 for the difference, 3 for the point on a, 6 for that
            on b.
    """
    mean = plus((0.0, 0.0, 0.0), weights[0], scratch_vec3(scratch, i, column))
    mean = plus(mean, weights[1], scratch_vec3(scratch, j, column))
    return plus(mean, weights[2], scratch_vec3(scratch, k, column))


@func
def _find_projection_face(scratch: np.ndarray, faces: int, face: int) -> int:
    """Return the row of the triangle that contains the origin's projection on a face's plane.

    Several triangles may lie in the plane of one flat face of the Minkowski difference, and any of
    them may have been found first.
    """
    lower = scratch[face, 3]
    foot = plus((0.0, 0.0, 0.0), lower, scratch_vec3(scratch, face, 0))
    best = face
    min_distance = np.inf
    for row in range(FIRST_FACE_ROW, FIRST_FACE_ROW + faces):
        if scratch[row, 3] - lower <= ABSOLUTE_TOLERANCE:
            i = int(scratch[row, 4])
            j = int(scratch[row, 5])
            k = int(scratch[row, 6])
            difference = minus(
                _interpolate_face(
                    scratch, i, j, k, _barycentric_weights(scratch, i, j, k, foot), 0
                ),
                foot,
            )
            outside = dot(difference, difference)
            if outside < min_distance:
                min_distance = outside
                best = row
    return best


@deferred(DISTANCE_RESULT)
@kernel
def epa_penetration(
    table: ShapeTable,
    a: int,
    rotation_a: Mat3,
    b: int,
    rotation_b: Mat3,
    offset: Vec3,
    count: int,
    scratch: np.ndarray,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Compute the penetration depth of two shapes that overlap or touch.

    The depth is that of the cores of the shapes: the core of a sphere is its centre. Callers add
    the margins, see `shape_margin`.

    Args:
        table: The shapes.
        a: Index of the first shape.
        rotation_a: Axes of the first shape.
        b: Index of the second shape.
        rotation_b: Axes of the second shape.
        offset: Position of b minus that of a, world axes, m.
        count: Number of points of the Minkowski difference in the first rows of the scratch array.
        scratch: Scratch array of `make_scratch`.

    Returns:
        The same as `gjk_distance`: the negative depth, the unit normal from b to a, and the closest
        points. The depth exceeds the true one by at most ABSOLUTE_TOLERANCE plus
        RELATIVE_TOLERANCE times the depth, unless the polytope reaches MAX_VERTICES or MAX_FACES.
        The distance of the points along the normal has about the same error.
    """
    count = _expand_to_tetrahedron(table, a, rotation_a, b, rotation_b, offset, count, scratch)
    if count < 4:
        # Two spheres with the same centre
        return 0.0, UP, scratch_vec3(scratch, 0, 3), scratch_vec3(scratch, 0, 6)
    faces = _make_tetrahedron(scratch)
    depth_bound = np.inf
    outward = UP
    i, j, k = 0, 1, 2
    for new in range(count, MAX_VERTICES):
        face = _closest_face(scratch, faces)
        normal = scratch_vec3(scratch, face, 0)
        lower = scratch[face, 3]
        against = (-normal[0], -normal[1], -normal[2])
        w = minkowski_support(table, a, rotation_a, b, rotation_b, offset, against, scratch, new)
        # Moving the shapes apart by this much along the normal separates them
        upper = dot(normal, w)
        done = upper - lower <= ABSOLUTE_TOLERANCE + RELATIVE_TOLERANCE * abs(upper)
        if done:
            face = _find_projection_face(scratch, faces, face)
        if upper < depth_bound or done:
            depth_bound = upper
            outward = normal
            i = int(scratch[face, 4])
            j = int(scratch[face, 5])
            k = int(scratch[face, 6])
        if done:
            break
        faces = _expand_polytope(scratch, faces, new)
        if faces == 0:
            break
    weights = _barycentric_weights(scratch, i, j, k, plus((0.0, 0.0, 0.0), depth_bound, outward))
    on_a = _interpolate_face(scratch, i, j, k, weights, 3)
    on_b = _interpolate_face(scratch, i, j, k, weights, 6)
    return -depth_bound, (-outward[0], -outward[1], -outward[2]), on_a, on_b
