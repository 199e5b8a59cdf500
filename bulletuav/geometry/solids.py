"""Solid things that stand still during an episode, made of convex pieces: axis-aligned boxes, and hulls for all else."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

BOX_TRIANGLES = np.array(
    [
        (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
        (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
    ]
)  # fmt: skip
"""Faces of a box, turning left seen from outside; corner k has x, y, z at the high end where bits 0, 1, 2 of k are set"""


@dataclass(frozen=True, eq=False)
class Solids:
    """Convex pieces: boxes first, then hulls.

    boxes  (B, 2, 3) low and high corner of each box, m
    hulls  of each other piece its corners (V, 3), m, in any order
    """

    boxes: np.ndarray
    hulls: tuple[np.ndarray, ...] = ()

    @cached_property
    def bounds(self) -> np.ndarray:
        """(P, 2, 3) low and high corner of each piece's bounding box, m."""
        of_hulls = [(hull.min(axis=0), hull.max(axis=0)) for hull in self.hulls]
        return np.concatenate([self.boxes, np.array(of_hulls).reshape(-1, 2, 3)])

    @cached_property
    def faces(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each piece its corners (V, 3), m, and triangles (T, 3) of them that turn left seen from outside."""
        return [(box_corners(box), BOX_TRIANGLES) for box in self.boxes] + [
            _hull_faces(hull) for hull in self.hulls
        ]

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """Surfaces of all pieces as vertices (V, 3), m, and triangles (T, 3)."""
        return joined(self.faces)

    def meshes(self, most: int) -> list[tuple[np.ndarray, np.ndarray]]:
        """The mesh in parts of about `most` corners of triangles."""
        part = np.cumsum([3 * len(triangles) for _, triangles in self.faces], dtype=int) // most
        return [joined([self.faces[p] for p in np.flatnonzero(part == k)]) for k in np.unique(part)]


def joined(faces: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """One mesh of several."""
    counts = np.cumsum([0] + [len(corners) for corners, _ in faces])
    triangles = [triangle + first for (_, triangle), first in zip(faces, counts, strict=False)]
    vertices = [corners for corners, _ in faces]
    return np.concatenate([np.zeros((0, 3)), *vertices]), np.concatenate(
        [np.zeros((0, 3), dtype=int), *triangles]
    )


def box_corners(box: np.ndarray) -> np.ndarray:
    """(8, 3) corners of a box (2, 3) in the order of `BOX_TRIANGLES`."""
    which = np.arange(8)
    return np.stack([box[which >> axis & 1, axis] for axis in range(3)], axis=1)


def _hull_faces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`Solids.faces` of the convex hull of points (V, 3). Raises ValueError where they span no volume."""
    from scipy.spatial import (
        ConvexHull,
        QhullError,
    )  # which takes long to import, and boxes do without

    try:
        hull = ConvexHull(corners)
    except QhullError:
        raise ValueError(f"a piece with the corners {corners.tolist()} m spans no volume") from None
    faces = hull.simplices.astype(int)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return corners, faces


def obj_lines(pieces: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> Iterator[str]:
    """Lines of a Wavefront OBJ file, an object for each piece: name, corners (V, 3), triangles (T, 3); with all digits."""
    first = 1
    for name, corners, triangles in pieces:
        yield f"o {name}"
        yield from (f"v {x} {y} {z}" for x, y, z in corners.tolist())
        yield from (f"f {a} {b} {c}" for a, b, c in (triangles + first).tolist())
        first += len(corners)


def apart_groups(bounds: np.ndarray, apart: float) -> list[np.ndarray]:
    """Indices of pieces with these bounding boxes (P, 2, 3), in groups whose members keep `apart` m from each other.

    Greedy graph colouring: few groups, the same for the same pieces.
    """
    colour = np.full(len(bounds), -1)
    for p, (low, high) in enumerate(bounds):
        gap = np.maximum(bounds[:p, 0] - high, low - bounds[:p, 1]).max(axis=1, initial=-np.inf)
        taken = set(colour[:p][gap < apart].tolist())
        colour[p] = next(k for k in range(p + 1) if k not in taken)
    return [np.flatnonzero(colour == k) for k in range(colour.max(initial=-1) + 1)]
