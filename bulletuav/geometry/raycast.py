"""Rays through cities of boxes without the engine: the same answers, many times as fast.

A ray walks through the cells of the atlas (J. Amanatides and A. Woo, A fast voxel traversal algorithm for ray tracing,
1987), and in each meets the boxes by the slab method (T. Kay and J. Kajiya, Ray tracing complex scenes, 1986). The engine
takes the corners of its triangles a little wide: rays that graze an edge within a millimetre may differ.
"""

import math

import numpy as np

from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.shapes import inside_box, slab
from bulletuav.kernel import func, kernel


@func
def _surface(start, change, low, high):
    """Share at which a ray first crosses the surface of a box, inf where it does not within its length."""
    enters, leaves = inside_box(start, change, low, high)
    if enters > leaves or leaves < 0.0 or enters > 1.0:
        return np.inf
    if enters >= 0.0:
        return enters
    return leaves if leaves <= 1.0 else np.inf


@func
def _next_line(start, change, cell, step, city_grid):
    """Share at which a ray passes from column (or row) `cell` to the next in the direction `step`; inf if never."""
    if step == 0:
        return np.inf
    line = 2.0 * city_grid.reach / city_grid.cells * (cell + max(step, 0)) - city_grid.reach
    return (line - start) / change


@func
def _buildings(city_grid, layout, start, change):
    """Share at which a ray meets the first box of a layout, 1 if none."""
    least, last = slab(
        start[2], change[2], city_grid.heights[layout, 0], city_grid.heights[layout, 1]
    )
    least, last = (
        max(least, 0.0),
        min(last, 1.0),
    )  # between them it is over the grid, and no higher than roofs
    for k in range(2):
        one, two = slab(start[k], change[k], -city_grid.reach, city_grid.reach)
        least, last = max(least, one), min(last, two)
    if least > last:
        return 1.0
    scale = 0.5 * city_grid.cells / city_grid.reach
    column = min(
        max(math.floor((start[0] + least * change[0] + city_grid.reach) * scale), 0),
        city_grid.cells - 1,
    )
    row = min(
        max(math.floor((start[1] + least * change[1] + city_grid.reach) * scale), 0),
        city_grid.cells - 1,
    )
    east = 1 if change[0] > 0.0 else -1 if change[0] < 0.0 else 0
    north = 1 if change[1] > 0.0 else -1 if change[1] < 0.0 else 0
    found = np.inf
    while 0 <= column < city_grid.cells and 0 <= row < city_grid.cells:
        cell = column * city_grid.cells + row
        for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
            p = city_grid.item[m]
            low = (city_grid.low[p, 0], city_grid.low[p, 1], city_grid.low[p, 2])
            high = (city_grid.high[p, 0], city_grid.high[p, 1], city_grid.high[p, 2])
            found = min(found, _surface(start, change, low, high))
        across, along = (
            _next_line(start[0], change[0], column, east, city_grid),
            _next_line(start[1], change[1], row, north, city_grid),
        )
        if min(across, along) >= min(last, found):
            break
        if across <= along:
            column += east
        else:
            row += north
    return min(found, 1.0)


@kernel
def walk(city_grid, start, end, world, obstacles):
    """(M,) fractions of rays (M, 3) before they meet ground or a box, as `Engine.cast_rays` tells, and (R,) which are left.

    Left, for the engine, are all where there are `obstacles`, and those in layouts that are not boxes alone.
    """
    fraction, left = np.ones(world.shape[0]), [0 for _ in range(0)]
    for m in range(world.shape[0]):
        layout = city_grid.layout[world[m]]
        if obstacles or (layout != NO_LAYOUT and not city_grid.boxes[layout]):
            left.append(m)
            continue
        here = (start[m, 0], start[m, 1], start[m, 2])
        change = (end[m, 0] - here[0], end[m, 1] - here[1], end[m, 2] - here[2])
        if here[2] * end[m, 2] <= 0.0 and change[2] != 0.0:  # through the ground, from either side
            fraction[m] = min(1.0, -here[2] / change[2])
        if layout != NO_LAYOUT:
            fraction[m] = min(fraction[m], _buildings(city_grid, layout, here, change))
    return fraction, np.array(left, dtype=np.int64)
