"""Street graphs of cities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bulletuav.geometry.graphs import connect_components


@dataclass(frozen=True, eq=False)
class Streets:
    """Connected graph of street centre lines; every point of an edge is outdoors.

    Attributes:
        nodes: (S, 2) crossings, and ends at the city's edge, m.
        edges: (E, 2) int, nodes of each straight street segment.
    """

    nodes: np.ndarray
    edges: np.ndarray


def grid_streets(lines: Sequence[np.ndarray], sides: np.ndarray) -> Streets:
    """Build a grid of streets along x and y, from edge to edge of a city.

    Args:
        lines: Coordinates (K,) of the streets along x and along y, m; ascending, inside the city.
        sides: (2,) lengths of the city's ground around the origin, m.
    """
    stops = [
        np.concatenate([[-side / 2], own, [side / 2]])
        for own, side in zip(lines, sides, strict=True)
    ]
    nodes, edges = _lattice(*stops)
    middles = nodes[edges].mean(axis=1)
    return _connected(nodes, edges[_inside(middles, sides)])


def _inside(points: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return which points (..., 2) are inside the city, not on its edge."""
    within: np.ndarray = (np.abs(points) < sides / 2).all(axis=-1)
    return within


def free_streets(
    side: float,
    outdoors: Callable[[np.ndarray, float], np.ndarray],
    spacing: float = 15.0,
    margin: float = 1.0,
) -> Streets:
    """Generate streets on the free ground of a city.

    The streets are the largest connected component of a lattice on free ground.

    Args:
        side: Side of the city's square around the origin, m.
        outdoors: `City.outdoors`, a function of points and a margin.
        spacing: Length of the lattice edges, m.
        margin: Streets keep at least half of this distance from walls, m.

    Raises:
        ValueError: If there is no free ground.
    """
    count = int(side / spacing) + 1
    stops = spacing * (np.arange(count) - (count - 1) / 2)
    nodes, edges = _lattice(stops, stops)
    start, end = nodes[edges].swapaxes(0, 1)
    # Points along each edge that are at most `margin` apart
    fraction = np.linspace(0, 1, int(spacing / margin) + 2)[:, None, None]
    points = start + fraction * (end - start)
    free = outdoors(points, margin).all(axis=0)
    if not free.any():
        raise ValueError(
            f"there is no space for streets between the buildings of a city of {side:g} m: set "
            f"side to {side + 2 * spacing + 2 * margin:.0f} m or more, to have ground around them"
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
    """Return the largest connected component, with its nodes only."""
    part = np.arange(len(nodes))
    connect_components(part, edges)
    # Both ends of an edge are in the same part
    largest = np.bincount(part).argmax()
    kept = edges[part[edges[:, 0]] == largest]
    used, renumbered = np.unique(kept, return_inverse=True)
    return Streets(nodes[used], renumbered.reshape(kept.shape))
