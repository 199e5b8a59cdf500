"""Clearance of drones: the exact signed distance to the nearest other shape, in compiled code."""

import numpy as np

from bulletuav.compiled.kernel import allocating, func, kernel
from bulletuav.geometry.city_grid import NO_LAYOUT, CityGrid, cells_in_rectangle
from bulletuav.geometry.gjk import gjk_distance
from bulletuav.geometry.rotation import Vec3, Vec3Like, axes, dot, minus, point, quat4, vec3
from bulletuav.geometry.scenery import Scenery
from bulletuav.geometry.shapes import distance_from_box

IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
"""Axes of a shape that is not rotated"""
NO_GUESS = (0.0, 0.0, 0.0)


@func
def _is_first_cell(
    city_grid: CityGrid, p: int, left: int, bottom: int, column: int, row: int
) -> bool:
    """Return True if a cell is the first cell of piece p in the range from `left`, `bottom`."""
    low = point(city_grid.low, p)
    high = point(city_grid.high, p)
    own_left, _, own_bottom, _ = cells_in_rectangle(city_grid, low[0], high[0], low[1], high[1])
    is_first: bool = column == max(left, own_left) and row == max(bottom, own_bottom)
    return is_first


@kernel
def _city_clearance(
    scenery: Scenery,
    w: int,
    i: int,
    place: Vec3,
    rotation: tuple[Vec3, Vec3, Vec3],
    found: float,
    scratch: np.ndarray,
) -> float:
    """Return the signed distance of drone i from the city, or `found` if that is less, m."""
    city_grid = scenery.city_grid
    layout = city_grid.layout[w]
    if layout == NO_LAYOUT:
        return found
    radius = scenery.table.radius[i]
    within = found + radius
    x = place[0]
    y = place[1]
    left, right, bottom, top = cells_in_rectangle(
        city_grid, x - within, x + within, y - within, y + within
    )
    for column in range(left, right):
        for row in range(bottom, top):
            cell = column * city_grid.cells + row
            for m in range(city_grid.first[layout, cell], city_grid.first[layout, cell + 1]):
                p = city_grid.item[m]
                # A piece is listed in several cells; measure it in the first one only.
                if not _is_first_cell(city_grid, p, left, bottom, column, row):
                    continue
                low = point(city_grid.low, p)
                high = point(city_grid.high, p)
                aside = distance_from_box(place, low, high)
                if aside > 0.0 and aside - radius >= found:
                    continue
                s = scenery.first_piece + p
                offset = minus(point(scenery.piece_place, p), place)
                table = scenery.table
                distance, _, _, _ = gjk_distance(
                    table, i, rotation, s, IDENTITY, offset, NO_GUESS, scratch
                )
                found = min(found, distance)
    return found


@allocating
def measure_clearance(
    scenery: Scenery,
    position: np.ndarray,
    quaternion: np.ndarray,
    mask: np.ndarray,
    max_distance: float,
    scratch: np.ndarray,
) -> np.ndarray:
    """Measure the distance of drones from the nearest ground, building, body or other drone.

    Bounding spheres and boxes exclude shapes that are farther than the nearest one found so far.

    Args:
        scenery: Shapes and poses in each world.
        position: (W, N, 3) positions of the drones, m.
        quaternion: (W, N, 4) attitudes of the drones, body to world.
        mask: (W, N) bool, drones to measure; other drones are ignored.
        max_distance: Maximum distance to search, m.
        scratch: Scratch array of `gjk.make_scratch`.

    Returns:
        (W, N) signed distance between collision shapes, m, negative for the penetration depth of an
        overlap. It is `max_distance` if nothing is nearer, and outside `mask`.
    """
    table = scenery.table
    result = np.full(mask.shape, max_distance)
    for w in range(mask.shape[0]):
        for i in range(mask.shape[1]):
            if not mask[w, i]:
                continue
            place = vec3(position, w, i)
            rotation = axes(quat4(quaternion, w, i))
            down = (-place[0], -place[1], -place[2])
            height, _, _, _ = gjk_distance(
                table, i, rotation, scenery.ground, IDENTITY, down, NO_GUESS, scratch
            )
            found = min(max_distance, height)
            # Drones
            for j in range(mask.shape[1]):
                offset = minus(vec3(position, w, j), place)
                radius = found + table.radius[i] + table.radius[j]
                if j == i or not mask[w, j] or _is_beyond(offset, radius):
                    continue
                other_rotation = axes(quat4(quaternion, w, j))
                distance, _, _, _ = gjk_distance(
                    table, i, rotation, j, other_rotation, offset, NO_GUESS, scratch
                )
                found = min(found, distance)
            # Obstacles, and bodies added by users
            for r in range(scenery.other.shape[0]):
                s = scenery.first_body + r
                offset = minus(vec3(scenery.place, w, r), place)
                if _is_beyond(offset, found + table.radius[i] + table.radius[s]):
                    continue
                other_rotation = axes(quat4(scenery.quaternion, w, r))
                distance, _, _, _ = gjk_distance(
                    table, i, rotation, s, other_rotation, offset, NO_GUESS, scratch
                )
                found = min(found, distance)
            result[w, i] = _city_clearance(scenery, w, i, place, rotation, found, scratch)
    return result


@kernel
def find_overlapping(
    scenery: Scenery,
    pieces: np.ndarray,
    position: np.ndarray,
    quaternion: np.ndarray,
    scratch: np.ndarray,
) -> int:
    """Return the first drone that would overlap a piece of a body in world 0, or -1.

    Args:
        scenery: Shapes and poses.
        pieces: (R,) bool, pieces of bodies to check.
        position: (N, 3) positions of the drones, m.
        quaternion: (N, 4) attitudes of the drones, body to world.
        scratch: Scratch array of `gjk.make_scratch`.
    """
    table = scenery.table
    for i in range(position.shape[0]):
        place = point(position, i)
        q = quaternion[i]
        rotation = axes((q[0], q[1], q[2], q[3]))
        for r in range(pieces.shape[0]):
            s = scenery.first_body + r
            offset = minus(vec3(scenery.place, 0, r), place)
            if not pieces[r] or _is_beyond(offset, table.radius[i] + table.radius[s]):
                continue
            turned = axes(quat4(scenery.quaternion, 0, r))
            distance, _, _, _ = gjk_distance(
                table, i, rotation, s, turned, offset, NO_GUESS, scratch
            )
            if distance < 0.0:
                return i
    return -1


@func
def _is_beyond(offset: Vec3Like, radius: float) -> bool:
    """Return True if a point is at least `radius` away, m; always True for 0 or less."""
    beyond: bool = radius <= 0.0 or dot(offset, offset) >= radius * radius
    return beyond
