"""Convex shapes in one table for compiled code: support points, vertices and faces.

A shape is a sphere, a cylinder along z, a box, the convex hull of points, or the half-space z <= 0,
each in its own axes. The table holds many shapes; functions take the table and the index of a
shape.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import atan2, hypot
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, Vec3Like
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE, Shape

NUM_RIM_POINTS = 4
"""Number of points that approximate the rim of a cylinder's cap"""
MAX_FACE_CORNERS = 256
"""Maximum number of corners of a hull's face; the scratch array holds two faces, see
`minkowski.SCRATCH_ROWS`
"""
COPLANARITY_TOLERANCE = 1e-9
"""Maximum difference between the plane equations of two triangles that belong to one face"""


class ShapeTable(NamedTuple):
    """Table of S convex shapes, whose hulls have V vertices and F flat faces in total.

    Attributes:
        kind: (S,) SPHERE, CYLINDER, BOX, HULL or HALF_SPACE.
        half: (S, 3) half extents of the bounding box, m.
        centre: (S, 3) centre of the bounding box, m; zero except for hulls.
        radius: (S,) radius of the bounding sphere about the origin, m; inf for a half-space.
        vertices: (V, 3) vertices of the hulls, m.
        vertex_range: (S, 2) first vertex of each hull, and the one after its last.
        face_planes: (F, 4) outward unit normal of each face, and its distance from the origin, m.
        face_range: (S, 2) first face of each hull, and the one after its last.
        face_vertices: Indices into `vertices` of the corners of each face, counterclockwise seen
            from outside.
        face_vertex_range: (F, 2) first index in `face_vertices` of each face, and the one after its
            last.
    """

    kind: np.ndarray
    half: np.ndarray
    centre: np.ndarray
    radius: np.ndarray
    vertices: np.ndarray
    vertex_range: np.ndarray
    face_planes: np.ndarray
    face_range: np.ndarray
    face_vertices: np.ndarray
    face_vertex_range: np.ndarray


def make_hull_shape(points: np.ndarray) -> Shape:
    """Make the convex hull of points (V, 3), m.

    Raises:
        ValueError: If the points span no volume, or a face has more than MAX_FACE_CORNERS corners.
    """
    corners, faces = _hull_faces(points)
    if max(len(ring) for _, ring in faces) > MAX_FACE_CORNERS:
        raise ValueError(f"a face of a hull has more than {MAX_FACE_CORNERS} corners: simplify it")
    half = np.abs(corners).max(axis=0)
    return Shape(HULL, tuple(half.tolist()), tuple(map(tuple, corners.tolist())))


def _hull_faces(points: np.ndarray) -> tuple[np.ndarray, list[tuple[np.ndarray, list[int]]]]:
    """Compute the vertices (V, 3) of a hull, and the plane (4,) and vertex indices of each face.

    Raises:
        ValueError: If the points span no volume.
    """
    return _compute_faces(np.asarray(points, dtype=float).tobytes())


@lru_cache(4096)
def _compute_faces(given: bytes) -> tuple[np.ndarray, list[tuple[np.ndarray, list[int]]]]:
    """Compute `_hull_faces` of the bytes of points; the result is shared, and not to be changed."""
    points = np.frombuffer(given).reshape(-1, 3)
    # Imported here because it is slow and most shapes need no hull
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(f"a piece with the corners {points.tolist()} m spans no volume") from None
    corners = points[hull.vertices]
    number = {int(old): new for new, old in enumerate(hull.vertices)}
    # Qhull gives all triangles of a face the same plane, up to rounding
    size = float(np.abs(corners).max())
    planes = np.zeros(hull.equations.shape)
    members: list[set[int]] = []
    for triangle, equation in zip(hull.simplices, hull.equations, strict=True):
        new = {number[int(k)] for k in triangle}
        # Members of the first face that is parallel and equally far from the origin
        away = np.abs(planes[: len(members)] - equation)
        is_same = away[:, :3].max(axis=1) <= COPLANARITY_TOLERANCE
        is_same &= away[:, 3] <= COPLANARITY_TOLERANCE * size
        if is_same.any():
            members[int(is_same.argmax())] |= new
        else:
            planes[len(members)] = equation
            members.append(new)
    return corners, [
        (plane * [1, 1, 1, -1], _order_counterclockwise(corners, plane[:3], sorted(face)))
        for plane, face in zip(planes, members, strict=False)
    ]


def _order_counterclockwise(corners: np.ndarray, normal: np.ndarray, face: list[int]) -> list[int]:
    """Sort the corners of a face counterclockwise, seen against its normal."""
    middle = corners[face].mean(axis=0)
    offset = [corners[k] - middle for k in face]
    # Written out: np.cross is slow for single vectors, and cities have many faces
    a, b, c = normal.tolist()
    x, y, z = offset[0].tolist()
    left = np.array([b * z - c * y, c * x - a * z, a * y - b * x])
    angle = [atan2(one @ left, one @ offset[0]) for one in offset]
    return [k for _, k in sorted(zip(angle, face, strict=True))]


def make_shape_table(shapes: Sequence[Shape]) -> ShapeTable:
    """Make the table of a sequence of shapes, in the same order."""
    half = np.array([shape.half for shape in shapes], dtype=float).reshape(-1, 3)
    middle = np.zeros(half.shape)
    radius = np.array([bounding_radius(shape) for shape in shapes], dtype=float)
    corner: list[np.ndarray] = []
    plane: list[np.ndarray] = []
    ring: list[int] = []
    rings: list[tuple[int, int]] = []
    corners = np.zeros((len(shapes), 2), dtype=np.int64)
    planes = np.zeros((len(shapes), 2), dtype=np.int64)
    count = 0
    # Identical shapes share one hull computation, which is slow.
    hulls = {shape for shape in shapes if shape.kind == HULL}
    known = {shape: _hull_faces(np.array(shape.corners)) for shape in hulls}
    for s, shape in enumerate(shapes):
        corners[s] = count
        planes[s] = len(plane)
        if shape.kind == HULL:
            points, faces = known[shape]
            low, high = points.min(axis=0), points.max(axis=0)
            half[s] = (high - low) / 2
            middle[s] = (high + low) / 2
            for equation, face in faces:
                plane.append(equation)
                rings.append((len(ring), len(ring) + len(face)))
                ring += [count + k for k in face]
            corner.append(points)
            count += len(points)
            corners[s, 1] = count
            planes[s, 1] = len(plane)
    return ShapeTable(
        kind=np.array([shape.kind for shape in shapes], dtype=np.int64),
        half=half,
        centre=middle,
        radius=radius,
        vertices=np.concatenate([np.zeros((0, 3)), *corner]),
        vertex_range=corners,
        face_planes=np.array(plane).reshape(-1, 4),
        face_range=planes,
        face_vertices=np.array(ring, dtype=np.int64),
        face_vertex_range=np.array(rings, dtype=np.int64).reshape(-1, 2),
    )


def bounding_radius(shape: Shape) -> float:
    """Return the radius of a shape's bounding sphere about its origin, m."""
    if shape.kind == HALF_SPACE:
        return math.inf
    if shape.kind == SPHERE:
        return shape.half[0]
    if shape.kind == CYLINDER:
        return hypot(shape.half[0], shape.half[2])
    if shape.kind == BOX:
        return math.hypot(*shape.half)
    return max(math.hypot(*corner) for corner in shape.corners)


def inscribed_radius(shape: Shape) -> float:
    """Return the radius of a ball inside a shape, m.

    It is the largest such ball, except for a hull: there it is the largest one that is centred at
    the mean of the vertices.
    """
    if shape.kind != HULL:
        return min(shape.half)
    corners, faces = _hull_faces(np.array(shape.corners))
    middle = corners.mean(axis=0)
    return min(float(plane[3] - plane[:3] @ middle) for plane, _ in faces)


def contains_origin(hull: Shape) -> bool:
    """Return True if the origin lies strictly inside a hull."""
    _, faces = _hull_faces(np.array(hull.corners))
    return min(float(plane[3]) for plane, _ in faces) > 0


def insert_shapes(table: ShapeTable, at: int, new: ShapeTable) -> ShapeTable:
    """Insert the shapes of one table into another.

    Args:
        table: The table to extend.
        at: Index of the first inserted shape; shapes from this index on move up.
        new: The shapes to insert.

    Returns:
        A new table with all shapes.
    """
    # Each array is sorted by shape, so that the new rows are inserted at one place.
    corner = int(table.vertex_range[at, 0])
    plane = int(table.face_range[at, 0])
    ring = (
        int(table.face_vertex_range[plane, 0])
        if plane < len(table.face_vertex_range)
        else len(table.face_vertices)
    )

    def join(old: np.ndarray, cut: int, inner: np.ndarray, low: int = 0, by: int = 0) -> np.ndarray:
        return np.concatenate([old[:cut], inner + low, old[cut:] + by])

    corners, planes, rings = len(new.vertices), len(new.face_planes), len(new.face_vertices)
    return ShapeTable(
        kind=join(table.kind, at, new.kind),
        half=join(table.half, at, new.half),
        centre=join(table.centre, at, new.centre),
        radius=join(table.radius, at, new.radius),
        vertices=join(table.vertices, corner, new.vertices),
        vertex_range=join(table.vertex_range, at, new.vertex_range, corner, corners),
        face_planes=join(table.face_planes, plane, new.face_planes),
        face_range=join(table.face_range, at, new.face_range, plane, planes),
        face_vertices=join(table.face_vertices, ring, new.face_vertices, corner, corners),
        face_vertex_range=join(table.face_vertex_range, plane, new.face_vertex_range, ring, rings),
    )


@func
def _hull_support(table: ShapeTable, s: int, d: Vec3Like) -> Vec3:
    """Return the vertex of a hull that is farthest along a direction, the first of several."""
    best = table.vertex_range[s, 0]
    most = -np.inf
    for k in range(table.vertex_range[s, 0], table.vertex_range[s, 1]):
        along = (
            table.vertices[k, 0] * d[0] + table.vertices[k, 1] * d[1] + table.vertices[k, 2] * d[2]
        )
        if along > most:
            best = k
            most = along
    return table.vertices[best, 0], table.vertices[best, 1], table.vertices[best, 2]


@kernel
def local_support_point(table: ShapeTable, s: int, d: Vec3Like) -> Vec3:
    """Return the support point of a shape along a direction, in the shape's own axes.

    It is a point of the shape that is farthest along the direction.

    Args:
        table: The shapes.
        s: Index of the shape, which is no half-space.
        d: Direction in the shape's axes, of any length but 0.

    Returns:
        The support point in the shape's axes, m. For a sphere it is the centre: the radius is a
        margin, which callers add (see `minkowski.shape_margin`).
    """
    kind = table.kind[s]
    if kind == SPHERE:
        return 0.0, 0.0, 0.0
    if kind == BOX:
        return (
            math.copysign(table.half[s, 0], d[0]),
            math.copysign(table.half[s, 1], d[1]),
            math.copysign(table.half[s, 2], d[2]),
        )
    if kind == CYLINDER:
        across = math.sqrt(d[0] * d[0] + d[1] * d[1])
        rise = math.copysign(table.half[s, 2], d[2])
        if across == 0.0:
            return 0.0, 0.0, rise
        scale = table.half[s, 0] / across
        return scale * d[0], scale * d[1], rise
    return _hull_support(table, s, d)
