"""Convex decomposition of polygons."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any, cast

import numpy as np

from bulletuav.compiled.functions import hypot
from bulletuav.errors import missing_extra
from bulletuav.geometry.convex import MAX_FACE_CORNERS

STRAIGHT = 1e-9
"""Sine of a right turn up to which a corner counts as straight"""
SLIVER = 1e-4
"""Minimum area of a piece of a footprint, m^2"""


def import_shapely(what: str) -> ModuleType:
    """Import shapely, or raise an error that names the required extra.

    Args:
        what: Feature that needs shapely.

    Raises:
        ImportError: If the extra is not installed.
    """
    try:
        import shapely
    except ImportError:
        raise missing_extra(what, "city") from None
    return cast(ModuleType, shapely)


def convex_pieces(polygon: Any) -> Iterator[np.ndarray]:
    """Cut a polygon into convex pieces, at most four times the minimum number.

    The triangles of a constrained Delaunay triangulation are merged across their longest edges
    first.

    Args:
        polygon: A valid shapely Polygon, with or without holes.

    Yields:
        Corners (V, 2) of each piece, counter-clockwise.

    References:
        S. Hertel and K. Mehlhorn, "Fast triangulation of simple polygons", 1983.
    """
    import shapely  # available, as the argument is a shapely object

    outline = shapely.get_coordinates(polygon.normalize().exterior)[-2::-1]
    if not polygon.interiors and turns_left(outline):
        yield from _of_few_corners(outline)
        return
    triangles = triangles_of(polygon)
    # Index the corners; corners of adjacent triangles are bit-identical
    points, number = np.unique(triangles.reshape(-1, 2), axis=0, return_inverse=True)
    for piece in _joined(points, number.reshape(-1, 3).tolist()):
        yield from _of_few_corners(points[piece])


def _of_few_corners(outline: np.ndarray) -> Iterator[np.ndarray]:
    """Cut a convex outline into pieces with at most MOST_CORNERS corners."""
    first, others = outline[:1], outline[1:]
    for k in range(0, len(others) - 1, MAX_FACE_CORNERS - 2):
        yield np.concatenate([first, others[k : k + MAX_FACE_CORNERS - 1]])


def turns_left(outline: np.ndarray) -> bool:
    """Return True if an outline (V, 2) turns left or goes straight on at all corners.

    A simple polygon with this property is convex.
    """
    after = np.roll(outline, -1, axis=0) - outline
    before = np.roll(after, 1, axis=0)
    scale = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return bool((_cross(before, after) >= -STRAIGHT * scale).all())


def triangles_of(polygon: Any) -> np.ndarray:
    """Return the constrained Delaunay triangles (T, 3, 2), counter-clockwise."""
    import shapely

    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    corners = shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3]
    a, b, c = corners.swapaxes(0, 1)
    double = _cross(b - a, c - a)
    corners[double < 0] = corners[double < 0, ::-1]
    kept: np.ndarray = corners[double != 0]
    return kept


def area_of(outline: np.ndarray) -> float:
    """Return the area of a counter-clockwise outline (V, 2)."""
    return float(_cross(outline, np.roll(outline, -1, axis=0)).sum() / 2)


def extruded(outline: np.ndarray, bottom: float, top: float) -> np.ndarray:
    """Return the corners (2 V, 3) of a prism between two heights, m, over an outline (V, 2)."""
    return np.concatenate([np.insert(outline, 2, z, axis=1) for z in (bottom, top)])


def _joined(points: np.ndarray, pieces: list[list[int]]) -> list[list[int]]:
    """Merge convex pieces, lists of indices of points (V, 2), while the union is convex."""
    owner = {side: k for k, piece in enumerate(pieces) for side in _sides(piece)}
    inner = np.array([side for side in owner if side[0] < side[1] and side[::-1] in owner])
    if not len(inner):
        return pieces
    length = np.linalg.norm(points[inner[:, 0]] - points[inner[:, 1]], axis=1)
    for start, end in inner[np.argsort(-length, kind="stable")].tolist():
        one, two = owner[start, end], owner[end, start]
        union = _from(pieces[one], end) + _from(pieces[two], start)[1:-1]
        if one != two and _is_convex_at(points, union, start) and _is_convex_at(points, union, end):
            pieces[one] = union
            owner.update(dict.fromkeys(_sides(pieces[two]), one))
            pieces[two] = []
    return [piece for piece in pieces if piece]


def _sides(piece: list[int]) -> Iterator[tuple[int, int]]:
    """Yield the directed edges of a piece."""
    return zip(piece, piece[1:] + piece[:1], strict=True)


def _from(piece: list[int], corner: int) -> list[int]:
    """Rotate a piece such that it starts at a corner."""
    k = piece.index(corner)
    return piece[k:] + piece[:k]


def _is_convex_at(points: np.ndarray, piece: list[int], corner: int) -> bool:
    """Return True if a piece turns left or goes straight on at a corner."""
    k = piece.index(corner)
    around = points[[piece[k - 1], corner, piece[(k + 1) % len(piece)]]]
    before, after = np.diff(around, axis=0)
    scale = hypot(*before) * hypot(*after)
    return bool(_cross(before, after) >= -STRAIGHT * scale)


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return the z component of the cross product of vectors (..., 2)."""
    product: np.ndarray = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    return product
