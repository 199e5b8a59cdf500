"""Where the pieces of cities are, for compiled code: their bounding boxes, found by the cells of a square grid."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.geometry.solids import Solids
from bulletuav.kernel import func

GRID_CELL = 25.0  # m, about a building
NO_LAYOUT = -1
"""Layout of a world in which nothing stands"""


class CityGrid(NamedTuple):
    """L layouts of a city, one of which may stand in each of W worlds.

    layout     (W,) which one stands there, or NO_LAYOUT
    low, high  (T, 3) corners of the bounding boxes of all pieces of all layouts, m
    first      (L, cells^2 + 1): the pieces in cell c of layout l are item[first[l, c] : first[l, c + 1]], indices into low
    boxes      (L,) bool: layouts of boxes alone
    heights     (L, 2) m, between which all pieces are, with a metre to spare
    reach      m, the grid covers [-reach, reach]^2 in cells x cells squares
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
    """The atlas of these layouts, none of which stands anywhere yet."""
    bounds = np.concatenate([np.zeros((0, 2, 3)), *(solids.bounds for solids in layouts)])
    reach = float(np.abs(bounds[..., :2]).max(initial=GRID_CELL))
    count = math.ceil(2 * reach / GRID_CELL)
    city_grid = CityGrid(
        np.full(num_worlds, NO_LAYOUT),
        bounds[:, 0].copy(),
        bounds[:, 1].copy(),
        np.zeros((len(layouts), count**2 + 1), dtype=np.int64),
        np.zeros(0, dtype=np.int64),
        np.array([not solids.hulls for solids in layouts], dtype=bool),
        np.array([_levels(solids) for solids in layouts]).reshape(-1, 2),
        reach,
        count,
    )
    items: list[int] = []
    piece = 0
    for first, solids in zip(city_grid.first, layouts, strict=True):
        cells: list[list[int]] = [[] for _ in range(count**2)]
        for low, high in solids.bounds:
            left, right, bottom, top = reached(city_grid, low[0], high[0], low[1], high[1])
            for i in range(left, right):
                for j in range(bottom, top):
                    cells[i * count + j].append(piece)
            piece += 1
        first[:] = len(items) + np.cumsum([0] + [len(cell) for cell in cells])
        items += [p for cell in cells for p in cell]
    return city_grid._replace(item=np.array(items, dtype=np.int64))


def _levels(solids: Solids) -> tuple[float, float]:
    return solids.bounds[:, 0, 2].min(initial=0.0) - 1.0, solids.bounds[:, 1, 2].max(
        initial=0.0
    ) + 1.0


@func
def reached(city_grid, west, east, south, north):
    """Columns from, to and rows from, to of the cells that a rectangle (m) touches; none where it lies outside the grid."""
    scale = city_grid.cells / (2.0 * city_grid.reach)
    return (
        max(0, math.floor((west + city_grid.reach) * scale)),
        min(city_grid.cells, math.floor((east + city_grid.reach) * scale) + 1),
        max(0, math.floor((south + city_grid.reach) * scale)),
        min(city_grid.cells, math.floor((north + city_grid.reach) * scale) + 1),
    )


@func
def meets(city_grid, w, low, high):
    """Whether the box between two corners, m, overlaps the bounding box of a piece that stands in world w."""
    layout = city_grid.layout[w]
    if layout == NO_LAYOUT:
        return False
    left, right, bottom, top = reached(city_grid, low[0], high[0], low[1], high[1])
    for i in range(left, right):
        for j in range(bottom, top):
            cell = i * city_grid.cells + j
            for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                p = city_grid.item[m]
                aside = city_grid.low[p, 0] > high[0] or city_grid.high[p, 0] < low[0]
                aside = aside or city_grid.low[p, 1] > high[1] or city_grid.high[p, 1] < low[1]
                if not (aside or city_grid.low[p, 2] > high[2] or city_grid.high[p, 2] < low[2]):
                    return True
    return False
