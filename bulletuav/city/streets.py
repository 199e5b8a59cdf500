"""Graphs of streets."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Streets:
    """A connected graph of centre lines on which one can walk: every point of an edge is outdoors.

    nodes  (S, 2) crossings, and ends at the city's edge, m
    edges  (E, 2) int, the nodes that a straight piece of street joins
    """

    nodes: np.ndarray
    edges: np.ndarray


def grid_streets(lines: np.ndarray, side: float) -> Streets:
    """Streets along x = `lines` (m, ascending, within the city) and y = `lines`, from edge to edge of the city."""
    nodes, edges = _lattice(np.concatenate([[-side / 2], lines, [side / 2]]))
    return _connected(nodes, edges[_inside(nodes[edges].mean(axis=1), side)])


def _inside(points: np.ndarray, side: float) -> np.ndarray:
    return (np.abs(points) < side / 2).all(axis=-1)


def free_streets(
    side: float,
    outdoors: Callable[[np.ndarray, float], np.ndarray],
    spacing: float = 15.0,
    margin: float = 1.0,
) -> Streets:
    """Streets of a city whose plan tells none: the greatest connected part of a lattice on free ground.

    `outdoors(points, margin)` is that of a `City`; the lattice's ways are `spacing` m long and nowhere nearer than half of
    `margin` m to a wall. Raises ValueError where there is no free ground.
    """
    count = int(side / spacing) + 1
    nodes, edges = _lattice(spacing * (np.arange(count) - (count - 1) / 2))
    start, end = nodes[edges].swapaxes(0, 1)
    along = np.linspace(0, 1, int(spacing / margin) + 2)[
        :, None, None
    ]  # points at most `margin` apart
    free = outdoors(start + along * (end - start), margin).all(axis=0)
    if not free.any():
        raise ValueError(
            f"there is no room for streets between the buildings of a city of {side:g} m: give a greater side"
        )
    return _connected(nodes, edges[free])


def _lattice(stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (K^2, 2) at all x and y of `stops` (K,), and the edges (2 K (K - 1), 2) between neighbours."""
    nodes = np.stack(np.meshgrid(stops, stops, indexing="ij"), axis=-1).reshape(-1, 2)
    index = np.arange(len(nodes)).reshape(len(stops), len(stops))
    pairs = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
    return nodes, np.concatenate(
        [np.stack([one.ravel(), two.ravel()], axis=1) for one, two in pairs]
    )


def _connected(nodes: np.ndarray, edges: np.ndarray) -> Streets:
    """The greatest connected part, without the nodes that are not in it."""
    from scipy.sparse import coo_array  # which takes long to import
    from scipy.sparse.csgraph import connected_components

    pairs = edges.T.astype(np.int32)  # which is all that older SciPy finds its way in
    graph = coo_array((np.ones(len(edges)), pairs), shape=(len(nodes), len(nodes)))
    part = connected_components(graph, directed=False)[1]
    kept = edges[part[edges[:, 0]] == np.bincount(part).argmax()]
    used, renumbered = np.unique(kept, return_inverse=True)
    return Streets(nodes[used], renumbered.reshape(kept.shape))
