"""Grid of a city: the bounding boxes of its pieces, found by square cells, for compiled code."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Vec3Like
from bulletuav.geometry.solids import Solids

GRID_CELL = 25.0
"""Side of a cell, m: about a building."""
NO_LAYOUT = -1
"""Layout of a world in which nothing stands."""


class CityGrid(NamedTuple):
    """L layouts of a city, one of which may stand in each of W worlds; T pieces in all.

    Attributes:
        layout: (W,) index of the layout that stands in each world, or NO_LAYOUT.
        low: (T, 3) low corners of the bounding boxes of all pieces of all layouts, m.
        high: (T, 3) high corners of these boxes, m.
        first: (L, cells^2 + 1) bounds in `item`: the pieces in cell c of layout l are
            item[first[l, c] : first[l, c + 1]].
        item: Indices of pieces into `low` and `high`, cell by cell.
        boxes: (L,) bool, whether a layout is made of boxes alone.
        heights: (L, 2) heights between which all pieces of a layout are, m, with a metre to spare.
        reach: The grid covers [-reach, reach]^2, m.
        cells: Cells along each side of the grid; cell c is in column c // cells (along x) and row
            c % cells (along y).
    """

    layout: np.ndarray
    low: np.ndarray
    high: np.ndarray
    first: np.ndarray
    item: np.ndarray
    boxes: np.ndarray
    heights: np.ndarray
    reach: float
    cells: int


def make_city_grid(layouts: Sequence[Solids], num_worlds: int) -> CityGrid:
    """Sort the pieces of layouts into the cells of one grid.

    Args:
        layouts: The layouts of the city.
        num_worlds: W.

    Returns:
        The grid; no layout stands in any world yet.
    """
    # A square that holds all pieces of all layouts, at least two cells wide.
    bounds = np.concatenate([np.zeros((0, 2, 3)), *(solids.bounds for solids in layouts)])
    reach = float(np.abs(bounds[..., :2]).max(initial=GRID_CELL))
    count = math.ceil(2 * reach / GRID_CELL)
    city_grid = CityGrid(
        layout=np.full(num_worlds, NO_LAYOUT),
        low=bounds[:, 0].copy(),
        high=bounds[:, 1].copy(),
        first=np.zeros((len(layouts), count**2 + 1), dtype=np.int64),
        item=np.zeros(0, dtype=np.int64),
        boxes=np.array([not solids.hulls for solids in layouts], dtype=bool),
        heights=np.array([_height_range(solids) for solids in layouts]).reshape(-1, 2),
        reach=reach,
        cells=count,
    )
    items: list[int] = []
    piece = 0
    for first, solids in zip(city_grid.first, layouts, strict=True):
        # Put each piece into all cells that its bounding box touches.
        cells: list[list[int]] = [[] for _ in range(count**2)]
        for low, high in solids.bounds:
            left, right, bottom, top = cells_in_rectangle(
                city_grid, low[0], high[0], low[1], high[1]
            )
            for i in range(left, right):
                for j in range(bottom, top):
                    cells[i * count + j].append(piece)
            piece += 1
        # Lay the cells of this layout one after the other into the common list.
        first[:] = len(items) + np.cumsum([0] + [len(cell) for cell in cells])
        items += [p for cell in cells for p in cell]
    return city_grid._replace(item=np.array(items, dtype=np.int64))


def _height_range(solids: Solids) -> tuple[float, float]:
    """Return the heights between which all pieces and the ground are, a metre to spare."""
    lowest = solids.bounds[:, 0, 2].min(initial=0.0)
    highest = solids.bounds[:, 1, 2].max(initial=0.0)
    return lowest - 1.0, highest + 1.0


@func
def cells_in_rectangle(
    city_grid: CityGrid, west: float, east: float, south: float, north: float
) -> tuple[int, int, int, int]:
    """Return the cells that a rectangle touches; none where it lies outside the grid.

    Args:
        city_grid: The grid.
        west: Least x of the rectangle, m.
        east: Greatest x, m.
        south: Least y, m.
        north: Greatest y, m.

    Returns:
        The first column and the one after the last, the first row and the one after the last.
    """
    # Cells are counted from the south-west corner, which is at -reach
    scale = city_grid.cells / (2.0 * city_grid.reach)
    return (
        max(0, math.floor((west + city_grid.reach) * scale)),
        min(city_grid.cells, math.floor((east + city_grid.reach) * scale) + 1),
        max(0, math.floor((south + city_grid.reach) * scale)),
        min(city_grid.cells, math.floor((north + city_grid.reach) * scale) + 1),
    )


@func
def _is_separated(city_grid: CityGrid, p: int, low: Vec3Like, high: Vec3Like) -> bool:
    """Tell whether the bounding box of piece p and the box between two corners do not overlap."""
    # Boxes are apart if they are along any of the axes
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
    """Tell whether a box overlaps the bounding box of a piece that stands in a world.

    Args:
        city_grid: The grid.
        w: Index of the world.
        low: Low corner of the box, m.
        high: High corner of the box, m.
    """
    layout = city_grid.layout[w]
    if layout == NO_LAYOUT:
        return False
    # Only pieces in the cells that the box touches can overlap it.
    left, right, bottom, top = cells_in_rectangle(city_grid, low[0], high[0], low[1], high[1])
    for i in range(left, right):
        for j in range(bottom, top):
            cell = i * city_grid.cells + j
            for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                if not _is_separated(city_grid, city_grid.item[m], low, high):
                    return True
    return False
