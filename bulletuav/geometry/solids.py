"""Solids that do not move during an episode, made of convex pieces.

A piece is an axis-aligned box, or the convex hull of points. A mesh is a pair of arrays: vertices
(V, 3), m, and triangles (T, 3), which are indices of vertices, counterclockwise seen from outside.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3), m, and triangles (T, 3)."""

BOX_TRIANGLES = np.array(
    [
        (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
        (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
    ]
)  # fmt: skip
"""Triangles of a box.

Corner k has its maximum x, y, z if bits 0, 1, 2 of k are set.
"""


@dataclass(frozen=True, eq=False)
class Solids:
    """P convex pieces: boxes first, then hulls.

    Attributes:
        boxes: (B, 2, 3) low and high corner of each box, m.
        hulls: Points (V, 3), m, in any order, of each hull.
        colours: (P, 3) red, green, blue of the pieces in pictures, from 0 to 255; None for the
            colour of buildings.
    """

    boxes: np.ndarray
    hulls: tuple[np.ndarray, ...] = ()
    colours: np.ndarray | None = None

    @cached_property
    def bounds(self) -> np.ndarray:
        """Low and high corner (P, 2, 3) of the bounding box of each piece, m."""
        of_hulls = [(hull.min(axis=0), hull.max(axis=0)) for hull in self.hulls]
        return np.concatenate([self.boxes, np.array(of_hulls).reshape(-1, 2, 3)])

    @cached_property
    def faces(self) -> list[Mesh]:
        """Mesh of each piece."""
        of_boxes = [(box_corners(box), BOX_TRIANGLES) for box in self.boxes]
        return of_boxes + [_hull_faces(hull) for hull in self.hulls]

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh of all pieces together."""
        return join_meshes(self.faces)

    def meshes(self, most: int) -> list[Mesh]:
        """Split the mesh at piece boundaries into parts of about `most` triangle corners each."""
        corners = [3 * len(triangles) for _, triangles in self.faces]
        part = np.cumsum(corners, dtype=int) // most
        return [
            join_meshes([self.faces[p] for p in np.flatnonzero(part == k)]) for k in np.unique(part)
        ]


def join_meshes(faces: Sequence[Mesh]) -> Mesh:
    """Join several meshes into one, in their order."""
    vertices = [corners for corners, _ in faces]
    # Shift the vertex indices of each mesh by the number of vertices before it.
    firsts = np.cumsum([0] + [len(corners) for corners in vertices])
    triangles = [one + first for (_, one), first in zip(faces, firsts, strict=False)]
    return (
        np.concatenate([np.zeros((0, 3)), *vertices]),
        np.concatenate([np.zeros((0, 3), dtype=int), *triangles]),
    )


def box_corners(box: np.ndarray) -> np.ndarray:
    """Return the corners (8, 3) of a box (2, 3) in the order of `BOX_TRIANGLES`."""
    which = np.arange(8)
    return np.stack([box[which >> axis & 1, axis] for axis in range(3)], axis=1)


def _hull_faces(corners: np.ndarray) -> Mesh:
    """Compute the mesh of the convex hull of points (V, 3).

    Raises:
        ValueError: If the points span no volume.
    """
    # Imported here because it is slow and boxes do not need it.
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(corners)
    except QhullError:
        raise ValueError(f"a piece with the corners {corners.tolist()} m spans no volume") from None
    faces = hull.simplices.astype(int)
    # Flip faces whose normal points inwards.
    a, b, c = (corners[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def format_obj_lines(pieces: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> Iterator[str]:
    """Format pieces as the lines of a Wavefront OBJ file, one object each, in full precision.

    Args:
        pieces: Name, vertices (V, 3) and triangles (T, 3) of each piece.

    Yields:
        The lines of the file.
    """
    first = 1
    for name, corners, triangles in pieces:
        yield f"o {name}"
        yield from (f"v {x} {y} {z}" for x, y, z in corners.tolist())
        yield from (f"f {a} {b} {c}" for a, b, c in (triangles + first).tolist())
        first += len(corners)


def group_separated(bounds: np.ndarray, apart: float) -> list[np.ndarray]:
    """Group pieces so that the members of a group are separated by a minimum distance.

    Greedy graph colouring: it gives few groups, and is deterministic.

    Args:
        bounds: (P, 2, 3) bounding boxes of the pieces, m.
        apart: Minimum distance along at least one axis, m.

    Returns:
        Indices of the pieces of each group.
    """
    colour = np.full(len(bounds), -1)
    for p, (low, high) in enumerate(bounds):
        # Use the first colour that no close piece has.
        gap = np.maximum(bounds[:p, 0] - high, low - bounds[:p, 1]).max(axis=1, initial=-np.inf)
        taken = set(colour[:p][gap < apart].tolist())
        colour[p] = next(k for k in range(p + 1) if k not in taken)
    return [np.flatnonzero(colour == k) for k in range(colour.max(initial=-1) + 1)]
