"""Graphs of streets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.city.graphs import join


@dataclass(frozen=True, eq=False)
class Streets:
    """A connected graph of centre lines on which one can walk: every point of an edge is outdoors.

    Attributes:
        nodes: (S, 2) crossings, and ends at the city's edge, m.
        edges: (E, 2) int, the nodes that a straight piece of street joins.
    """

    nodes: np.ndarray
    edges: np.ndarray


def grid_streets(lines: Sequence[np.ndarray], sides: np.ndarray) -> Streets:
    """Lay streets along x and along y, from edge to edge of a city.

    Args:
        lines: For x and for y the coordinates (K,) of the streets, m; ascending, in the city.
        sides: (2,) lengths of the city's ground about the origin, m.
    """
    stops = [
        np.concatenate([[-side / 2], own, [side / 2]])
        for own, side in zip(lines, sides, strict=True)
    ]
    nodes, edges = _lattice(*stops)
    middles = nodes[edges].mean(axis=1)
    return _connected(nodes, edges[_inside(middles, sides)])


def _inside(points: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Tell which points (..., 2) lie within the city, not on its edge."""
    within: np.ndarray = (np.abs(points) < sides / 2).all(axis=-1)
    return within


def free_streets(
    side: float,
    outdoors: Callable[[np.ndarray, float], np.ndarray],
    spacing: float = 15.0,
    margin: float = 1.0,
) -> Streets:
    """Lay streets in a city whose plan tells none.

    They are the greatest connected part of a lattice on free ground.

    Args:
        side: Of the city's square about the origin, m.
        outdoors: `City.outdoors`, which takes points and a margin.
        spacing: Length of the lattice's ways, m.
        margin: Ways are nowhere nearer to a wall than half of this, m.

    Raises:
        ValueError: There is no free ground.
    """
    count = int(side / spacing) + 1
    stops = spacing * (np.arange(count) - (count - 1) / 2)
    nodes, edges = _lattice(stops, stops)
    start, end = nodes[edges].swapaxes(0, 1)
    # Points along each way that are at most `margin` apart
    share = np.linspace(0, 1, int(spacing / margin) + 2)[:, None, None]
    points = start + share * (end - start)
    free = outdoors(points, margin).all(axis=0)
    if not free.any():
        raise ValueError(
            f"there is no room for streets between the buildings of a city of {side:g} m: "
            f"give a greater side"
        )
    return _connected(nodes, edges[free])


def _lattice(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (K L, 2) at all `x` (K,) and `y` (L,), and edges between neighbours."""
    grid = np.meshgrid(x, y, indexing="ij")
    nodes = np.stack(grid, axis=-1).reshape(-1, 2)
    # Neighbours along x, and along y
    index = np.arange(len(nodes)).reshape(len(x), len(y))
    pairs = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:])]
    edges = [np.stack([one.ravel(), two.ravel()], axis=1) for one, two in pairs]
    return nodes, np.concatenate(edges)


def _connected(nodes: np.ndarray, edges: np.ndarray) -> Streets:
    """Return the greatest connected part, without the nodes that are not in it."""
    part = np.arange(len(nodes))
    join(part, edges)
    # Both ends of an edge are in the same part
    greatest = np.bincount(part).argmax()
    kept = edges[part[edges[:, 0]] == greatest]
    used, renumbered = np.unique(kept, return_inverse=True)
    return Streets(nodes[used], renumbered.reshape(kept.shape))
