"""Cities from GeoJSON files: footprints of buildings with heights."""

import itertools
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np

from bulletuav.city.assembly import (
    FLUSH,
    LEAST_HEIGHT,
    MOST_HEIGHT,
    REMEDY,
    assemble,
    check_extent,
    check_flags,
)
from bulletuav.city.model import City
from bulletuav.errors import finite, missing, read_file, require_file, shown

EARTH_RADIUS = 6_371_008.8
"""Mean radius, m (Moritz, Geodetic Reference System 1980)"""
LEAST_AREA = 1e-18
"""Square degrees, or m^2, below which a footprint is a point"""
SLIVER = 1e-4
"""Pieces of a footprint smaller than this, m^2, are left out"""


def from_geojson(
    path: str | Path,
    side: float | None = None,
    height: str = "height",
    default_height: float | None = None,
    metres: bool = False,
) -> City:
    """Read a city from a FeatureCollection of footprints, each of them a building.

    Footprints are Polygons or MultiPolygons. They are cut into convex pieces; courtyards stay open.
    Coordinates are degrees of longitude and latitude (RFC 7946). They are projected about the
    middle of all footprints such that meridians and the middle parallel keep their length. It needs
    the extra `city`.

    Args:
        path: The file.
        side: Of the city's square, m, with coordinates in metres taken as they are; None for the
            smallest square about the middle.
        height: Property of the features that holds a building's height, m.
        default_height: Height of buildings without one, m.
        metres: Whether coordinates are metres east and north, and not degrees.

    Returns:
        The city, with streets on its free ground.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: The extra is not installed; it is named.
        ValueError: Something cannot be read; the feature is named.
    """
    path = require_file("city", path, REMEDY)
    check_flags(metres=metres)
    if not isinstance(height, str):
        raise ValueError(
            f"height is {shown(height)}: the name of a property of the features is needed"
        )
    features = _features(path)
    shapely = _shapely()
    shapes = [_geometry(feature, where) for where, feature in features]
    if not metres and shapes:
        shapes = list(_projected(np.array(shapes), path))
    if shapes:
        west, south, east, north = shapely.total_bounds(np.array(shapes))
        low = np.array([west, south])
        high = np.array([east, north])
        check_extent(path, low, high, side)

    pieces: list[tuple[str, np.ndarray]] = []
    for (where, feature), shape in zip(features, shapes, strict=True):
        top = _height(feature, height, default_height, where)
        try:
            parts = [
                piece for polygon in shapely.get_parts(shape) for piece in _convex_pieces(polygon)
            ]
        except shapely.errors.ShapelyError as error:
            raise ValueError(f"{where} cannot be cut into convex pieces: {error}") from None
        for piece in parts:
            outline = np.array(piece.exterior.coords)[:-1]
            pieces.append((where, _extruded(outline, top)))
    return assemble(path, pieces, side)


def _shapely() -> ModuleType:
    """Import shapely, or name the extra that brings it."""
    try:
        import shapely
    except ImportError:
        raise missing("reading GeoJSON", "city") from None
    return cast(ModuleType, shapely)


def _features(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Read the features of a file, each with a name for messages."""
    text = read_file(path)
    try:
        content = json.loads(text)
    except ValueError as error:
        raise ValueError(f"{path} is not GeoJSON: {error}") from None
    except RecursionError:
        raise ValueError(
            f"{path} is not GeoJSON: lists within lists, too deep to be read"
        ) from None
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        raise ValueError(f"{path} is no FeatureCollection")
    return [
        (f"{path}, feature {k} (from 0)", feature) for k, feature in enumerate(content["features"])
    ]


def _geometry(feature: dict[str, Any], where: str) -> Any:
    """Return the footprint of a feature as a checked shapely geometry in two dimensions."""
    shapely = _shapely()
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        raise ValueError(
            f"{where}: its geometry cannot be read: a Polygon or MultiPolygon is needed, "
            f"not {shown(geometry)}"
        )
    try:
        shape = shapely.from_geojson(json.dumps(geometry))
    except shapely.errors.ShapelyError as error:
        raise ValueError(f"{where}: its geometry cannot be read: {error}") from None
    if shape.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(
            f"{where} is a {shape.geom_type}: only Polygon and MultiPolygon are footprints"
        )
    if shape.is_empty:
        raise ValueError(f"{where} is an empty {shape.geom_type}: it has no coordinates")
    if not shape.is_valid:
        raise ValueError(f"{where} is no valid polygon: {shapely.is_valid_reason(shape)}")
    if not np.isfinite(shape.bounds).all() or shape.area < LEAST_AREA:
        raise ValueError(
            f"{where} has no area: its corners go from {shape.bounds[:2]} to {shape.bounds[2:]}"
        )
    return shapely.force_2d(shape)


def _projected(shapes: np.ndarray, path: Path) -> np.ndarray:
    """Project shapes in degrees to metres about their middle (equirectangular projection)."""
    shapely = _shapely()
    west, south, east, north = bounds = shapely.total_bounds(shapes)
    if (np.abs(bounds) > [180, 90, 180, 90]).any():
        raise ValueError(
            f"{path} has coordinates from {bounds[:2]} to {bounds[2:]}, which are no degrees: "
            f"are they metres?"
        )
    if east - west > 180:
        # A town on both sides of the antimeridian: its west is counted on from 180
        shapes = shapely.transform(
            shapes, lambda degrees: np.where([True, False], degrees % 360, degrees)
        )
        west, south, east, north = shapely.total_bounds(shapes)
    middle = np.array([west + east, south + north]) / 2
    shrink = math.cos(math.radians(middle[1]))
    metres = EARTH_RADIUS * np.radians([shrink, 1])
    projected: np.ndarray = shapely.transform(shapes, lambda degrees: (degrees - middle) * metres)
    return projected


def _height(
    feature: dict[str, Any],
    name: str,
    default: float | None,
    where: str,
) -> float:
    """Return the height of a feature, m."""
    properties = feature.get("properties")
    value = properties.get(name) if isinstance(properties, dict) else None
    if value is None:
        value = default
    try:
        # Some write heights as texts
        top = finite(name, float(value) if isinstance(value, str) else value)
    except ValueError:
        top = math.nan
    if not 0 < top < math.inf:
        raise ValueError(
            f"{where}: its {name} is {shown(value)}: "
            f"metres above 0, or a default height, are needed"
        )
    if not LEAST_HEIGHT <= top <= MOST_HEIGHT:
        raise ValueError(
            f"{where}: its {name} is {top:g} m: "
            f"from {LEAST_HEIGHT:g} to {MOST_HEIGHT:g} m is possible"
        )
    return top


def _convex_pieces(polygon: Any) -> list[Any]:
    """Cut a polygon into triangles, and join them as long as what they make is convex."""
    shapely = _shapely()
    pieces: list[Any] = []
    for piece in shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)):
        k = 0
        while k < len(pieces):
            union = pieces[k].union(piece)
            if union.convex_hull.area - union.area <= FLUSH * union.area:
                # What was joined may go together with pieces that did not fit before
                piece = union
                del pieces[k]
                k = 0
            else:
                k += 1
        pieces.append(piece)
    return [piece for piece in pieces if piece.area > SLIVER]


def _extruded(outline: np.ndarray, top: float) -> np.ndarray:
    """Return (2 V, 3) corners of a prism on the ground over an outline (V, 2)."""
    corners = itertools.product(outline, (0.0, top))
    return np.array([(x, y, z) for (x, y), z in corners])
