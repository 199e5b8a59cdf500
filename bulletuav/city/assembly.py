"""Assembly of a validated city from convex pieces, shared by all importers."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.city.import_report import FIRST_SHOWN, ImportReport, Notebook
from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import finite, naming, shown
from bulletuav.geometry.solids import Solids

FLUSH = 1e-9
"""Relative tolerance of volumes within which a hull counts as a box"""
MIN_HEIGHT = 0.01
MAX_HEIGHT = 2000.0
"""Maximum height of a building, m: drones that do not fly are kept above"""
REMEDY = "give the path of a .geojson, .json (GeoJSON, Overpass JSON, CityJSON) or .obj file"


def check_flags(**flags: Any) -> None:
    """Raise ValueError for a keyword argument that is not a bool."""
    for name, value in flags.items():
        if not isinstance(value, bool):
            raise ValueError(f"{name} is {shown(value)}: True or False is needed")


def check_extent(path: Path, low: np.ndarray, high: np.ndarray, side: float | None) -> None:
    """Check that a city is smaller than a world.

    Args:
        path: File, for the message.
        low: (2,) minimum x and y of the buildings, m.
        high: (2,) maximum x and y of the buildings, m.
        side: Side of the city's square, m; None for that of the buildings.

    Raises:
        ValueError: If the side, or the extent of the buildings, is too large.
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
            f"the pitch of worlds; crop the file, or check its unit"
        )


def assemble(
    path: Path, pieces: Sequence[tuple[str, np.ndarray]], side: float | None, notes: Notebook
) -> City:
    """Assemble a city from convex pieces.

    Args:
        path: File, whose stem is the name of the city.
        pieces: Name of the building and points (V, 3), m, of each piece; the piece is their convex
            hull.
        side: Side of the city's square around the origin, m; None for the smallest square around
            the pieces, whose centre becomes the origin.
        notes: Import notes, which become the report of the city.

    Returns:
        The city, with streets on its free ground. Boxes come first among its pieces.

    Raises:
        ValueError: If there are no pieces, a piece has no volume, the pieces do not fit into the
            square, or there is no free ground.
    """
    if not pieces:
        raise ValueError(f"{path} contains no buildings{_why_none(notes.report())}")
    # The extent of the pieces must fit into a world
    corners = np.concatenate([points for _, points in pieces])
    low = corners[:, :2].min(axis=0)
    high = corners[:, :2].max(axis=0)
    bottom = corners[:, 2].min()
    top = corners[:, 2].max()
    check_extent(path, low, high, side)
    if not -TILE_PITCH < bottom <= top <= MAX_HEIGHT:
        raise ValueError(
            f"{path} has buildings from {bottom:g} to {top:g} m above ground: "
            f"at most {MAX_HEIGHT:g} m is supported"
        )
    # Without a side, the centre of the pieces becomes the origin
    middle = np.zeros(3)
    if side is None:
        side = float((high - low).max())
        middle[:2] = (low + high) / 2
    elif max(*-low, *high) > side / 2:
        raise ValueError(
            f"{path} does not fit into a side of {side!r} m: x, y range from {low} to {high} m"
        )

    # Axis-aligned boxes first, then other hulls
    hulls = [_hull(points - middle, f"{path}: {name}") for name, points in pieces]
    is_box = np.array([filled for _, filled in hulls])
    order = np.argsort(~is_box, kind="stable")
    boxes = [(points.min(axis=0), points.max(axis=0)) for points, filled in hulls if filled]
    others = tuple(points for points, filled in hulls if not filled)
    solids = Solids(np.array(boxes).reshape(-1, 2, 3), others)

    # Buildings are numbered in the order of the file
    buildings = dict.fromkeys(name for name, _ in pieces)
    number = {name: k for k, name in enumerate(buildings)}
    building = np.array([number[name] for name, _ in pieces])[order]

    # Streets are generated on the free ground
    no_nodes = np.zeros((0, 2))
    no_edges = np.zeros((0, 2), dtype=int)
    no_streets = Streets(no_nodes, no_edges)
    bare = City(path.stem, float(side), solids, building, no_streets)
    with naming(path):
        streets = free_streets(bare.side, bare.outdoors)
    return replace(bare, streets=streets, report=notes.warn())


def _why_none(report: ImportReport) -> str:
    """Return the findings of the import of a file without buildings."""
    others = ", ".join(
        f"{count} {kind}" for kind, count in islice(report.others.items(), FIRST_SHOWN)
    )
    first = next((note.what for note in report.notes if note.kind == "skipped"), "")
    found = [
        report.summary(),
        first,
        others and f"there are only features of other kinds ({others})",
    ]
    return "".join(f": {one}" for one in found if one)


def _hull(points: np.ndarray, where: str) -> tuple[np.ndarray, bool]:
    """Return the corners of the hull of points (V, 3), and whether it is an axis-aligned box."""
    from scipy.spatial import ConvexHull, QhullError  # lazy: slow to import

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(
            f"{where} has no volume: a piece is the convex hull of at least four points off a plane"
        ) from None
    box = np.prod(np.ptp(points, axis=0))
    filled = hull.volume >= (1 - FLUSH) * box
    return points[hull.vertices], filled
