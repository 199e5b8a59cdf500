"""Polygons in scratch, cut by lines and by convex polygons.

A polygon is cut by one side of the other after another (I. Sutherland and G. Hodgman, Reentrant
polygon clipping, 1974). A corner is a row of scratch with three columns, of which the first two
count; the third is carried along.
"""

import numpy as np

from bulletuav.kernel import func


@func
def cut(
    room: np.ndarray,
    count: int,
    source: int,
    target: int,
    corner: tuple[float, float],
    inward: tuple[float, float],
) -> int:
    """Keep the part of a polygon on one side of a line.

    Args:
        room: Scratch, a corner a row.
        count: Number of corners.
        source: First column of the corners.
        target: First column for those that are left; not that of the source.
        corner: A point of the line.
        inward: Direction across the line, to the side that is kept.

    Returns:
        How many corners are left: at most one more than before.
    """
    kept = 0
    last = count - 1
    there = (room[last, source] - corner[0]) * inward[0]
    there += (room[last, source + 1] - corner[1]) * inward[1]
    for k in range(count):
        here = (room[k, source] - corner[0]) * inward[0]
        here += (room[k, source + 1] - corner[1]) * inward[1]
        # The side from the corner before crosses the line
        if (here >= 0.0) != (there >= 0.0):
            share = there / (there - here)
            for m in range(3):
                before = room[last, source + m]
                room[kept, target + m] = before + share * (room[k, source + m] - before)
            kept += 1
        if here >= 0.0:
            for m in range(3):
                room[kept, target + m] = room[k, source + m]
            kept += 1
        last = k
        there = here
    return kept


@func
def clip(
    room: np.ndarray,
    count: int,
    column: int,
    sides: int,
    others: int,
    spare: int,
    sign: float,
) -> tuple[int, int]:
    """Keep the part of a polygon or line over or under another polygon.

    Args:
        room: Scratch.
        count: Number of corners of the first.
        column: First column of its corners.
        sides: Number of corners of the other.
        others: First column of its corners.
        spare: First of the columns to work on.
        sign: 1 where the other turns left in axes of the contact, -1 where it turns right.

    Returns:
        How many corners there are, and their first column.
    """
    source = column
    target = spare
    last = sides - 1
    for k in range(sides):
        corner = (room[last, others], room[last, others + 1])
        east = room[k, others] - corner[0]
        north = room[k, others + 1] - corner[1]
        count = cut(room, count, source, target, corner, (-sign * north, sign * east))
        source, target = target, source
        last = k
    return count, source
