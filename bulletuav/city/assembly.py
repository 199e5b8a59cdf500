"""What all importers of cities share: from convex pieces to a checked city."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.city.import_report import Notebook
from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import finite, naming, shown
from bulletuav.geometry.solids import Solids

FLUSH = 1e-9
"""Relative difference of area or volume below which a shape fills its hull, or a hull its box"""
LEAST_HEIGHT = 0.01
MOST_HEIGHT = 2000.0
"""Of a building, m: drones that do not fly are kept higher up"""
REMEDY = "give the path of a .geojson, .json or .obj file"


def check_flags(**flags: Any) -> None:
    """Raise ValueError for a keyword argument that is neither True nor False."""
    for name, value in flags.items():
        if not isinstance(value, bool):
            raise ValueError(f"{name} is {shown(value)}: True or False is needed")


def check_extent(path: Path, low: np.ndarray, high: np.ndarray, side: float | None) -> None:
    """Refuse a city that is larger than the room of a world, before anything is made of it.

    Args:
        path: File, for the message.
        low: (2,) least x and y of the buildings, m.
        high: (2,) greatest x and y, m.
        side: Of the city's square, m, where it is given.

    Raises:
        ValueError: The side, or what the buildings cover, is too large.
    """
    if side is not None:
        extent = finite("side", side)
        what = "side is"
    else:
        extent = float((high - low).max())
        what = f"{path} has buildings, x, y from {low} to {high} m, on a square of"
    if extent >= TILE_PITCH:
        raise ValueError(
            f"{what} {extent:.6g} m: less than {TILE_PITCH:g} m is needed, "
            f"where other worlds begin; cut a part out of the file, or check its unit"
        )


def assemble(
    path: Path, pieces: Sequence[tuple[str, np.ndarray]], side: float | None, notes: Notebook
) -> City:
    """Make a city of convex pieces.

    Args:
        path: File, whose name the city gets.
        pieces: Of each the name of its building, and points (V, 3) whose hull it is, m.
        side: Of the city's square about the origin, m; None for the smallest square about the
            middle of the pieces, which becomes the origin.
        notes: What was done to get them; the city gets its report.

    Returns:
        The city, with streets on its free ground. Boxes come first among its pieces.

    Raises:
        ValueError: There are no pieces, one has no volume, they do not fit, or nothing is free.
    """
    if not pieces:
        mended = notes.report().summary()
        raise ValueError(f"{path} holds no buildings" + (mended and f": {mended}"))
    # How far the pieces reach, which must fit into a world
    corners = np.concatenate([points for _, points in pieces])
    low = corners[:, :2].min(axis=0)
    high = corners[:, :2].max(axis=0)
    bottom = corners[:, 2].min()
    top = corners[:, 2].max()
    check_extent(path, low, high, side)
    if not -TILE_PITCH < bottom <= top <= MOST_HEIGHT:
        raise ValueError(
            f"{path} has buildings from {bottom:g} to {top:g} m up: "
            f"at most {MOST_HEIGHT:g} m is possible"
        )
    # Without a side, the middle of the pieces becomes the origin
    middle = np.zeros(3)
    if side is None:
        side = float((high - low).max())
        middle[:2] = (low + high) / 2
    elif max(*-low, *high) > side / 2:
        raise ValueError(
            f"{path} does not fit into a side of {side!r} m: x, y go from {low} to {high} m"
        )

    # Boxes along the axes first, other hulls after them
    hulls = [_hull(points - middle, f"{path}: {name}") for name, points in pieces]
    is_box = np.array([filled for _, filled in hulls])
    order = np.argsort(~is_box, kind="stable")
    boxes = [(points.min(axis=0), points.max(axis=0)) for points, filled in hulls if filled]
    others = tuple(points for points, filled in hulls if not filled)
    solids = Solids(np.array(boxes).reshape(-1, 2, 3), others)

    # Buildings are numbered as they come in the file
    buildings = dict.fromkeys(name for name, _ in pieces)
    number = {name: k for k, name in enumerate(buildings)}
    building = np.array([number[name] for name, _ in pieces])[order]

    # Streets are found by asking the city what is free
    no_nodes = np.zeros((0, 2))
    no_edges = np.zeros((0, 2), dtype=int)
    no_streets = Streets(no_nodes, no_edges)
    bare = City(path.stem, float(side), solids, building, no_streets)
    with naming(path):
        streets = free_streets(bare.side, bare.outdoors)
    return replace(bare, streets=streets, report=notes.warn())


def _hull(points: np.ndarray, where: str) -> tuple[np.ndarray, bool]:
    """Return the corners of the hull of points (V, 3), and whether it is a box along the axes."""
    from scipy.spatial import ConvexHull, QhullError  # which takes long to import

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(
            f"{where} has no volume: a piece is the convex hull of at least four points off a plane"
        ) from None
    box = np.prod(np.ptp(points, axis=0))
    filled = hull.volume >= (1 - FLUSH) * box
    return points[hull.vertices], filled
