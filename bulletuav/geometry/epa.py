"""Depth of an overlap of two convex shapes by the expanding polytope algorithm (EPA).

A polytope inside the difference of the shapes grows, face by face, where it is nearest to the
origin (G. van den Bergen, Proximity queries and penetration depth computation on 3D game objects,
2001). How far the shapes reach along a face's normal is a depth that parts them in any case. That
of the last face is returned: never less than the true depth.
"""

import math

import numpy as np

from bulletuav.compiled.deferred import deferred
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.minkowski import (
    ANSWER,
    MOST_FACES,
    MOST_VERTICES,
    Turn,
    put_difference,
    row_point,
)
from bulletuav.geometry.rotation import Vec3, Vec3Like, cross, dot, minus, plus

EXACT = 1e-9
"""Difference of the bounds of a depth at which EPA is done, m"""
RELATIVE = 1e-3
"""The same as a share of the depth"""
BEYOND = 1e-10
"""Height over a triangle above which it sees a point, m: more than rounding makes"""
FACES = MOST_VERTICES
"""First row of the triangles: normal, distance from the origin, three rows of points"""
EDGES = MOST_VERTICES + MOST_FACES
"""First row of the edges of a hole: two rows of points"""
UP = (0.0, 0.0, 1.0)


@func
def _least_axis(v: Vec3) -> Vec3:
    """Return the axis of the world that is farthest from being along a vector."""
    x = abs(v[0])
    y = abs(v[1])
    z = abs(v[2])
    if x <= y and x <= z:
        return 1.0, 0.0, 0.0
    return (0.0, 1.0, 0.0) if y <= z else (0.0, 0.0, 1.0)


@func
def _spread(room: np.ndarray, count: int, w: Vec3) -> float:
    """Return how far a point is from the line or the plane of others, times their size."""
    base = row_point(room, 0, 0)
    new = minus(w, base)
    if count == 1:
        return dot(new, new)
    one = minus(row_point(room, 1, 0), base)
    across = cross(one, new)
    if count == 2:
        return dot(across, across)
    return abs(dot(across, minus(row_point(room, 2, 0), base)))


@func
def _way_out(room: np.ndarray, count: int, m: int) -> Vec3:
    """Return the m-th direction in which to look for a point off the first 1 to 3."""
    sign = 1.0 if m % 2 == 0 else -1.0
    if count == 1:
        return (
            sign if m // 2 == 0 else 0.0,
            sign if m // 2 == 1 else 0.0,
            sign if m // 2 == 2 else 0.0,
        )
    base = row_point(room, 0, 0)
    one = minus(row_point(room, 1, 0), base)
    if count == 2:
        across = cross(one, _least_axis(one))
        if m // 2 == 1:
            across = cross(one, across)
    else:
        across = cross(one, minus(row_point(room, 2, 0), base))
    return sign * across[0], sign * across[1], sign * across[2]


@func
def _widen(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3Like,
    count: int,
    room: np.ndarray,
) -> int:
    """Add points to the first ones until four span a volume; return how many there are."""
    while count < 4:
        # Of the points farthest out to all sides, take the one that widens most
        best = (0.0, 0.0, 0.0)
        most = 0.0
        for m in range(8 - 2 * count):
            d = _way_out(room, count, m)
            if dot(d, d) == 0.0:
                continue
            w = put_difference(table, a, turn_a, b, turn_b, offset, d, room, count)
            wide = _spread(room, count, w)
            if wide > most:
                most = wide
                best = d
        if most == 0.0:
            return count
        put_difference(table, a, turn_a, b, turn_b, offset, best, room, count)
        count += 1
    return count


@func
def _put_face(room: np.ndarray, row: int, i: int, j: int, k: int) -> None:
    """Put a triangle into a row: its points turn left seen from outside."""
    base = row_point(room, i, 0)
    normal = cross(minus(row_point(room, j, 0), base), minus(row_point(room, k, 0), base))
    size = math.sqrt(dot(normal, normal))
    # A flat triangle is never the nearest
    room[row, 3] = np.inf
    if size > 0.0:
        for n in range(3):
            room[row, n] = normal[n] / size
        room[row, 3] = dot(row_point(room, row, 0), base)
    room[row, 4] = i
    room[row, 5] = j
    room[row, 6] = k


@func
def _put_edge(room: np.ndarray, edges: int, i: float, j: float) -> int:
    """Add an edge of a hole, or cancel it against that of the triangle beyond."""
    for row in range(EDGES, EDGES + edges):
        if room[row, 0] == j and room[row, 1] == i:
            last = EDGES + edges - 1
            room[row, 0] = room[last, 0]
            room[row, 1] = room[last, 1]
            return edges - 1
    room[EDGES + edges, 0] = i
    room[EDGES + edges, 1] = j
    return edges + 1


@func
def _grow(room: np.ndarray, faces: int, new: int) -> int:
    """Replace the triangles that see a new point by those to it.

    Returns:
        How many triangles there are; 0 if too many.
    """
    w = row_point(room, new, 0)
    edges = 0
    row = FACES
    while row < FACES + faces:
        if dot(row_point(room, row, 0), w) - room[row, 3] > BEYOND:
            edges = _put_edge(room, edges, room[row, 4], room[row, 5])
            edges = _put_edge(room, edges, room[row, 5], room[row, 6])
            edges = _put_edge(room, edges, room[row, 6], room[row, 4])
            # The last triangle takes the row of the one that goes
            faces -= 1
            for k in range(7):
                room[row, k] = room[FACES + faces, k]
        else:
            row += 1
    if faces + edges > MOST_FACES:
        return 0
    for edge in range(EDGES, EDGES + edges):
        _put_face(room, FACES + faces, int(room[edge, 0]), int(room[edge, 1]), new)
        faces += 1
    return faces


@func
def _first_faces(room: np.ndarray) -> int:
    """Put the four triangles of the first four points; return how many there are."""
    base = row_point(room, 0, 0)
    one = minus(row_point(room, 1, 0), base)
    two = minus(row_point(room, 2, 0), base)
    inside = dot(cross(one, two), minus(row_point(room, 3, 0), base)) < 0.0
    j, k = (1, 2) if inside else (2, 1)
    _put_face(room, FACES, 0, j, k)
    _put_face(room, FACES + 1, 0, k, 3)
    _put_face(room, FACES + 2, k, j, 3)
    _put_face(room, FACES + 3, j, 0, 3)
    return 4


@func
def _nearest_face(room: np.ndarray, faces: int) -> int:
    """Return the row of the triangle whose plane is nearest to the origin."""
    best = FACES
    for row in range(FACES + 1, FACES + faces):
        if room[row, 3] < room[best, 3]:
            best = row
    return best


@func
def _shares(room: np.ndarray, i: int, j: int, k: int, foot: Vec3) -> Vec3:
    """Return the weights of the corners of a triangle at a point of its plane, none negative."""
    p = row_point(room, i, 0)
    q = row_point(room, j, 0)
    r = row_point(room, k, 0)
    normal = cross(minus(q, p), minus(r, p))
    x = max(dot(cross(minus(q, foot), minus(r, foot)), normal), 0.0)
    y = max(dot(cross(minus(r, foot), minus(p, foot)), normal), 0.0)
    z = max(dot(cross(minus(p, foot), minus(q, foot)), normal), 0.0)
    whole = x + y + z
    if whole == 0.0:
        return 1.0, 0.0, 0.0
    return x / whole, y / whole, z / whole


@func
def _mean(room: np.ndarray, i: int, j: int, k: int, shares: Vec3, column: int) -> Vec3:
    """Return a weighted mean of three columns of three rows."""
    mean = plus((0.0, 0.0, 0.0), shares[0], row_point(room, i, column))
    mean = plus(mean, shares[1], row_point(room, j, column))
    return plus(mean, shares[2], row_point(room, k, column))


@func
def _foot_face(room: np.ndarray, faces: int, face: int) -> int:
    """Return the row of the triangle that the foot of the origin on the plane of one is in.

    Triangles of one flat face of the difference lie in one plane: any of them may come first.
    """
    lower = room[face, 3]
    foot = plus((0.0, 0.0, 0.0), lower, row_point(room, face, 0))
    best = face
    least = np.inf
    for row in range(FACES, FACES + faces):
        if room[row, 3] - lower <= EXACT:
            i = int(room[row, 4])
            j = int(room[row, 5])
            k = int(room[row, 6])
            way = minus(_mean(room, i, j, k, _shares(room, i, j, k, foot), 0), foot)
            outside = dot(way, way)
            if outside < least:
                least = outside
                best = row
    return best


@deferred(ANSWER)
@kernel
def overlap(
    table: ShapeTable,
    a: int,
    turn_a: Turn,
    b: int,
    turn_b: Turn,
    offset: Vec3,
    count: int,
    room: np.ndarray,
) -> tuple[float, Vec3, Vec3, Vec3]:
    """Return `gap` of two shapes that overlap or touch, spheres as their centres.

    Args:
        table: The shapes.
        a: Number of the first shape.
        turn_a: Axes of the first shape.
        b: Number of the second shape.
        turn_b: Axes of the second shape.
        offset: Position of b less that of a, world axes, m.
        count: Number of points of the difference that are in the first rows of scratch.
        room: Scratch of `make_room`.

    Returns:
        As `gap`; the depth is at most RELATIVE above the true one where steps suffice. The points
        differ by about as much from lying it apart.
    """
    count = _widen(table, a, turn_a, b, turn_b, offset, count, room)
    if count < 4:
        # Two spheres with one centre
        return 0.0, UP, row_point(room, 0, 3), row_point(room, 0, 6)
    faces = _first_faces(room)
    least = np.inf
    outward = UP
    i, j, k = 0, 1, 2
    for new in range(count, MOST_VERTICES):
        face = _nearest_face(room, faces)
        normal = row_point(room, face, 0)
        lower = room[face, 3]
        against = (-normal[0], -normal[1], -normal[2])
        w = put_difference(table, a, turn_a, b, turn_b, offset, against, room, new)
        # What this normal needs to part the shapes
        upper = dot(normal, w)
        done = upper - lower <= EXACT + RELATIVE * abs(upper)
        if done:
            face = _foot_face(room, faces, face)
        if upper < least or done:
            least = upper
            outward = normal
            i = int(room[face, 4])
            j = int(room[face, 5])
            k = int(room[face, 6])
        if done:
            break
        faces = _grow(room, faces, new)
        if faces == 0:
            break
    shares = _shares(room, i, j, k, plus((0.0, 0.0, 0.0), least, outward))
    on_a = _mean(room, i, j, k, shares, 3)
    on_b = _mean(room, i, j, k, shares, 6)
    return -least, (-outward[0], -outward[1], -outward[2]), on_a, on_b
