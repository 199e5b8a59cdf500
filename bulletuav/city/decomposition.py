"""Meshes of buildings in convex pieces."""

from collections.abc import Iterator

import numpy as np

from bulletuav.city.assembly import check_extent
from bulletuav.city.decomposer import REMEDY, Decomposer
from bulletuav.city.import_report import Notebook, Split
from bulletuav.city.mesh import Mesh, components, outside, outward, prism_pieces, volume

FILLED = 1e-4
"""Share of a hull that may be missing in a mesh that counts as convex"""
SAMPLES = 300
"""Samples of the surface of each piece, beside its corners"""
CHUNK = 64
"""Samples whose distances are found together"""


def split(mesh: Mesh, where: str, notes: Notebook, decompose: Decomposer) -> Iterator[np.ndarray]:
    """Split what a mesh holds into convex pieces.

    Each closed component is one piece where it is convex. Upright prisms are cut exactly, all
    others by CoACD: X. Wei, M. Liu, Z. Ling and H. Su, "Approximate convex decomposition for 3D
    meshes with collision-aware concavity and tree search", ACM Trans. Graph. 41 (2022).
    Components that are not closed are filled to their hulls.

    Args:
        mesh: The mesh.
        where: Name of its object.
        notes: Where errors and fillings are noted.
        decompose: Splits by CoACD, in a process that objects of a file share.

    Yields:
        Points (V, 3), m, whose hull is a piece.

    Raises:
        ImportError: CoACD is needed, and not installed.
        ValueError: What is to be filled or left out is refused, a mesh is larger than a world, or
            CoACD does not split it.
    """
    parts = components(mesh)
    hulls = [_hull_volume(part.points) for part in parts]
    for part, hull in zip(parts, hulls, strict=True):
        if hull > 0:
            yield from _split_component(part, hull, where, notes, decompose)
    flat = [part.points for part, hull in zip(parts, hulls, strict=True) if hull == 0]
    if parts and not flat:
        return
    # Walls that share no corners are a building by themselves, but rubbish beside one
    walls = np.concatenate([np.zeros((0, 3)), *flat])
    if not any(hulls) and _hull_volume(walls) > 0:
        notes.add("hull", where, "its mesh is not closed")
        yield walls
    else:
        notes.add("skipped", where, f"it has no volume, or {len(flat)} flat meshes")


def _split_component(
    mesh: Mesh, hull: float, where: str, notes: Notebook, decompose: Decomposer
) -> Iterator[np.ndarray]:
    """Split a mesh, whose hull has a volume, m^3, into convex pieces."""
    closed = outward(mesh)
    if closed is None:
        notes.add("hull", where, "its mesh is not closed")
        yield mesh.points
        return
    check_extent(notes.path, mesh.points[:, :2].min(axis=0), mesh.points[:, :2].max(axis=0), None)
    filled = volume(closed)
    if filled >= (1 - FILLED) * hull:
        yield mesh.points
    else:
        pieces = prism_pieces(closed, filled) or decompose(closed, f"{notes.path}, {where}")
        # CoACD returns flat pieces of some meshes that cross themselves
        sizes = [_hull_volume(piece) for piece in pieces]
        pieces = [piece for piece, size in zip(pieces, sizes, strict=True) if size > 0]
        if not pieces:
            raise ValueError(f"{notes.path}, {where}: its pieces have no volume: {REMEDY}")
        beyond = max(float(_outside_in_chunks(closed, piece).max()) for piece in pieces)
        notes.splits.append(Split(where, len(pieces), filled, sum(sizes), beyond))
        yield from pieces


def _hull_volume(points: np.ndarray) -> float:
    """Return the volume of the hull of points (V, 3), m^3; 0 of what spans none."""
    from scipy.spatial import ConvexHull, QhullError  # which takes long to import

    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def _outside_in_chunks(mesh: Mesh, piece: np.ndarray) -> np.ndarray:
    """Return the distances (K,) of samples of a piece's surface from a mesh, outside of it, m."""
    samples = _surface_samples(piece)
    chunks = np.array_split(samples, len(samples) // CHUNK + 1)
    return np.concatenate([outside(mesh, chunk) for chunk in chunks])


def _surface_samples(piece: np.ndarray) -> np.ndarray:
    """Return the corners of a hull and points (K, 3) spread over its surface, always the same."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(piece)
    a, b, c = piece[hull.simplices].swapaxes(0, 1)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), SAMPLES, p=area / area.sum())
    u, v = np.sort(rng.random((2, SAMPLES)), axis=0)[..., None]
    spread = u * a[face] + (v - u) * b[face] + (1 - v) * c[face]
    return np.concatenate([piece[hull.vertices], spread])
