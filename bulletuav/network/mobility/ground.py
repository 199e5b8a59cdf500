"""Ground of mobile users: free cells and street graphs of all layouts of a task."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.city.model import City
from bulletuav.errors import finite
from bulletuav.network.mobility.raster import INSET, rasterise

OFF_GRID = -1
"""Node index that pads the neighbour lists of a street graph"""


class Graph(NamedTuple):
    """Street graphs of L layouts, padded to the same size.

    Attributes:
        node: Positions (L, S, 2) of nodes, m.
        neighbour: Adjacent nodes (L, S, K) of each node, int, padded with `OFF_GRID`.
    """

    node: np.ndarray
    neighbour: np.ndarray


class Ground:
    """Ground of L cities; layout l belongs to city l. Sizes may differ.

    Attributes:
        height: Height of users' devices above ground, m.
        raster: Free cells of all layouts, for kernels.
    """

    def __init__(self, cities: Sequence[City], height: float = 1.5, cell: float = 1.0) -> None:
        """Rasterise the free ground of cities.

        Args:
            cities: City of each layout.
            height: Height of users' devices above ground, m.
            cell: Edge length of the raster cells, m; narrower passages are closed.

        Raises:
            ValueError: If there is no city, a city has hills or no free cell, or a number is not
                positive.
        """
        for name, value in (("height", height), ("cell", cell)):
            if not finite(name, value) > 0:
                raise ValueError(f"{name} is {value!r} m: a number above 0 is needed")
        if not cities:
            raise ValueError("cities is empty: at least one city is needed")
        for city in cities:
            if city.ground is not None:
                raise ValueError(
                    f"city {city.name!r} has hills, and users walk on flat ground only: "
                    f"choose a city, or terrain with relief 0, such as 'forest'"
                )
        self.height = height
        self.raster = rasterise(cities, cell)
        self._cities = tuple(cities)
        # Indices of the free cells of each layout
        self._cells = [np.flatnonzero(free).astype(np.int32) for free in self.raster.free]
        for city, cells in zip(cities, self._cells, strict=True):
            if not len(cells):
                raise ValueError(
                    f"city {city.name!r} has no free cell of {cell:g} m: "
                    "reduce cell, or increase side"
                )

    @cached_property
    def graph(self) -> Graph:
        """Street graphs of all layouts, for kernels.

        Raises:
            ValueError: If a city has no streets, or a street of zero length.
        """
        return _graph(self._cities)

    @cached_property
    def _directed_streets(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Directed streets of each layout, see `_both_ways`."""
        return [_both_ways(city) for city in self._cities]

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw positions of users, uniformly distributed over the free cells.

        Args:
            rng: Random generator.
            layout: Index of the layout.
            count: Number of users.

        Returns:
            Positions (count, 3), m.
        """
        own = self._cells[layout]
        cell = self.raster.cell
        # Free cells, by column and row
        drawn = own[rng.integers(len(own), size=count)]
        index = np.divmod(drawn, self.raster.free.shape[1])
        corner = np.column_stack(index) * cell - self.raster.half_side
        # Uniform position inside each cell
        return self.raised(corner + rng.uniform(INSET, cell - INSET, (count, 2)))

    def street_places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw positions on the streets, uniformly distributed along them.

        Args:
            rng: Random generator.
            layout: Index of the layout.
            count: Number of users.

        Returns:
            Positions (count, 3): previous node, next node, and distance from the previous node, m.
        """
        streets, passed = self._directed_streets[layout]
        # Positions along the concatenated streets, and the street of each position
        along = rng.uniform(0, passed[-1], count)
        chosen = np.searchsorted(passed[1:-1], along, side="right")
        return np.column_stack([streets[chosen], along - passed[chosen]])

    def raised(self, places: np.ndarray) -> np.ndarray:
        """Return positions (count, 3) at user height above positions (count, 2), m."""
        return np.column_stack([places, np.full(len(places), self.height)])


def _graph(cities: Sequence[City]) -> Graph:
    """Return the street graphs of cities; raise ValueError for a city without streets."""
    for city in cities:
        if not len(city.streets.edges):
            raise ValueError(
                f"city {city.name!r} has no streets, which users need: "
                "see bulletuav.city.streets.free_streets"
            )
    # Sizes of the largest graph
    nodes = max(len(city.streets.nodes) for city in cities)
    degree = max(int(np.bincount(city.streets.edges.ravel()).max()) for city in cities)
    graph = Graph(
        node=np.zeros((len(cities), nodes, 2)),
        neighbour=np.full((len(cities), nodes, degree), OFF_GRID),
    )
    for node, neighbour, city in zip(graph.node, graph.neighbour, cities, strict=True):
        node[: len(city.streets.nodes)] = city.streets.nodes
        # Sort streets by start node; the rank is the index in the neighbour list
        streets = _both_ways(city)[0]
        streets = streets[np.argsort(streets[:, 0], kind="stable")]
        begin = streets[:, 0]
        rank = np.arange(len(streets)) - np.searchsorted(begin, begin)
        neighbour[begin, rank] = streets[:, 1]
    return graph


def _both_ways(city: City) -> tuple[np.ndarray, np.ndarray]:
    """Return the streets of a city in both directions.

    Returns:
        Nodes (2 E, 2), and cumulative length (2 E + 1,) of the streets before each, m.
    """
    edges = city.streets.edges
    streets = np.concatenate([edges, edges[:, ::-1]])
    along = np.diff(city.streets.nodes[streets], axis=1)[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    if not (lengths > 0).all():
        node = streets[lengths.argmin(), 0]
        raise ValueError(
            f"city {city.name!r} has a street of zero length at node {node}: remove it"
        )
    return streets, np.concatenate([[0], np.cumsum(lengths)])
