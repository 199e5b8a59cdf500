"""Convex shapes as one table for compiled code: how far they reach along a direction, their faces.

A shape is a sphere, a cylinder along z, a box, the convex hull of points, or the half space z <= 0,
each in axes of its own. The table holds many shapes; functions take it with the number of one.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import atan2, hypot
from bulletuav.compiled.kernel import func, kernel
from bulletuav.geometry.rotation import Vec3, Vec3Like
from bulletuav.geometry.shapes import BOX, CYLINDER, HALF_SPACE, HULL, SPHERE, Shape

NUM_RIM_POINTS = 4
"""Points that stand for the rim of a cylinder's flat side"""
MAX_FACE_CORNERS = 256
"""Most corners of a face of a hull; scratch holds those of two faces, see `minkowski.ROWS`"""
COPLANARITY_TOLERANCE = 1e-9
"""Difference of the planes of two triangles of one face"""


class ShapeTable(NamedTuple):
    """S convex shapes; those that are hulls have V corners and F flat faces in all.

    Attributes:
        kind: (S,) SPHERE, CYLINDER, BOX, HULL or HALF_SPACE.
        half: (S, 3) half extents of the bounding box, m.
        middle: (S, 3) middle of the bounding box; zero but for hulls, m.
        radius: (S,) distance of the farthest point from the origin, m; inf for a half space.
        corner: (V, 3) corners of the hulls, m.
        corners: (S, 2) first corner of each hull, and the one after its last.
        plane: (F, 4) outward unit normal of each face, and its distance from the origin, m.
        planes: (S, 2) first face of each hull, and the one after its last.
        ring: Indices into `corner`: those of each face, turning left seen from outside.
        rings: (F, 2) first index in `ring` of each face, and the one after its last.
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
        ValueError: The points span no volume, or a face has too many corners.
    """
    corners, faces = _hull_faces(points)
    if max(len(ring) for _, ring in faces) > MAX_FACE_CORNERS:
        raise ValueError(f"a face of a hull has more than {MAX_FACE_CORNERS} corners: simplify it")
    half = np.abs(corners).max(axis=0)
    return Shape(HULL, tuple(half.tolist()), tuple(map(tuple, corners.tolist())))


def _hull_faces(points: np.ndarray) -> tuple[np.ndarray, list[tuple[np.ndarray, list[int]]]]:
    """Return the corners (V, 3) of a convex hull, and of each face its plane (4,) and its ring.

    Raises:
        ValueError: The points span no volume.
    """
    # SciPy's hulls take long to import, and most shapes do without
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(f"a piece with the corners {points.tolist()} m spans no volume") from None
    corners = points[hull.vertices]
    number = {int(old): new for new, old in enumerate(hull.vertices)}
    # Qhull gives triangles of one face the same plane, but for rounding
    size = float(np.abs(corners).max())
    planes: list[np.ndarray] = []
    members: list[set[int]] = []
    for triangle, equation in zip(hull.simplices, hull.equations, strict=True):
        new = {number[int(k)] for k in triangle}
        for plane, face in zip(planes, members, strict=True):
            is_parallel = np.abs(plane[:3] - equation[:3]).max() <= COPLANARITY_TOLERANCE
            if is_parallel and abs(plane[3] - equation[3]) <= COPLANARITY_TOLERANCE * size:
                face |= new
                break
        else:
            planes.append(equation)
            members.append(new)
    return corners, [
        (plane * [1, 1, 1, -1], _order_counterclockwise(corners, plane[:3], sorted(face)))
        for plane, face in zip(planes, members, strict=True)
    ]


def _order_counterclockwise(corners: np.ndarray, normal: np.ndarray, face: list[int]) -> list[int]:
    """Order the corners of a face so that they turn left, seen from where its normal points."""
    middle = corners[face].mean(axis=0)
    offset = [corners[k] - middle for k in face]
    # By hand, as cities have many faces and NumPy takes long for one product
    a, b, c = normal.tolist()
    x, y, z = offset[0].tolist()
    left = np.array([b * z - c * y, c * x - a * z, a * y - b * x])
    angle = [atan2(one @ left, one @ offset[0]) for one in offset]
    return [k for _, k in sorted(zip(angle, face, strict=True))]


def make_shape_table(shapes: Sequence[Shape]) -> ShapeTable:
    """Put shapes into one table, in their order."""
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
    # Drones of one kind share a hull, which takes time to compute.
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
    """Return the distance of a shape's farthest point from its origin, m."""
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
    """Return the radius of a ball within a shape, m.

    It is the largest one, or for a hull the largest about the mean of its corners.
    """
    if shape.kind != HULL:
        return min(shape.half)
    corners, faces = _hull_faces(np.array(shape.corners))
    middle = corners.mean(axis=0)
    return min(float(plane[3] - plane[:3] @ middle) for plane, _ in faces)


def contains_origin(hull: Shape) -> bool:
    """Tell whether the origin is within a hull, and not on its surface."""
    _, faces = _hull_faces(np.array(hull.corners))
    return min(float(plane[3]) for plane, _ in faces) > 0


def insert_shapes(table: ShapeTable, at: int, new: ShapeTable) -> ShapeTable:
    """Put the shapes of a table into another one.

    Args:
        table: The other one.
        at: Number that the first new shape gets; those from there on move up.
        new: The shapes to put in.

    Returns:
        All shapes.
    """
    # Corners, faces and rings are in the order of their shapes, so there is one cut in each.
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
    """Return the corner of a hull that is farthest along a direction, the first of several."""
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
    """Return a point of shape s that is farthest along a direction.

    Args:
        table: The shapes; s is none of its half spaces.
        s: Number of the shape.
        d: Direction in the shape's axes, of any length but 0.

    Returns:
        The point in the shape's axes, m. Of a sphere it is the centre: GJK adds the radius.
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
