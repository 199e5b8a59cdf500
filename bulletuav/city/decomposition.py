"""Convex decomposition of building meshes."""

from collections.abc import Iterator

import numpy as np

from bulletuav.city.assembly import check_extent
from bulletuav.city.import_report import Notebook, Split
from bulletuav.geometry.decomposer import Decomposer
from bulletuav.geometry.mesh import Mesh, components, outside, outward, volume
from bulletuav.geometry.mesh_split import hull_volume, is_filled, split_concave

SAMPLES = 300
"""Number of surface samples per piece, besides its corners"""
CHUNK = 64
"""Number of samples whose distances are computed together"""


def split_mesh(
    mesh: Mesh, where: str, notes: Notebook, decompose: Decomposer
) -> Iterator[np.ndarray]:
    """Split a mesh into convex pieces.

    Each closed component is one piece if it is convex. Upright prisms are cut exactly, all others
    by CoACD. Components that are not closed are replaced by their convex hulls. Flat components
    next to solid ones are skipped; if all are flat, they form one hull together.

    Args:
        mesh: The mesh.
        where: Name of its object.
        notes: Import notes for errors and replacements.
        decompose: CoACD decomposer, shared by the objects of a file.

    Yields:
        Points (V, 3), m, whose convex hull is a piece.

    Raises:
        ImportError: If CoACD is required, and not installed.
        ValueError: If a strict import would have to replace or skip a mesh, a mesh is larger than a
            world, or CoACD fails.

    References:
        X. Wei, M. Liu, Z. Ling and H. Su, "Approximate convex decomposition for 3D meshes with
        collision-aware concavity and tree search", ACM Trans. Graph. 41 (2022).
    """
    parts = components(mesh)
    hulls = [hull_volume(part.points) for part in parts]
    for part, hull in zip(parts, hulls, strict=True):
        if hull > 0:
            yield from _split_component(part, hull, where, notes, decompose)
    flat = [part.points for part, hull in zip(parts, hulls, strict=True) if hull == 0]
    if parts and not flat:
        return
    # Disconnected flat walls form a building together; next to solid components they are skipped
    walls = np.concatenate([np.zeros((0, 3)), *flat])
    if not any(hulls) and hull_volume(walls) > 0:
        notes.add("hull", where, "its mesh is not closed")
        yield walls
    else:
        notes.add("skipped", where, f"it has no volume, or {len(flat)} flat meshes")


def _split_component(
    mesh: Mesh, size: float, where: str, notes: Notebook, decompose: Decomposer
) -> Iterator[np.ndarray]:
    """Split a mesh whose convex hull has the volume `size`, m^3, into convex pieces."""
    closed = outward(mesh)
    if closed is None:
        notes.add("hull", where, "its mesh is not closed")
        yield mesh.points
        return
    check_extent(notes.path, mesh.points[:, :2].min(axis=0), mesh.points[:, :2].max(axis=0), None)
    if is_filled(closed, size):
        yield mesh.points
    else:
        pieces = split_concave(closed, f"{notes.path}, {where}", decompose)
        total = sum(map(hull_volume, pieces))
        beyond = max(float(_outside_distances(closed, piece).max()) for piece in pieces)
        notes.splits.append(Split(where, len(pieces), volume(closed), total, beyond))
        yield from pieces


def _outside_distances(mesh: Mesh, piece: np.ndarray) -> np.ndarray:
    """Return the distances (K,) of a piece's surface samples outside a mesh, m; 0 inside."""
    samples = _surface_samples(piece)
    chunks = np.array_split(samples, len(samples) // CHUNK + 1)
    return np.concatenate([outside(mesh, chunk) for chunk in chunks])


def _surface_samples(piece: np.ndarray) -> np.ndarray:
    """Return the corners of a hull and samples (K, 3) of its surface, deterministic."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(piece)
    a, b, c = piece[hull.simplices].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), SAMPLES, p=area / area.sum())
    u, v = np.sort(rng.random((2, SAMPLES)), axis=0)[..., None]
    spread = u * a[face] + (v - u) * b[face] + (1 - v) * c[face]
    return np.concatenate([piece[hull.vertices], spread])
