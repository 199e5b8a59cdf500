"""Convex shapes, and the intersection of lines with boxes, spheres and cylinders.

A line has the points start + t change. As each shape is convex, the line is inside it for an
interval of t. If the line misses the shape, the entry is larger than the exit.

References:
    T. Kay and J. Kajiya, Ray tracing complex scenes (1986): the slab method.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Vec3Like, dot

SPHERE, CYLINDER, BOX, HULL, HALF_SPACE = range(5)


class Shape(NamedTuple):
    """Convex collision shape in its own axes; the origin of a drone's shape is its centre of mass.

    Attributes:
        kind: SPHERE, CYLINDER, BOX, HULL or HALF_SPACE.
        half: Half extents of the smallest box, centred at the origin, that contains the shape, m.
        corners: Corners of a hull, m; empty for other kinds.
    """

    kind: int
    half: tuple[float, float, float]
    corners: tuple[tuple[float, float, float], ...] = ()


@func
def intersect_slab(start: float, change: float, low: float, high: float) -> tuple[float, float]:
    """Intersect a line with a slab, the region between two parallel planes.

    Args:
        start: Coordinate of the line at t = 0, m.
        change: Change of this coordinate from t = 0 to t = 1, m.
        low: Lower bound of the slab, m.
        high: Upper bound of the slab, m.

    Returns:
        The values of t at entry and exit; (inf, -inf) if the line misses the slab.
    """
    # A line parallel to the slab is always or never inside.
    if change == 0.0:
        return (-np.inf, np.inf) if low <= start <= high else (np.inf, -np.inf)
    one = (low - start) / change
    two = (high - start) / change
    return min(one, two), max(one, two)


@func
def intersect_box(
    start: Vec3Like, change: Vec3Like, low: Vec3Like, high: Vec3Like
) -> tuple[float, float]:
    """Intersect a line with an axis-aligned box by the slab method.

    Args:
        start: Point of the line at t = 0, m.
        change: Vector from there to the point at t = 1, m.
        low: Corner of minimum coordinates, m.
        high: Corner of maximum coordinates, m.

    Returns:
        The values of t at entry and exit; the entry is larger if the line misses the box.
    """
    # The box is the intersection of three slabs: the last entry and the first exit count.
    enters = -np.inf
    leaves = np.inf
    for k in range(3):
        one, two = intersect_slab(start[k], change[k], low[k], high[k])
        enters = max(enters, one)
        leaves = min(leaves, two)
    return enters, leaves


@func
def distance_from_box(place: Vec3Like, low: Vec3Like, high: Vec3Like) -> float:
    """Return the distance of a point from an axis-aligned box, m; 0 inside."""
    square = 0.0
    for k in range(3):
        aside = max(low[k] - place[k], 0.0, place[k] - high[k])
        square += aside * aside
    return math.sqrt(square)


@func
def _intersect_round(along: float, square: float, outside: float) -> tuple[float, float]:
    """Return the roots t of t^2 square + 2 t along + outside, or (inf, -inf) if there are none.

    The polynomial is the squared distance from a centre or an axis minus the squared radius.
    """
    # A constant distance: the line is always or never inside.
    if square == 0.0:
        return (-np.inf, np.inf) if outside <= 0.0 else (np.inf, -np.inf)
    root = along * along - square * outside
    if root < 0.0:
        return np.inf, -np.inf
    root = math.sqrt(root)
    return (-along - root) / square, (-along + root) / square


@func
def intersect_primitive(
    kind: int, half: Vec3Like, start: Vec3Like, change: Vec3Like
) -> tuple[float, float]:
    """Intersect a line with a sphere, cylinder or box.

    Args:
        kind: SPHERE, CYLINDER or BOX.
        half: Half extents of the shape, m.
        start: Point of the line at t = 0, in body axes relative to the centre, m.
        change: Vector from there to the point at t = 1, in body axes, m.

    Returns:
        The values of t at entry and exit; the entry is larger if the line misses the shape.
    """
    if kind == SPHERE:
        outside = dot(start, start) - half[0] ** 2
        return _intersect_round(dot(start, change), dot(change, change), outside)
    if kind == BOX:
        return intersect_box(start, change, (-half[0], -half[1], -half[2]), half)
    # A cylinder is the intersection of a slab along z and an infinite cylinder.
    enters, leaves = intersect_slab(start[2], change[2], -half[2], half[2])
    along = start[0] * change[0] + start[1] * change[1]
    square = change[0] ** 2 + change[1] ** 2
    outside = start[0] ** 2 + start[1] ** 2 - half[0] ** 2
    one, two = _intersect_round(along, square, outside)
    return max(enters, one), min(leaves, two)
