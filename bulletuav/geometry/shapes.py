"""Convex shapes, and lines through those of them that are round or boxes.

Each shape is convex, so a line is inside it between two points (T. Kay and J. Kajiya, Ray tracing
complex scenes, 1986). Functions describe a ray by its point `start` and its vector `change`, and a
point on it by the share t of the way: start + t change. Where a line never is inside, the share at
which it enters is larger than the one at which it leaves.
"""

import math
from typing import NamedTuple

import numpy as np

from bulletuav.compiled.kernel import func
from bulletuav.geometry.rotation import Vec3Like, dot

SPHERE, CYLINDER, BOX, HULL, HALF_SPACE = range(5)


class Shape(NamedTuple):
    """Convex collision shape in axes of its own; a drone's origin is its centre of mass.

    Attributes:
        kind: SPHERE, CYLINDER, BOX, HULL or HALF_SPACE.
        half: Half extents of the smallest box about the origin that holds it, m.
        corners: Of a hull, its corners, m.
    """

    kind: int
    half: tuple[float, float, float]
    corners: tuple[tuple[float, float, float], ...] = ()


@func
def intersect_slab(start: float, change: float, low: float, high: float) -> tuple[float, float]:
    """Return the shares t at which a line enters and leaves a slab.

    Args:
        start: Coordinate of the line at t = 0, m.
        change: Change of this coordinate from t = 0 to t = 1, m.
        low: Where the slab begins, m.
        high: Where it ends, m.

    Returns:
        The shares of entry and exit; (inf, -inf) where the line never is inside.
    """
    # A line along the slab is inside all the way or never.
    if change == 0.0:
        return (-np.inf, np.inf) if low <= start <= high else (np.inf, -np.inf)
    one = (low - start) / change
    two = (high - start) / change
    return min(one, two), max(one, two)


@func
def intersect_box(
    start: Vec3Like, change: Vec3Like, low: Vec3Like, high: Vec3Like
) -> tuple[float, float]:
    """Return the shares t between which a line is in the box between two corners.

    Args:
        start: Point of the line at t = 0, m.
        change: Vector from there to the point at t = 1, m.
        low: Corner of least coordinates, m.
        high: Corner of greatest coordinates, m.

    Returns:
        The shares of entry and exit; the first is larger where the line never is inside.
    """
    # The box is where three slabs overlap: the last entry and the first exit count.
    enters = -np.inf
    leaves = np.inf
    for k in range(3):
        one, two = intersect_slab(start[k], change[k], low[k], high[k])
        enters = max(enters, one)
        leaves = min(leaves, two)
    return enters, leaves


@func
def distance_from_box(place: Vec3Like, low: Vec3Like, high: Vec3Like) -> float:
    """Return the distance of a point from the box between two corners, 0 inside, m."""
    square = 0.0
    for k in range(3):
        aside = max(low[k] - place[k], 0.0, place[k] - high[k])
        square += aside * aside
    return math.sqrt(square)


@func
def _intersect_round(along: float, square: float, outside: float) -> tuple[float, float]:
    """Return the roots t of t^2 square + 2 t along + outside, or (inf, -inf) for none.

    This is the squared distance from a centre or an axis less the squared radius.
    """
    # The line keeps its distance: it is inside all the way or never.
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
    """Return the shares t between which a line is inside a collision shape.

    Args:
        kind: SPHERE, CYLINDER or BOX.
        half: Half extents of the shape, m.
        start: Point of the line at t = 0, in body axes from the centre, m.
        change: Vector from there to the point at t = 1, in body axes, m.

    Returns:
        The shares of entry and exit; the first is larger where the line never is inside.
    """
    if kind == SPHERE:
        outside = dot(start, start) - half[0] ** 2
        return _intersect_round(dot(start, change), dot(change, change), outside)
    if kind == BOX:
        return intersect_box(start, change, (-half[0], -half[1], -half[2]), half)
    # A cylinder is where a slab along z and a round column about it overlap.
    enters, leaves = intersect_slab(start[2], change[2], -half[2], half[2])
    along = start[0] * change[0] + start[1] * change[1]
    square = change[0] ** 2 + change[1] ** 2
    outside = start[0] ** 2 + start[1] ** 2 - half[0] ** 2
    one, two = _intersect_round(along, square, outside)
    return max(enters, one), min(leaves, two)
