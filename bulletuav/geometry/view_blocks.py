"""Blocks of a city's pieces, edges of hulls and ids of faces, for the rasteriser of pictures."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import BOX, HULL
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE, SKY

BLOCK_SIDE = 150.0
"""Side of a block, m: some ten buildings, which are culled together"""
SKY_FACE, GROUND_FACE, FIRST_FACE = range(3)
"""Ids of the sky and the ground, and the first id of the faces of shapes"""


class ViewBlocks(NamedTuple):
    """Square blocks of the pieces of L city layouts, K blocks in total.

    Attributes:
        first: (L + 1,) first block of each layout.
        low: (K, 3) low corner of the bounding box of each block's pieces, m.
        high: (K, 3) high corner of this box, m.
        piece_first: (K + 1,) first index in `piece` of each block.
        piece: Indices of pieces in `CityGrid.low`, block by block.
    """

    first: np.ndarray
    low: np.ndarray
    high: np.ndarray
    piece_first: np.ndarray
    piece: np.ndarray


class Faces(NamedTuple):
    """Faces of the S shapes of a table, numbered through, and the edges of hulls.

    A box has six faces (low x, high x, low y and so on), a hull those of the table, any other shape
    one.

    Attributes:
        first: (S + 1,) id of the first face of each shape.
        edges: (E, 2) indices in `ShapeTable.face_planes` of the faces at each edge of a hull.
        edge_range: (S, 2) first edge of each hull, and the one after its last; an empty range if
            the faces of a hull are no closed surface, because of rounding.
        labels: (F,) uint8, label of each face: SKY, LAND, BUILDING, OBSTACLE or DRONE.
        shape: (F,) shape of each face; -1 for sky and ground.
        normal: (F, 3) outward unit normals, see `face_normals`.
    """

    first: np.ndarray
    edges: np.ndarray
    edge_range: np.ndarray
    labels: np.ndarray
    shape: np.ndarray
    normal: np.ndarray


def make_view_blocks(low: np.ndarray, high: np.ndarray, counts: Sequence[int]) -> ViewBlocks:
    """Group the pieces of city layouts by the square blocks in which their centres lie.

    Args:
        low: (T, 3) low corners of the bounding boxes of the pieces, layout by layout, m.
        high: (T, 3) high corners of these boxes, m.
        counts: Number of pieces of each of the L layouts.

    Returns:
        The blocks.
    """
    layout = np.repeat(np.arange(len(counts)), counts)
    square = np.floor((low + high)[:, :2] / (2 * BLOCK_SIDE)).astype(np.int64)
    keys, block = np.unique(
        np.concatenate([layout[:, None], square], axis=1), axis=0, return_inverse=True
    )
    block = block.reshape(-1)
    bounds = np.full((2, len(keys), 3), np.inf)
    np.minimum.at(bounds[0], block, low)
    np.minimum.at(bounds[1], block, -high)
    return ViewBlocks(
        first=np.searchsorted(keys[:, 0], np.arange(len(counts) + 1)),
        low=bounds[0],
        high=-bounds[1],
        piece_first=_starts(np.bincount(block, minlength=len(keys))),
        piece=np.argsort(block, kind="stable"),
    )


def make_faces(scenery: Scenery, is_load: np.ndarray | None = None) -> Faces:
    """Assign ids to the faces of the shapes of a scenery, and find the edges of its hulls.

    Args:
        scenery: The shapes.
        is_load: (N,) bool, drones that are loads, with the label of obstacles; None for none.
    """
    table = scenery.table
    shapes = len(table.kind)
    count = np.ones(shapes, dtype=np.int64)
    count[table.kind == BOX] = 6
    hull = table.kind == HULL
    count[hull] = (table.face_range[:, 1] - table.face_range[:, 0])[hull]
    label = np.full(shapes, BUILDING, dtype=np.uint8)
    label[: scenery.first_body] = DRONE
    if is_load is not None:
        label[: scenery.first_body][is_load] = OBSTACLE
    label[scenery.first_body : scenery.first_piece] = OBSTACLE
    edges, edge_range = _find_edges(table)
    return Faces(
        first=FIRST_FACE + _starts(count),
        edges=edges,
        edge_range=edge_range,
        labels=np.concatenate([np.array([SKY, LAND], dtype=np.uint8), np.repeat(label, count)]),
        shape=np.concatenate([[-1, -1], np.repeat(np.arange(shapes), count)]),
        normal=face_normals(table),
    )


def face_normals(table: ShapeTable) -> np.ndarray:
    """Return the outward normals of all faces, in the order of their ids.

    Args:
        table: The shapes.

    Returns:
        (F, 3) unit vectors in the axes of each shape: the z axis for the ground and for faces that
        are not flat, zero for the sky.
    """
    of_box = np.repeat(np.eye(3), 2, axis=0) * np.tile([-1.0, 1.0], 3)[:, None]
    up = np.array([[0.0, 0.0, 1.0]])
    normals = [np.zeros((1, 3)), up]
    for kind, (first, end) in zip(table.kind.tolist(), table.face_range.tolist(), strict=True):
        if kind == HULL:
            normals.append(table.face_planes[first:end, :3])
        else:
            normals.append(of_box if kind == BOX else up)
    return np.concatenate(normals)


def _starts(counts: np.ndarray) -> np.ndarray:
    """Return the first index of each group, and the number of all members."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _find_edges(table: ShapeTable) -> tuple[np.ndarray, np.ndarray]:
    """Find the edges of all hulls: see `Faces.edges` and `Faces.edge_range`."""
    # Each face goes along its edges counterclockwise, so that the face on the other side of an edge
    # goes along the same corners in the opposite direction.
    size = table.face_vertex_range[:, 1] - table.face_vertex_range[:, 0]
    face = np.repeat(np.arange(len(size)), size)
    start = table.face_vertices
    following = np.arange(1, len(start) + 1)
    following[table.face_vertex_range[:, 1] - 1] = table.face_vertex_range[:, 0]
    end = start[following]
    corners = max(1, len(table.vertices))
    forward, backward = start * corners + end, end * corners + start
    order = np.argsort(forward, kind="stable")
    found = order[np.minimum(np.searchsorted(forward[order], backward), len(order) - 1)]
    is_matched = forward[found] == backward
    chosen = np.flatnonzero(is_matched & (start < end))
    edges = np.stack([face[chosen], face[found[chosen]]], axis=1)
    edge_range = np.searchsorted(edges[:, 0], table.face_range).astype(np.int64)
    # A closed surface has two faces at each edge, and fulfils Euler's formula.
    sides = _starts(size)[table.face_range]
    matched = _starts(is_matched)[sides]
    vertices = table.vertex_range[:, 1] - table.vertex_range[:, 0]
    faces = table.face_range[:, 1] - table.face_range[:, 0]
    number = edge_range[:, 1] - edge_range[:, 0]
    is_closed = (np.diff(matched) == np.diff(sides))[:, 0] & (vertices - number + faces == 2)
    edge_range[~is_closed] = 0
    return edges.reshape(-1, 2).astype(np.int64), edge_range
