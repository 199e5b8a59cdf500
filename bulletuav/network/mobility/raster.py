"""The free cells of cities as a raster, and straight walks through them."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bulletuav.city.model import City
from bulletuav.compiled.kernel import allocating, func

MARGIN = 0.1
"""Distance between free cells and walls, m"""
INSET = 1e-9
"""Least distance of positions from the sides of their cell, m: rounding puts none into the next"""


class Raster(NamedTuple):
    """Free cells of L layouts, x by columns and y by rows.

    Free cells are wholly in bounds, and `MARGIN` m or more from footprints of buildings.

    Attributes:
        free: Whether (L, C, C) each cell is free.
        sides: Lengths (L, 2) of each layout's ground along x and y, m.
        cell: Side of a cell, m.
        reach: Half of the side of the raster, m: cells cover [-reach, reach]^2.
    """

    free: np.ndarray
    sides: np.ndarray
    cell: float
    reach: float


def rasterise(cities: Sequence[City], cell: float) -> Raster:
    """Find the free cells of cities on one grid about the origin.

    Args:
        cities: City of each layout.
        cell: Side of a cell, m.
    """
    count = int(max(city.sides.max() for city in cities) / cell)
    raster = Raster(
        free=np.zeros((len(cities), count, count), dtype=bool),
        sides=np.array([city.sides for city in cities]),
        cell=cell,
        reach=count * cell / 2,
    )
    # Lines between columns, and alike between rows
    lines = np.arange(count + 1) * cell - raster.reach
    for own, city in zip(raster.free, cities, strict=True):
        # Cells between two lines in bounds are in bounds; allow for rounding
        reached = np.abs(lines) <= city.sides[:, None] / 2 * (1 + 1e-12)
        inside = reached[:, :-1] & reached[:, 1:]
        own[:] = inside[0][:, None] & inside[1]
        for outline in city.footprints:
            block_outline(own, np.ascontiguousarray(outline), cell, raster.reach)
    return raster


@allocating
def block_outline(free: np.ndarray, outline: np.ndarray, cell: float, reach: float) -> None:
    """Mark the cells that are nearer than `MARGIN` m to a convex outline as not free, in place.

    A cell that is widened by the margin on all sides is clear of the outline if one side of either
    parts them (separating axes: S. Gottschalk, M. Lin, D. Manocha, OBBTree, SIGGRAPH 1996).

    Args:
        free: Whether (C, C) each cell is free; changed.
        outline: Corners (V, 2) of the outline, which turns left, m.
        cell: Side of a cell, m.
        reach: Half of the side of the raster, m.
    """
    half = 0.5 * cell + MARGIN
    # Columns and rows that the outline can reach
    low = np.empty(2, dtype=np.int64)
    high = np.empty(2, dtype=np.int64)
    for axis in range(2):
        left = right = outline[0, axis]
        for k in range(1, len(outline)):
            left, right = min(left, outline[k, axis]), max(right, outline[k, axis])
        least = (left - MARGIN + reach) / cell
        most = (right + MARGIN + reach) / cell
        low[axis] = max(0, math.floor(least))
        high[axis] = min(len(free), math.floor(most) + 1)
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            # Centre of the cell
            x = (i + 0.5) * cell - reach
            y = (j + 0.5) * cell - reach
            # Is the widened cell wholly beyond any side of the outline?
            clear = False
            for k in range(len(outline)):
                end = outline[(k + 1) % len(outline)]
                out_x = end[1] - outline[k, 1]
                out_y = outline[k, 0] - end[0]
                gap = out_x * (x - outline[k, 0]) + out_y * (y - outline[k, 1])
                clear = clear or gap > half * (abs(out_x) + abs(out_y))
            free[i, j] = free[i, j] and clear


@func
def length(x: float, y: float) -> float:
    """Return the length of a vector; `math.hypot` costs ten times as much."""
    return math.sqrt(x * x + y * y)


@func
def cell_of(coordinate: float, raster: Raster) -> int:
    """Return the column of an x, or the row of a y, m."""
    return math.floor((coordinate + raster.reach) / raster.cell)


@func
def is_free(raster: Raster, layout: int, column: int, row: int) -> bool:
    """Tell whether there is such a cell and it is free."""
    count = raster.free.shape[1]
    # One expression: with an early return numba counts references, which makes walks 4 times slower
    return 0 <= column < count and 0 <= row < count and bool(raster.free[layout, column, row])


@func
def clamp_to_cell(coordinate: float, index: int, raster: Raster) -> float:
    """Return an x or y (m), moved into its column or row where rounding left it outside."""
    line = index * raster.cell - raster.reach
    return min(max(coordinate, line + INSET), line + raster.cell - INSET)


@func
def walk(
    raster: Raster, layout: int, x: float, y: float, way_x: float, way_y: float
) -> tuple[float, float, float, int]:
    """Walk straight on through free cells, up to the first that is not free.

    Cells are visited by J. Amanatides and A. Woo, A fast voxel traversal algorithm, 1987.

    Args:
        raster: Free cells of all layouts.
        layout: Index of the layout.
        x: Position at the start, m.
        y: Position at the start, m.
        way_x: Displacement along x if nothing is in the way, m.
        way_y: Displacement along y if nothing is in the way, m.

    Returns:
        x and y of the end, m, in the last free cell; the share of the way that is gone; and the
        axis, 0 (x) or 1 (y), across which the next cell stopped the walk, or -1 if none did. Who
        starts in no free cell stays: the share is 0, and the axis -1.
    """
    # Who stands in a wall stays
    column = cell_of(x, raster)
    row = cell_of(y, raster)
    if not is_free(raster, layout, column, row):
        return x, y, 0.0, -1
    # Share of the way at which the next column and the next row begin
    east = 1 if way_x > 0.0 else -1
    north = 1 if way_y > 0.0 else -1
    next_x = np.inf
    next_y = np.inf
    if way_x != 0.0:
        next_x = ((column + max(east, 0)) * raster.cell - raster.reach - x) / way_x
    if way_y != 0.0:
        next_y = ((row + max(north, 0)) * raster.cell - raster.reach - y) / way_y
    # The whole way, unless something is in it
    share = 1.0
    stopped = -1
    # Enter the cells on the way one by one, until one is not free
    while min(next_x, next_y) < 1.0:
        # Whichever side of the cell is reached first
        if next_x <= next_y:
            if not is_free(raster, layout, column + east, row):
                share = next_x
                stopped = 0
                break
            column += east
            next_x += raster.cell / abs(way_x)
        else:
            if not is_free(raster, layout, column, row + north):
                share = next_y
                stopped = 1
                break
            row += north
            next_y += raster.cell / abs(way_y)
    # Rounding may have left the end beyond the side of its cell
    end_x = clamp_to_cell(x + share * way_x, column, raster)
    end_y = clamp_to_cell(y + share * way_y, row, raster)
    return end_x, end_y, share, stopped


@func
def bounce(
    raster: Raster, layout: int, x: float, y: float, way_x: float, way_y: float
) -> tuple[float, float, float, float]:
    """Walk through free cells, turned at walls as light is by mirrors.

    Args:
        raster: Free cells of all layouts.
        layout: Index of the layout.
        x: Position at the start, m.
        y: Position at the start, m.
        way_x: Displacement along x if nothing is in the way, m.
        way_y: Displacement along y if nothing is in the way, m.

    Returns:
        x and y of the end, m; and for each axis -1 if the walk is turned about in it, else 1.
    """
    turned_x = 1.0
    turned_y = 1.0
    left = 1.0
    stopped = 0
    while stopped >= 0 and left > 0.0:
        x, y, share, stopped = walk(
            raster, layout, x, y, left * turned_x * way_x, left * turned_y * way_y
        )
        # Go on with the rest of the way, turned about in the axis of the wall
        left *= 1.0 - share
        if stopped == 0:
            turned_x = -turned_x
        elif stopped == 1:
            turned_y = -turned_y
    return x, y, turned_x, turned_y
