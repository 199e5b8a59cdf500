"""Triangle meshes of buildings: components, orientation, volume and distances."""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.functions import atan2
from bulletuav.geometry.graphs import connect_components
from bulletuav.geometry.polygons import (
    SLIVER,
    area_of,
    convex_pieces,
    extruded,
    import_shapely,
    triangles_of,
    turns_left,
)

SAME = 6
"""Decimals of a metre to which coincident corners agree"""
FLAT = 1e-12
"""Area, m^2, below which a triangle is degenerate"""
MAX_CROSSING = 10_000
"""Maximum number of triangles for the self-intersection search; more take seconds"""


class Mesh(NamedTuple):
    """Triangle mesh.

    Attributes:
        points: (V, 3) corners, m.
        triangles: (T, 3) int, corner indices of each triangle.
    """

    points: np.ndarray
    triangles: np.ndarray


def make_mesh(points: np.ndarray, faces: Sequence[Sequence[int]]) -> Mesh:
    """Build a mesh from faces; coincident corners are merged.

    Args:
        points: (V, 3) points, m.
        faces: Corner indices of each face, in order; faces need not be convex.

    Returns:
        The mesh, with the points that belong to faces.
    """
    used = np.unique([corner for face in faces for corner in face])
    _, first, number = np.unique(
        np.round(points[used], SAME), axis=0, return_index=True, return_inverse=True
    )
    # Keep the order of the points
    order = np.argsort(first)
    rank = np.argsort(order)[number.ravel()]
    renumbered = dict(zip(used.tolist(), rank.tolist(), strict=True))
    own = points[used][first[order]]
    triangles = [
        triangle
        for face in faces
        for triangle in _triangulated(own, [renumbered[corner] for corner in face])
    ]
    return Mesh(own, np.array(triangles, dtype=int).reshape(-1, 3))


def _triangulated(points: np.ndarray, face: list[int]) -> Iterator[list[int]]:
    """Yield the triangles of a face, an outline through points (V, 3)."""
    corners = points[face]
    # Newell's normal; project along its largest component, seen from outside
    normal = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    plan = np.roll(corners, -axis - 1, axis=1)[:, :2]
    if normal[axis] < 0:
        plan = plan[:, ::-1]
    outline = None
    if not turns_left(plan):
        shapely = import_shapely("reading faces that are not convex")
        outline = shapely.Polygon(plan)
    if outline is None or not outline.is_valid:
        fan = ([face[0], *pair] for pair in itertools.pairwise(face[1:]))
        yield from (triangle for triangle in fan if len(set(triangle)) == 3)
        return
    by_place = {tuple(place): k for place, k in zip(plan.tolist(), face, strict=True)}
    for ring in triangles_of(outline).tolist():
        yield [by_place[tuple(place)] for place in ring]


def components(mesh: Mesh) -> list[Mesh]:
    """Split a mesh into components that share no edges."""
    count = len(mesh.triangles)
    if not count:
        return []
    _, side = np.unique(np.sort(_sides(mesh), axis=1), axis=0, return_inverse=True)
    # Bipartite graph of triangles and edges
    part = np.arange(count + int(side.max()) + 1)
    connect_components(
        part, np.stack([np.repeat(np.arange(count), 3), count + side.ravel()], axis=1)
    )
    part = part[:count]
    found = []
    for k in dict.fromkeys(part.tolist()):
        used, number = np.unique(mesh.triangles[part == k], return_inverse=True)
        found.append(Mesh(mesh.points[used], number.reshape(-1, 3)))
    return found


def _sides(mesh: Mesh) -> np.ndarray:
    """Return the directed edges of all triangles, (3 T, 2)."""
    return mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def outward(mesh: Mesh) -> Mesh | None:
    """Orient the triangles of a connected mesh outwards.

    Returns:
        The mesh, or None if it is not closed: an edge does not belong to exactly two triangles, or
        the surface is not orientable.
    """
    edge_uses: dict[tuple[int, ...], list[tuple[int, bool]]] = {}
    for k, (begin, end) in enumerate(_sides(mesh).tolist()):
        edge_uses.setdefault((min(begin, end), max(begin, end)), []).append((k // 3, begin < end))
    if any(len(pair) != 2 for pair in edge_uses.values()):
        return None
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in mesh.triangles]
    for (one, rises), (other, also) in edge_uses.values():
        neighbours[one].append((other, rises == also))
        neighbours[other].append((one, rises == also))
    # Whether each triangle must be flipped relative to the first one
    turned = {0: False}
    waiting = [0]
    while waiting:
        k = waiting.pop()
        for other, is_against in neighbours[k]:
            if other not in turned:
                turned[other] = turned[k] != is_against
                waiting.append(other)
            elif turned[other] != (turned[k] != is_against):
                return None
    over = np.array([turned[k] for k in range(len(mesh.triangles))])
    found = mesh._replace(
        triangles=np.where(over[:, None], mesh.triangles[:, ::-1], mesh.triangles)
    )
    return found if volume(found) > 0 else found._replace(triangles=found.triangles[:, ::-1])


def volume(mesh: Mesh) -> float:
    """Return the volume of a closed mesh by the divergence theorem, m^3.

    The volume is negative if the triangles face inwards.
    """
    a, b, c = (mesh.points - mesh.points[0])[mesh.triangles].swapaxes(0, 1)
    return float((a * np.cross(b, c)).sum() / 6)


def prism_pieces(mesh: Mesh, filled: float) -> list[np.ndarray]:
    """Cut an upright prism exactly into convex prisms.

    Args:
        mesh: A closed mesh.
        filled: Volume of the mesh, m^3.

    Returns:
        Corners (2 V, 3) of each piece, m; empty if the mesh is not an upright prism.
    """
    bottom, top = mesh.points[:, 2].min(), mesh.points[:, 2].max()
    height = mesh.points[:, 2]
    if np.round(np.minimum(height - bottom, top - height), SAME).max() > 0:
        return []
    shapely = import_shapely("cutting a prism")
    roof = mesh.triangles[(height[mesh.triangles] > (bottom + top) / 2).all(axis=1)]
    plan = shapely.union_all(shapely.polygons(mesh.points[roof][..., :2]))
    if abs(plan.area * (top - bottom) - filled) > 1e-6 * filled:
        return []
    outlines = [piece for polygon in shapely.get_parts(plan) for piece in convex_pieces(polygon)]
    return [extruded(outline, bottom, top) for outline in outlines if area_of(outline) > SLIVER]


def outside(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Return the distances (K,) of points (K, 3) from a closed mesh, m; 0 inside."""
    corners = mesh.points[mesh.triangles]
    inside = _winding(corners, points) > 0.5
    return np.where(inside, 0.0, _distance(corners, points))


def find_crossing(mesh: Mesh) -> np.ndarray | None:
    """Find a point (3,), m, where an edge intersects a triangle that does not contain it.

    Returns:
        The point, or None if there is none, or if the mesh has more than `MAX_CROSSING` triangles.
    """
    if len(mesh.triangles) > MAX_CROSSING:
        return None
    corners = mesh.points[mesh.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    for own, triangle in zip(mesh.triangles, corners, strict=True):
        near = ((low <= triangle.max(axis=0)) & (high >= triangle.min(axis=0))).all(axis=1)
        apart = near & ~np.isin(mesh.triangles, own).any(axis=1)
        others = corners[apart]
        for start, end in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            # Signed distances of both ends from the planes; the line passes inside a triangle if it
            # passes all edges on the same side
            a, b, c = (others - start).swapaxes(0, 1)
            normal = np.cross(b - a, c - a)
            above = -(a * normal).sum(axis=1)
            below = above + normal @ (end - start)
            passes = [np.cross(*pair) @ (end - start) for pair in ((a, b), (b, c), (c, a))]
            sides = np.sign(passes)
            crosses = (above * below < 0) & (sides[0] != 0) & (sides == sides[0]).all(axis=0)
            if crosses.any():
                k = int(crosses.argmax())
                found: np.ndarray = start + (end - start) * above[k] / (above[k] - below[k])
                return found
    return None


def _winding(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the winding numbers of triangles (T, 3, 3) around points (K, 3).

    References:
        A. van Oosterom and J. Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomed.
        Eng. 30 (1983).
    """
    a, b, c = (corners[None, :, k] - points[:, None] for k in range(3))
    lengths = [np.linalg.norm(side, axis=-1) for side in (a, b, c)]
    triple = (a * np.cross(b, c)).sum(axis=-1)
    below = lengths[0] * lengths[1] * lengths[2]
    for one, two, opposite in ((a, b, 2), (b, c, 0), (c, a, 1)):
        below = below + (one * two).sum(axis=-1) * lengths[opposite]
    share: np.ndarray = np.abs(atan2(triple, below).sum(axis=1)) / (2 * np.pi)
    return share


def _distance(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distances (K,) of points (K, 3) to the nearest of triangles (T, 3, 3), m."""
    start = corners[None]
    edge = np.roll(corners, -1, axis=1)[None] - start
    offset = points[:, None, None] - start
    # Nearest point of each edge
    square = np.maximum((edge**2).sum(axis=-1), np.finfo(float).tiny)
    along = np.clip((offset * edge).sum(axis=-1) / square, 0, 1)
    sides = np.linalg.norm(offset - along[..., None] * edge, axis=-1).min(axis=-1)
    # Distance to the plane if the point projects into the triangle
    normal = np.cross(edge[:, :, 0], edge[:, :, 1])
    length = np.maximum(np.linalg.norm(normal, axis=-1), FLAT)
    left = (np.cross(edge, offset) * normal[:, :, None]).sum(axis=-1)
    plane = np.abs((offset[:, :, 0] * normal).sum(axis=-1)) / length
    over = (left >= 0).all(axis=-1) & (length > FLAT)
    nearest: np.ndarray = np.where(over, plane, sides).min(axis=1)
    return nearest
