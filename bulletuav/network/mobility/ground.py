"""What users on the ground walk on: free cells of a raster, and graphs of streets, of all layouts of a task."""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from bulletuav.city.model import City
from bulletuav.errors import finite
from bulletuav.kernel import func, kernel

MARGIN = 0.1  # m, between free cells and walls
INSET = 1e-9  # m, between places in a cell and its sides, so that rounding puts none into the next
OFF_GRID = -1
"""Node where a street's list of neighbours has ended"""


class Raster(NamedTuple):
    """Free cells of L layouts: those wholly in bounds and `MARGIN` m or more from footprints; x by columns, y by rows.

    free   (L, C, C) bool
    side   (L,) of each layout's square, m
    cell   side of a cell, m
    reach  the cells cover [-reach, reach]^2, m
    """

    free: np.ndarray
    side: np.ndarray
    cell: float
    reach: float


class Graph(NamedTuple):
    """Streets of L layouts; short lists are padded.

    node       (L, S, 2) m
    neighbour  (L, S, K) int, the nodes to which streets lead from each, then OFF_GRID
    """

    node: np.ndarray
    neighbour: np.ndarray


class Ground:
    """The ground of L cities, layout l that of `cities[l]`; their sides may differ.

    height  of users' devices above it, m
    raster  for kernels, see `walk`
    """

    def __init__(self, cities: Sequence[City], height: float = 1.5, cell: float = 1.0):
        """`cell`: side of the raster's cells, m; narrower passages are closed.

        Raises ValueError where a city has no free cell.
        """
        for name, value in (("height", height), ("cell", cell)):
            if not finite(name, value) > 0:
                raise ValueError(f"{name} is {value!r} m: a number above 0 is needed")
        if not cities:
            raise ValueError("cities is empty: give one or more")
        self.height, self.raster, self._cities = height, _raster(cities, cell), tuple(cities)
        self._cells = [np.flatnonzero(free).astype(np.int32) for free in self.raster.free]
        for city, cells in zip(cities, self._cells, strict=True):
            if not len(cells):
                raise ValueError(
                    f"city {city.name!r} has no free cell of {cell:g} m: lower cell, or give a greater side"
                )

    @cached_property
    def graph(self) -> Graph:
        """Of streets, for kernels. Raises ValueError where a city has no streets, or a street of no length."""
        return _graph(self._cities)

    @cached_property
    def _ways(self) -> list[tuple[np.ndarray, np.ndarray]]:
        return [_both_ways(city) for city in self._cities]

    def places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """(count, 3) places for users, uniform over the free cells, m."""
        own, cell = self._cells[layout], self.raster.cell
        index = np.divmod(own[rng.integers(len(own), size=count)], self.raster.free.shape[1])
        corner = np.column_stack(index) * cell - self.raster.reach
        return self.raised(corner + rng.uniform(INSET, cell - INSET, (count, 2)))

    def street_places(self, rng: np.random.Generator, layout: int, count: int) -> np.ndarray:
        """(count, 3) places on the streets, uniform along them: the node behind, the node ahead, and m from the first."""
        ways, passed = self._ways[layout]
        along = rng.uniform(0, passed[-1], count)
        way = np.searchsorted(passed[1:-1], along, side="right")
        return np.column_stack([ways[way], along - passed[way]])

    def raised(self, places: np.ndarray) -> np.ndarray:
        """(count, 3) the places (count, 2) at the height of users, m."""
        return np.column_stack([places, np.full(len(places), self.height)])


def _raster(cities: Sequence[City], cell: float) -> Raster:
    """One grid for all, about the origin."""
    count = int(max(city.side for city in cities) / cell)
    free = np.zeros((len(cities), count, count), dtype=bool)
    raster = Raster(free, np.array([city.side for city in cities]), cell, count * cell / 2)
    lines = np.arange(count + 1) * cell - raster.reach
    for own, city in zip(free, cities, strict=True):
        reached = np.abs(lines) <= city.side / 2 * (1 + 1e-12)  # but for rounding
        inside = reached[:-1] & reached[1:]
        own[:] = inside[:, None] & inside
        for outline in city.footprints:
            cover(own, np.ascontiguousarray(outline), cell, raster.reach)
    return raster


def _graph(cities: Sequence[City]) -> Graph:
    for city in cities:
        if not len(city.streets.edges):
            raise ValueError(
                f"city {city.name!r} has no streets: users need some, see bulletuav.city.streets.free_streets"
            )
    nodes = max(len(city.streets.nodes) for city in cities)
    most = max(int(np.bincount(city.streets.edges.ravel()).max()) for city in cities)
    graph = Graph(np.zeros((len(cities), nodes, 2)), np.full((len(cities), nodes, most), OFF_GRID))
    for node, neighbour, city in zip(*graph, cities, strict=True):
        node[: len(city.streets.nodes)] = city.streets.nodes
        ways = _both_ways(city)[0]
        ways = ways[np.argsort(ways[:, 0], kind="stable")]
        rank = np.arange(len(ways)) - np.searchsorted(ways[:, 0], ways[:, 0])
        neighbour[ways[:, 0], rank] = ways[:, 1]
    return graph


def _both_ways(city: City) -> tuple[np.ndarray, np.ndarray]:
    """Streets walked either way: their nodes (2 E, 2), and the length (2 E + 1,) of all before each, m."""
    edges = city.streets.edges
    ways = np.concatenate([edges, edges[:, ::-1]])
    length = np.linalg.norm(np.diff(city.streets.nodes[ways], axis=1)[:, 0], axis=1)
    if not (length > 0).all():
        raise ValueError(
            f"city {city.name!r} has a street of no length at node {ways[length.argmin(), 0]}: leave it out"
        )
    return ways, np.concatenate([[0], np.cumsum(length)])


@kernel
def cover(free, outline, cell, reach):
    """Take from `free` (C, C) the cells that are nearer than `MARGIN` m to a convex outline (V, 2) that turns left.

    A cell, so much wider on all sides, is clear of it if one side of either parts them (separating axes, S. Gottschalk,
    M. Lin, D. Manocha, OBBTree, SIGGRAPH 1996).
    """
    half = 0.5 * cell + MARGIN
    low = np.empty(2, dtype=np.int64)
    high = np.empty(2, dtype=np.int64)
    for axis in range(2):
        low[axis] = max(0, math.floor((outline[:, axis].min() - MARGIN + reach) / cell))
        high[axis] = min(
            len(free), math.floor((outline[:, axis].max() + MARGIN + reach) / cell) + 1
        )
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            x, y = (i + 0.5) * cell - reach, (j + 0.5) * cell - reach
            clear = False
            for k in range(len(outline)):
                end = outline[(k + 1) % len(outline)]
                out_x, out_y = end[1] - outline[k, 1], outline[k, 0] - end[0]
                gap = out_x * (x - outline[k, 0]) + out_y * (y - outline[k, 1])
                clear = clear or gap > half * (abs(out_x) + abs(out_y))
            free[i, j] = free[i, j] and clear


@func
def length(x, y):
    """Of a vector; `math.hypot` costs ten times as much."""
    return math.sqrt(x * x + y * y)


@func
def cell_of(place, raster):
    """Column of an x, or row of a y, m."""
    return math.floor((place + raster.reach) / raster.cell)


@func
def is_free(raster, layout, column, row):
    """Whether there is such a cell and it is free."""
    count = raster.free.shape[1]
    return 0 <= column < count and 0 <= row < count and raster.free[layout, column, row]


@func
def within(place, index, raster):
    """`place` (x or y, m), moved into its column or row `index` where rounding left it outside."""
    line = index * raster.cell - raster.reach
    return min(max(place, line + INSET), line + raster.cell - INSET)


@func
def walk(raster, layout, x, y, way_x, way_y):
    """Straight on from (x, y) m by `way` m through free cells: x, y of the end, the share gone, and what stopped it.

    The end is in the last free cell. Stopped across axis 0 (x) or 1 (y) by the next cell, -1: not at all; one who is in no
    free cell stays (share 0). Cells are visited by J. Amanatides and A. Woo, A fast voxel traversal algorithm, 1987.
    """
    column, row = cell_of(x, raster), cell_of(y, raster)
    if not is_free(raster, layout, column, row):
        return x, y, 0.0, -1
    east, north = 1 if way_x > 0.0 else -1, 1 if way_y > 0.0 else -1
    next_x = (
        ((column + max(east, 0)) * raster.cell - raster.reach - x) / way_x
        if way_x != 0.0
        else np.inf
    )
    next_y = (
        ((row + max(north, 0)) * raster.cell - raster.reach - y) / way_y if way_y != 0.0 else np.inf
    )
    share, stopped = 1.0, -1
    while min(next_x, next_y) < 1.0:
        if next_x <= next_y:
            if not is_free(raster, layout, column + east, row):
                share, stopped = next_x, 0
                break
            column += east
            next_x += raster.cell / abs(way_x)
        else:
            if not is_free(raster, layout, column, row + north):
                share, stopped = next_y, 1
                break
            row += north
            next_y += raster.cell / abs(way_y)
    return (
        within(x + share * way_x, column, raster),
        within(y + share * way_y, row, raster),
        share,
        stopped,
    )


@func
def bounce(raster, layout, x, y, way_x, way_y):
    """As `walk`, but turned at walls like light by mirrors: x, y of the end, and -1 for each axis turned about, or 1."""
    turned_x, turned_y, left = 1.0, 1.0, 1.0
    stopped = 0
    while stopped >= 0 and left > 0.0:
        x, y, share, stopped = walk(
            raster, layout, x, y, left * turned_x * way_x, left * turned_y * way_y
        )
        left *= 1.0 - share
        if stopped == 0:
            turned_x = -turned_x
        elif stopped == 1:
            turned_y = -turned_y
    return x, y, turned_x, turned_y
