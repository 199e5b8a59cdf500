"""What users on the ground walk on: free cells and street graphs of all layouts of a task."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.city.model import City
from bulletuav.errors import finite
from bulletuav.network.mobility.raster import INSET, rasterise

OFF_GRID = -1
"""Node that fills up a street graph's lists of neighbours"""


class Graph(NamedTuple):
    """Street graphs of L layouts; short lists are padded.

    Attributes:
        node: Positions (L, S, 2) of nodes, m.
        neighbour: Nodes (L, S, K) to which streets lead from each node, int, then `OFF_GRID`.
    """

    node: np.ndarray
    neighbour: np.ndarray


class Ground:
    """The ground of L cities; layout l is that of city l. Their sides may differ.

    Attributes:
        height: Height of users' devices above ground, m.
        raster: Free cells of all layouts, for kernels.
    """

    def __init__(self, cities: Sequence[City], height: float = 1.5, cell: float = 1.0) -> None:
        """Find the free cells of cities.

        Args:
            cities: City of each layout.
            height: Height of users' devices above ground, m.
            cell: Side of the raster's cells, m; narrower passages are closed.

        Raises:
            ValueError: There is no city, a city has no free cell, or a number is not above 0.
        """
        for name, value in (("height", height), ("cell", cell)):
            if not finite(name, value) > 0:
                raise ValueError(f"{name} is {value!r} m: a number above 0 is needed")
        if not cities:
            raise ValueError("cities is empty: give one or more")
        self.height = height
        self.raster = rasterise(cities, cell)
        self._cities = tuple(cities)
        # Indices of the free cells of each layout
        self._cells = [np.flatnonzero(free).astype(np.int32) for free in self.raster.free]
        for city, cells in zip(cities, self._cells, strict=True):
            if not len(cells):
                raise ValueError(
                    f"city {city.name!r} has no free cell of {cell:g} m: "
                    "lower cell, or give a greater side"
                )

    @cached_property
    def graph(self) -> Graph:
        """Street graphs of all layouts, for kernels.

        Raises:
            ValueError: A city has no streets, or a street of no length.
        """
        return _graph(self._cities)

    @cached_property
    def _directed_streets(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Streets of each layout, see `_both_ways`."""
        return [_both_ways(city) for city in self._cities]

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw positions of users, uniform over the free cells.

        Args:
            rng: Generator to draw from.
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
        corner = np.column_stack(index) * cell - self.raster.reach
        # A position in each of them
        return self.raised(corner + rng.uniform(INSET, cell - INSET, (count, 2)))

    def street_places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """Draw places on the streets, uniform along them.

        Args:
            rng: Generator to draw from.
            layout: Index of the layout.
            count: Number of users.

        Returns:
            Places (count, 3): the node behind, the node ahead, and the distance from the former, m.
        """
        streets, passed = self._directed_streets[layout]
        # Positions on all streets laid end to end, and the street in which each lies
        along = rng.uniform(0, passed[-1], count)
        chosen = np.searchsorted(passed[1:-1], along, side="right")
        return np.column_stack([streets[chosen], along - passed[chosen]])

    def raised(self, places: np.ndarray) -> np.ndarray:
        """Return positions (count, 3) at the height of users over places (count, 2), m."""
        return np.column_stack([places, np.full(len(places), self.height)])


def _graph(cities: Sequence[City]) -> Graph:
    """Return the street graphs of cities, or refuse a city without streets."""
    for city in cities:
        if not len(city.streets.edges):
            raise ValueError(
                f"city {city.name!r} has no streets: users need some, "
                "see bulletuav.city.streets.free_streets"
            )
    # Arrays for the largest graph
    nodes = max(len(city.streets.nodes) for city in cities)
    most = max(int(np.bincount(city.streets.edges.ravel()).max()) for city in cities)
    graph = Graph(
        node=np.zeros((len(cities), nodes, 2)),
        neighbour=np.full((len(cities), nodes, most), OFF_GRID),
    )
    for node, neighbour, city in zip(graph.node, graph.neighbour, cities, strict=True):
        node[: len(city.streets.nodes)] = city.streets.nodes
        # Sort streets by the node where they begin; their rank is the place in its list
        streets = _both_ways(city)[0]
        streets = streets[np.argsort(streets[:, 0], kind="stable")]
        begin = streets[:, 0]
        rank = np.arange(len(streets)) - np.searchsorted(begin, begin)
        neighbour[begin, rank] = streets[:, 1]
    return graph


def _both_ways(city: City) -> tuple[np.ndarray, np.ndarray]:
    """List the streets of a city walked either way.

    Returns:
        Their nodes (2 E, 2), and the length (2 E + 1,) of all streets before each, m.
    """
    edges = city.streets.edges
    streets = np.concatenate([edges, edges[:, ::-1]])
    along = np.diff(city.streets.nodes[streets], axis=1)[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    if not (lengths > 0).all():
        node = streets[lengths.argmin(), 0]
        raise ValueError(
            f"city {city.name!r} has a street of no length at node {node}: leave it out"
        )
    return streets, np.concatenate([[0], np.cumsum(lengths)])
