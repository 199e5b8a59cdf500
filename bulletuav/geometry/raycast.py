"""Ray casting against the scenery and drones in compiled code, much faster than in Bullet.

Rays hit surfaces from both sides: a ray that starts inside an obstacle, an added body or a building
hits the surface where it leaves. Drones are hit from outside only: a ray that starts inside a drone
does not hit this drone. Bullet, compared with it, mostly misses obstacles in which a ray starts.

In a city a ray traverses the cells of the city's grid. In each cell it is intersected with boxes by
the slab method, and with hulls by the planes of their faces (half-spaces). Bullet enlarges the
corners of its triangles slightly, so that rays that graze an edge within a millimetre may differ.

A ray has the points start + t change, m, with t from 0 to 1: its fraction.

References:
    J. Amanatides and A. Woo, A fast voxel traversal algorithm for ray tracing (1987).
    T. Kay and J. Kajiya, Ray tracing complex scenes (1986).
    M. Cyrus and J. Beck, Generalized two- and three-dimensional clipping (1978).
"""

import math
from typing import Protocol

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.city_grid import NO_LAYOUT, CityGrid
from bulletuav.geometry.closest_approach import closest_squared_distances
from bulletuav.geometry.convex import ShapeTable
from bulletuav.geometry.rotation import Quat4Like, Vec3Like, minus, point, quat4, to_body, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import HULL, intersect_box, intersect_primitive, intersect_slab


class Poses(Protocol):
    """Positions and attitudes of W worlds of N drones, as ray casting needs them."""

    @property
    def position(self) -> np.ndarray:
        """Centres of mass (W, N, 3), m."""

    @property
    def quaternion(self) -> np.ndarray:
        """Attitudes (W, N, 4), body to world, (x, y, z, w)."""


@func
def _intersect_hull(
    table: ShapeTable, s: int, start: Vec3Like, change: Vec3Like
) -> tuple[float, float]:
    """Intersect a line with hull s, in its axes, by its half-spaces; see `intersect_primitive`."""
    enters = -np.inf
    leaves = np.inf
    for f in range(table.face_range[s, 0], table.face_range[s, 1]):
        along = 0.0
        above = -table.face_planes[f, 3]
        for k in range(3):
            along += table.face_planes[f, k] * change[k]
            above += table.face_planes[f, k] * start[k]
        # A line parallel to a face is always or never behind it.
        if along == 0.0:
            if above > 0.0:
                return np.inf, -np.inf
        elif along < 0.0:
            enters = max(enters, -above / along)
        else:
            leaves = min(leaves, -above / along)
    return enters, leaves


@func
def intersect_shape(
    table: ShapeTable, s: int, start: Vec3Like, change: Vec3Like
) -> tuple[float, float]:
    """Intersect a line with a shape of a table.

    Args:
        table: The shapes.
        s: Index of the shape, which is no half-space.
        start: Point of the line at t = 0 in the shape's axes, m.
        change: Vector from there to the point at t = 1, m.

    Returns:
        The values of t at entry and exit; the entry is larger if the line misses the shape.
    """
    if table.kind[s] == HULL:
        return _intersect_hull(table, s, start, change)
    return intersect_primitive(table.kind[s], point(table.half, s), start, change)


@func
def _first_hit(enters: float, leaves: float) -> float:
    """Return the fraction at which a ray first hits a surface, inf if it does not.

    Args:
        enters: Fraction at which its line enters the shape.
        leaves: Fraction at which its line leaves the shape; less than `enters` if the line misses
            it.
    """
    if enters > leaves or leaves < 0.0 or enters > 1.0:
        return np.inf
    if enters >= 0.0:
        return enters
    # A ray that starts inside hits the surface where it leaves.
    return leaves if leaves <= 1.0 else np.inf


@func
def _cast_in_cell(
    city_grid: CityGrid,
    table: ShapeTable,
    piece_place: np.ndarray,
    first_piece: int,
    layout: int,
    cell: int,
    start: Vec3Like,
    change: Vec3Like,
    found: float,
) -> float:
    """Return the fraction at which a ray hits a piece of one cell, or `found` if that is less."""
    for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
        p = city_grid.item[m]
        low = point(city_grid.low, p)
        high = point(city_grid.high, p)
        enters, leaves = intersect_box(start, change, low, high)
        # For a hull, this was the bounding box.
        if not city_grid.boxes[layout] and enters <= leaves and table.kind[first_piece + p] == HULL:
            here = minus(start, point(piece_place, p))
            enters, leaves = _intersect_hull(table, first_piece + p, here, change)
        found = min(found, _first_hit(enters, leaves))
    return found


@func
def _cell_index(place: float, city_grid: CityGrid) -> int:
    """Return the column (or row) of a coordinate (m), clamped to the grid."""
    scale = 0.5 * city_grid.cells / city_grid.half_side
    return min(max(math.floor((place + city_grid.half_side) * scale), 0), city_grid.cells - 1)


@func
def _cell_step(change: float) -> int:
    """Return the direction in which a ray crosses columns (or rows): 1, -1, or 0 for none."""
    if change > 0.0:
        return 1
    return -1 if change < 0.0 else 0


@func
def _next_boundary(start: float, change: float, cell: int, step: int, city_grid: CityGrid) -> float:
    """Return the fraction at which a ray reaches the next column (or row), inf if never."""
    if step == 0:
        return np.inf
    line = 2.0 * city_grid.half_side / city_grid.cells * (cell + max(step, 0)) - city_grid.half_side
    return (line - start) / change


@func
def _clip_to_grid(
    city_grid: CityGrid, layout: int, start: Vec3Like, change: Vec3Like
) -> tuple[float, float]:
    """Return the fractions between which a ray is within the box of the grid and its pieces."""
    # Clip to the heights of the pieces
    lowest = city_grid.heights[layout, 0]
    highest = city_grid.heights[layout, 1]
    entry, last = intersect_slab(start[2], change[2], lowest, highest)
    entry = max(entry, 0.0)
    last = min(last, 1.0)
    # Clip to the square of the grid
    for k in range(2):
        one, two = intersect_slab(start[k], change[k], -city_grid.half_side, city_grid.half_side)
        entry = max(entry, one)
        last = min(last, two)
    return entry, last


@func
def _cast_city(
    city_grid: CityGrid,
    table: ShapeTable,
    piece_place: np.ndarray,
    first_piece: int,
    layout: int,
    start: Vec3Like,
    change: Vec3Like,
) -> float:
    """Return the fraction at which a ray first hits a piece of a layout, 1 if it hits none."""
    # Above the roofs and outside the grid nothing is hit
    entry, last = _clip_to_grid(city_grid, layout, start, change)
    if entry > last:
        return 1.0
    # Start in the cell where the ray enters the grid.
    column = _cell_index(start[0] + entry * change[0], city_grid)
    row = _cell_index(start[1] + entry * change[1], city_grid)
    east = _cell_step(change[0])
    north = _cell_step(change[1])
    found = np.inf
    while 0 <= column < city_grid.cells and 0 <= row < city_grid.cells:
        cell = column * city_grid.cells + row
        found = _cast_in_cell(
            city_grid, table, piece_place, first_piece, layout, cell, start, change, found
        )
        # Step to the cell whose boundary is nearest, unless the ray ends or hits a piece before.
        across = _next_boundary(start[0], change[0], column, east, city_grid)
        along = _next_boundary(start[1], change[1], row, north, city_grid)
        if min(across, along) >= min(last, found):
            break
        if across <= along:
            column += east
        else:
            row += north
    return min(found, 1.0)


@func
def _intersect_posed_shape(
    table: ShapeTable,
    s: int,
    place: Vec3Like,
    quaternion: Quat4Like,
    start: Vec3Like,
    end: Vec3Like,
) -> tuple[float, float]:
    """Intersect a ray with a shape at a pose; see `intersect_shape`."""
    # Most rays miss the bounding sphere, which is checked first.
    here = minus(start, place)
    there = minus(end, place)
    if closest_squared_distances(here, there)[1] > table.radius[s] * table.radius[s]:
        return np.inf, -np.inf
    # Intersect in the axes of the shape.
    body_here = to_body(quaternion, here)
    body_change = to_body(quaternion, minus(there, here))
    return intersect_shape(table, s, body_here, body_change)


@allocating
def cast_scenery_rays(
    scenery: Scenery, start: np.ndarray, end: np.ndarray, world: np.ndarray
) -> np.ndarray:
    """Cast rays against everything except drones, as `Engine.cast_rays` does.

    Args:
        scenery: Shapes and poses in each world.
        start: (M, 3) start points of the rays, m.
        end: (M, 3) end points of the rays, m.
        world: (M,) index of the world of each ray.

    Returns:
        The hit fraction (M,) of each ray, 1 if it hits nothing.
    """
    # Read the fields of the scenery once: nested tuples are slow in loops
    city_grid = scenery.city_grid
    table = scenery.table
    piece_place = scenery.piece_place
    body_place = scenery.place
    body_quaternion = scenery.quaternion
    first_piece = scenery.first_piece
    first_body = scenery.first_body
    bodies = body_place.shape[1]
    fraction = np.ones(world.shape[0])
    for m in range(world.shape[0]):
        w = world[m]
        layout = city_grid.layout[w]
        here = point(start, m)
        there = point(end, m)
        change = minus(there, here)
        # The ground stops rays from both sides.
        found = 1.0
        if here[2] * there[2] <= 0.0 and change[2] != 0.0:
            found = min(1.0, -here[2] / change[2])
        # First hit of ground, buildings and bodies
        if layout != NO_LAYOUT:
            hit = _cast_city(city_grid, table, piece_place, first_piece, layout, here, change)
            found = min(found, hit)
        for r in range(bodies):
            place = vec3(body_place, w, r)
            quaternion = quat4(body_quaternion, w, r)
            enters, leaves = _intersect_posed_shape(
                table, first_body + r, place, quaternion, here, there
            )
            found = min(found, _first_hit(enters, leaves))
        fraction[m] = found
    return fraction


@kernel
def cast_drone_rays(
    fraction: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    world: np.ndarray,
    swarm: Poses,
    mask: np.ndarray,
    table: ShapeTable,
) -> None:
    """Shorten rays to where they enter the collision shape of a drone.

    A ray does not hit a drone in which it starts.

    Args:
        fraction: (M,) hit fraction of each ray so far; lowered in place.
        start: (M, 3) start points of the rays, m.
        end: (M, 3) end points of the rays, m.
        world: (M,) index of the world of each ray.
        swarm: State of the drones.
        mask: (W, N) bool, drones that can be hit.
        table: Shapes, of which the first N are those of the drones.
    """
    for m in range(world.shape[0]):
        w = world[m]
        here = point(start, m)
        there = point(end, m)
        for i in range(mask.shape[1]):
            if mask[w, i]:
                # Fractions at which the ray enters and leaves the shape
                place = vec3(swarm.position, w, i)
                attitude = quat4(swarm.quaternion, w, i)
                enters, leaves = _intersect_posed_shape(table, i, place, attitude, here, there)
                # The entry is negative for a ray that starts inside
                if 0.0 <= enters <= leaves:
                    fraction[m] = min(fraction[m], enters)
