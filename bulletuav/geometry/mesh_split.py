"""Convex pieces of meshes, which contacts and rays need."""

import functools
from collections.abc import Sequence

import numpy as np

from bulletuav.geometry.decomposer import REMEDY, Decomposer
from bulletuav.geometry.mesh import Mesh, components, make_mesh, outward, prism_pieces, volume
from bulletuav.geometry.obstacle import MAX_CORNERS, MAX_SIZE

FILLED = 1e-4
"""Relative difference of volume or area to the hull up to which a mesh counts as convex"""
ON_HULL = 1e-6
"""Distance from the hull's faces, in sizes of the mesh, up to which a corner is on them"""


def hull_volume(points: np.ndarray) -> float:
    """Return the volume of the convex hull of points (V, 3), m^3; 0 if degenerate."""
    from scipy.spatial import ConvexHull, QhullError  # lazy: slow to import

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def is_filled(closed: Mesh, size: float) -> bool:
    """Return True for a closed mesh that fills its convex hull, whose volume is `size`, m^3."""
    return volume(closed) >= (1 - FILLED) * size


def split_concave(closed: Mesh, where: str, decompose: Decomposer) -> list[np.ndarray]:
    """Split a closed mesh that is not convex: upright prisms exactly, all others by CoACD.

    Args:
        closed: A closed mesh with outward triangles.
        where: File and object, for the message.
        decompose: The decomposer.

    Returns:
        Points (V, 3), m, of each piece.

    Raises:
        ImportError: If the extra is required, and not installed.
        ValueError: If the decomposition fails.
    """
    pieces = prism_pieces(closed, volume(closed)) or decompose(closed, where)
    # CoACD returns flat pieces for some self-intersecting meshes
    pieces = [piece for piece in pieces if hull_volume(piece) > 0]
    if not pieces:
        raise ValueError(f"{where}: its pieces have no volume: {REMEDY}")
    return pieces


def split_body(
    points: np.ndarray, faces: Sequence[Sequence[int]], where: str
) -> Sequence[np.ndarray]:
    """Split an object of a mesh file into convex pieces.

    A convex object is one piece. Each closed component of any other is split, if it is not convex.

    Args:
        points: (V, 3) vertices, m.
        faces: Indices of the vertices of each face.
        where: File and object, for the message.

    Returns:
        Points (V, 3), m, whose convex hull is a piece.

    Raises:
        ImportError: If the extra `city` is required, and not installed.
        ValueError: If the object is not closed, has a cavity, or cannot be split.
    """
    used = np.unique(np.concatenate([np.asarray(face) for face in faces]))
    if np.abs(points[used]).max() > MAX_SIZE:
        raise ValueError(f"{where}: a point is farther out than {MAX_SIZE:g} m")
    covered = _covered_share(points, faces, used)
    if covered > 0:
        if covered < 1 - FILLED:
            raise ValueError(
                f"{where}: its faces cover {100 * covered:.3g} % of its convex hull, so that it "
                f"has openings, and its walls no thickness: close the mesh, or pass its corners "
                f"(V, 3) for the convex hull"
            )
        return [points[used]]
    mesh = make_mesh(points, [face for face in faces if len(face) > 2])
    return _split_mesh(where, mesh.points.tobytes(), mesh.triangles.tobytes())


def _covered_share(points: np.ndarray, faces: Sequence[Sequence[int]], used: np.ndarray) -> float:
    """Return the fraction of the hull's surface that faces cover, 0 if any is off the surface.

    Args:
        points: (V, 3) vertices, m.
        faces: Indices of the vertices of each face.
        used: Indices of the vertices of all faces.

    Returns:
        The fraction; 1 for points that span no volume, which hulls report, and 0 for hulls of too
        many corners, whose search would take long.
    """
    from scipy.spatial import ConvexHull, QhullError  # lazy: slow to import

    try:
        hull = ConvexHull(points[used])
    except (QhullError, ValueError):
        return 1.0
    if len(hull.vertices) > MAX_CORNERS:
        return 0.0
    flat = np.concatenate([np.asarray(face) for face in faces])
    starts = np.cumsum([0, *map(len, faces[:-1])])
    limit = ON_HULL * float(np.ptp(points[used], axis=0).max())
    is_on = np.zeros(len(faces), dtype=bool)
    for equation in hull.equations:
        near = np.abs(points @ equation[:3] + equation[3]) <= limit
        is_on |= np.logical_and.reduceat(near[flat], starts)
    if not is_on.all():
        return 0.0
    # Newell: the vector area of a flat polygon
    area = sum(
        float(np.linalg.norm(np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0)))
        for corners in (points[list(face)] - points[face[0]] for face in faces)
    )
    return max(min(area / 2 / float(hull.area), 1.0), np.finfo(float).tiny)


@functools.lru_cache(maxsize=64)
def _split_mesh(where: str, corners: bytes, indices: bytes) -> tuple[np.ndarray, ...]:
    """Split a mesh that is not convex, once for each content.

    Args:
        where: File and object, for the message.
        corners: Bytes of the corners (V, 3), float64, m.
        indices: Bytes of the triangles (T, 3), int64.

    Returns:
        Points (V, 3), m, of each piece.
    """
    mesh = Mesh(
        np.frombuffer(corners).reshape(-1, 3), np.frombuffer(indices, dtype=int).reshape(-1, 3)
    )
    parts = components(mesh)
    closed = [outward(part) for part in parts]
    if not closed or any(part is None for part in closed):
        raise ValueError(
            f"{where} is neither convex nor closed, so that it has no inside: close it in a "
            f"modelling program, or split it into convex objects by hand"
        )
    if len({volume(part) > 0 for part in parts}) > 1:
        raise ValueError(
            f"{where} has a cavity, or components with faces that look inwards: split the walls "
            f"into convex objects by hand, or turn the faces outwards"
        )
    found: list[np.ndarray] = []
    with Decomposer() as decompose:
        for part in closed:
            assert part is not None
            size = hull_volume(part.points)
            if is_filled(part, size):
                found.append(part.points)
            else:
                found += split_concave(part, where, decompose)
    return tuple(found)
