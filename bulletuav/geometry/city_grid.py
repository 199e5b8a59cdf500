"""Uniform grid over the bounding boxes of a city's pieces, for compiled queries."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Vec3Like
from bulletuav.geometry.solids import Solids

GRID_CELL = 25.0
"""Side of a cell, m: about the size of a building."""
NO_LAYOUT = -1
"""Layout index of a world without a city."""


class CityGrid(NamedTuple):
    """Grid of L city layouts with T pieces in total; each of W worlds has one layout or none.

    Attributes:
        layout: (W,) index of the layout in each world, or NO_LAYOUT.
        low: (T, 3) low corners of the bounding boxes of all pieces of all layouts, m.
        high: (T, 3) high corners of these boxes, m.
        first: (L, cells^2 + 1) bounds in `item`: the pieces in cell c of layout l are
            item[first[l, c] : first[l, c + 1]].
        item: Indices of pieces into `low` and `high`, cell by cell.
        boxes: (L,) bool, True if a layout consists of boxes only.
        heights: (L, 2) lower and upper bound of the heights of a layout's pieces, m, with a margin
            of 1 m.
        half_side: Half of the side of the grid, m: it covers [-half_side, half_side]^2.
        cells: Number of cells along each side of the grid; cell c is in column c // cells (along x)
            and row c % cells (along y).
    """

    layout: np.ndarray
    low: np.ndarray
    high: np.ndarray
    first: np.ndarray
    item: np.ndarray
    boxes: np.ndarray
    heights: np.ndarray
    half_side: float
    cells: int


def make_city_grid(layouts: Sequence[Solids], num_worlds: int) -> CityGrid:
    """Make the grid of the pieces of city layouts.

    Args:
        layouts: The layouts of the city.
        num_worlds: W.

    Returns:
        The grid; no layout is assigned to any world yet.
    """
    # A square that contains all pieces of all layouts, at least two cells wide.
    bounds = np.concatenate([np.zeros((0, 2, 3)), *(solids.bounds for solids in layouts)])
    half_side = float(np.abs(bounds[..., :2]).max(initial=GRID_CELL))
    count = math.ceil(2 * half_side / GRID_CELL)
    city_grid = CityGrid(
        layout=np.full(num_worlds, NO_LAYOUT),
        low=bounds[:, 0].copy(),
        high=bounds[:, 1].copy(),
        first=np.zeros((len(layouts), count**2 + 1), dtype=np.int64),
        item=np.zeros(0, dtype=np.int64),
        boxes=np.array([not solids.hulls for solids in layouts], dtype=bool),
        heights=np.array([_height_range(solids) for solids in layouts]).reshape(-1, 2),
        half_side=half_side,
        cells=count,
    )
    items: list[int] = []
    piece = 0
    for first, solids in zip(city_grid.first, layouts, strict=True):
        # Add each piece to all cells that its bounding box overlaps.
        cells: list[list[int]] = [[] for _ in range(count**2)]
        for low, high in solids.bounds:
            left, right, bottom, top = cells_in_rectangle(
                city_grid, low[0], high[0], low[1], high[1]
            )
            for i in range(left, right):
                for j in range(bottom, top):
                    cells[i * count + j].append(piece)
            piece += 1
        # Append the cells of this layout to the common list.
        first[:] = len(items) + np.cumsum([0] + [len(cell) for cell in cells])
        items += [p for cell in cells for p in cell]
    return city_grid._replace(item=np.array(items, dtype=np.int64))


def _height_range(solids: Solids) -> tuple[float, float]:
    """Return the bounds of the heights of all pieces and the ground, m, with a margin of 1 m."""
    lowest = solids.bounds[:, 0, 2].min(initial=0.0)
    highest = solids.bounds[:, 1, 2].max(initial=0.0)
    return lowest - 1.0, highest + 1.0


@func
def cells_in_rectangle(
    city_grid: CityGrid, west: float, east: float, south: float, north: float
) -> tuple[int, int, int, int]:
    """Return the range of cells that a rectangle overlaps; it is empty outside the grid.

    Args:
        city_grid: The grid.
        west: Minimum x of the rectangle, m.
        east: Maximum x, m.
        south: Minimum y, m.
        north: Maximum y, m.

    Returns:
        The first column and the one after the last, the first row and the one after the last.
    """
    # Cells are counted from the south-west corner, which is at -half_side
    scale = city_grid.cells / (2.0 * city_grid.half_side)
    return (
        max(0, math.floor((west + city_grid.half_side) * scale)),
        min(city_grid.cells, math.floor((east + city_grid.half_side) * scale) + 1),
        max(0, math.floor((south + city_grid.half_side) * scale)),
        min(city_grid.cells, math.floor((north + city_grid.half_side) * scale) + 1),
    )


@func
def _is_separated(city_grid: CityGrid, p: int, low: Vec3Like, high: Vec3Like) -> bool:
    """Return True if the bounding box of piece p and the box between two corners do not overlap."""
    # Boxes are separated if their intervals are disjoint along any axis
    apart: bool = (
        city_grid.low[p, 0] > high[0]
        or city_grid.high[p, 0] < low[0]
        or city_grid.low[p, 1] > high[1]
        or city_grid.high[p, 1] < low[1]
        or city_grid.low[p, 2] > high[2]
        or city_grid.high[p, 2] < low[2]
    )
    return apart


@func
def overlaps_piece(city_grid: CityGrid, w: int, low: Vec3Like, high: Vec3Like) -> bool:
    """Check whether a box overlaps the bounding box of any piece of a world's city.

    Args:
        city_grid: The grid.
        w: Index of the world.
        low: Low corner of the box, m.
        high: High corner of the box, m.

    Returns:
        True if it overlaps a box.
    """
    layout = city_grid.layout[w]
    if layout == NO_LAYOUT:
        return False
    # Only pieces in the cells that the box overlaps can overlap it.
    left, right, bottom, top = cells_in_rectangle(city_grid, low[0], high[0], low[1], high[1])
    for i in range(left, right):
        for j in range(bottom, top):
            cell = i * city_grid.cells + j
            for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                if not _is_separated(city_grid, city_grid.item[m], low, high):
                    return True
    return False
