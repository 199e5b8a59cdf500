"""Cities from files of users: footprints with heights, or convex pieces."""

import itertools
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.engine.tiles import TILE_PITCH
from bulletuav.errors import finite, missing, read_file, require_file, shown
from bulletuav.geometry.solids import Solids

EARTH_RADIUS = 6_371_008.8  # m, mean (Moritz, Geodetic Reference System 1980)
FLUSH = 1e-9  # relative difference of area or volume below which a shape fills its hull, or a hull its box
LEAST_HEIGHT, MOST_HEIGHT = 0.01, 2000.0
"""Of a building, m: drones that do not fly are kept higher up"""
LEAST_AREA = 1e-18  # square degrees, or m^2, below which a footprint is a point
MOST_SCALE, FARTHEST = 1e9, 1e12
"""Of numbers in OBJ files"""
REMEDY = "give the path of a .geojson, .json or .obj file"
SLIVER = 1e-4  # m^2; smaller pieces of a footprint are left out


def from_geojson(
    path: str | Path,
    side: float | None = None,
    height: str = "height",
    default_height: float | None = None,
    metres: bool = False,
) -> City:
    """A city from a FeatureCollection of footprints, Polygon or MultiPolygon, each of them a building.

    `height` names the property with a building's height, m; those without one get `default_height`, if it is given.
    Coordinates are degrees of longitude and latitude (RFC 7946), projected about the middle of all footprints such that
    meridians and the middle parallel keep their length, or `metres` east and north. Footprints are cut into convex pieces;
    courtyards stay open. Without `side`, the city is the smallest square about the middle; with it, coordinates in
    metres are taken as they are.

    Needs the extra `city` (ImportError that names it). Raises ValueError, which names the feature, for what cannot be read.
    """
    path = require_file("city", path, REMEDY)
    _check_flags(metres=metres)
    if not isinstance(height, str):
        raise ValueError(
            f"height is {shown(height)}: the name of a property of the features is needed"
        )
    features, shapely = _features(path), _shapely()
    shapes = [_geometry(feature, where) for where, feature in features]
    if not metres and shapes:
        shapes = list(_projected(np.array(shapes), path))
    if shapes:
        west, south, east, north = shapely.total_bounds(np.array(shapes))
        _check_extent(path, np.array([west, south]), np.array([east, north]), side)
    pieces = []
    for (where, feature), shape in zip(features, shapes, strict=True):
        top = _height(feature, height, default_height, where)
        try:
            parts = [
                piece for polygon in shapely.get_parts(shape) for piece in _convex_pieces(polygon)
            ]
        except shapely.errors.ShapelyError as error:
            raise ValueError(f"{where} cannot be cut into convex pieces: {error}") from None
        pieces += [(where, _extruded(np.array(piece.exterior.coords)[:-1], top)) for piece in parts]
    return _assembled(path, pieces, side)


def from_obj(
    path: str | Path, side: float | None = None, scale: float = 1.0, y_up: bool = False
) -> City:
    """A city from a Wavefront OBJ file: every object (every group, where no object is named) is a convex piece.

    A piece is the convex hull of its faces' corners; pieces whose names agree before `_piece_` make one building. Lengths
    in the file times `scale` are metres; z is up, or y. Without `side`, the city is the smallest square about the middle
    of the pieces; with it, coordinates are taken as they are.

    Raises ValueError, which names the line or piece, for what cannot be read or has no volume.
    """
    path = require_file("city", path, REMEDY)
    _check_flags(y_up=y_up)
    lines = [line.partition("#")[0].split() for line in read_file(path).splitlines()]
    starts = "o" if any(line[:1] == ["o"] for line in lines) else "g"
    vertices: list[list[float]] = []
    corners: dict[str, list[int]] = {}
    name = "unnamed"
    for number, line in enumerate(lines, 1):
        try:
            match line:
                case ["v", *words]:
                    vertices.append(_vertex(words))
                case ["f", *words]:
                    if len(words) < 3:
                        raise ValueError(f"a face has three corners or more, not {len(words)}")
                    corners.setdefault(name, []).extend(_indices(words, len(vertices)))
                case [word, *words] if word == starts:
                    name = " ".join(words)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from None
    points = finite("scale", scale, most=MOST_SCALE) * np.array(vertices).reshape(-1, 3)
    if y_up:
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    return _assembled(
        path,
        [(name.partition("_piece_")[0], points[np.unique(own)]) for name, own in corners.items()],
        side,
    )


READERS: dict[str, Callable[..., City]] = {
    ".geojson": from_geojson,
    ".json": from_geojson,
    ".obj": from_obj,
}
"""What reads a file, by its ending"""


def _check_flags(**flags: Any) -> None:
    for name, value in flags.items():
        if not isinstance(value, bool):
            raise ValueError(f"{name} is {shown(value)}: True or False is needed")


def _vertex(words: Sequence[str]) -> list[float]:
    if len(words) < 3:
        raise ValueError(f"not enough values: a vertex is x, y and z, not {len(words)} numbers")
    return [finite("a coordinate", float(word), -FARTHEST, FARTHEST) for word in words[:3]]


def _indices(words: Sequence[str], known: int) -> Iterator[int]:
    """Vertices of a face, from 0: in the file they count from 1, or back from the latest."""
    for word in words:
        digits = word.partition("/")[0]
        if not digits.removeprefix("-").isdecimal() or len(digits) > 18:
            raise ValueError(f"{shown(word)} is no number of a vertex")
        index = int(digits)
        if not 1 <= abs(index) <= known:
            raise ValueError(f"there is no vertex {index} among the {known} before it")
        yield index - 1 if index > 0 else known + index


def _assembled(path: Path, pieces: Sequence[tuple[str, np.ndarray]], side: float | None) -> City:
    """A city of pieces, each the name of its building and points (V, 3) whose hull it is."""
    if not pieces:
        raise ValueError(f"{path} holds no buildings")
    corners = np.concatenate([points for _, points in pieces])
    (*low, bottom), (*high, top) = corners.min(axis=0), corners.max(axis=0)
    low, high = np.array(low), np.array(high)
    _check_extent(path, low, high, side)
    if not -TILE_PITCH < bottom <= top <= MOST_HEIGHT:
        raise ValueError(
            f"{path} has buildings from {bottom:g} to {top:g} m up: at most {MOST_HEIGHT:g} m is possible"
        )
    middle = np.zeros(3)
    if side is None:
        side = float((high - low).max())
        middle[:2] = (low + high) / 2
    elif max(*-low, *high) > side / 2:
        raise ValueError(
            f"{path} does not fit into a side of {side!r} m: x, y go from {low} to {high} m"
        )
    hulls = [_hull(points - middle, f"{path}: {name}") for name, points in pieces]
    is_box = np.array([filled for _, filled in hulls])
    order = np.argsort(~is_box, kind="stable")
    boxes = [(points.min(axis=0), points.max(axis=0)) for points, filled in hulls if filled]
    solids = Solids(
        np.array(boxes).reshape(-1, 2, 3), tuple(points for points, filled in hulls if not filled)
    )
    number = {name: k for k, name in enumerate(dict.fromkeys(name for name, _ in pieces))}
    building = np.array([number[name] for name, _ in pieces])[order]
    bare = City(
        path.stem,
        float(side),
        solids,
        building,
        Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int)),
    )
    return replace(bare, streets=free_streets(bare.side, bare.outdoors))


def _check_extent(path: Path, low: np.ndarray, high: np.ndarray, side: float | None) -> None:
    """Refuse a city that is larger than what is kept for a world, before anything is made of it."""
    if side is not None:
        extent, what = finite("side", side), "side is"
    else:
        extent, what = (
            float((high - low).max()),
            f"{path} has buildings, x, y from {low} to {high} m, on a square of",
        )
    if extent >= TILE_PITCH:
        raise ValueError(
            f"{what} {extent:.6g} m: less than {TILE_PITCH:g} m is needed, where other worlds begin; cut a part out of the "
            f"file, or check its unit"
        )


def _hull(points: np.ndarray, where: str) -> tuple[np.ndarray, bool]:
    """The corners of the convex hull of points (V, 3), and whether it is a box along the axes."""
    from scipy.spatial import ConvexHull, QhullError  # which takes long to import

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(
            f"{where} has no volume: a piece is the convex hull of at least four points off a plane"
        ) from None
    return points[hull.vertices], hull.volume >= (1 - FLUSH) * np.prod(np.ptp(points, axis=0))


def _shapely() -> ModuleType:
    try:
        import shapely
    except ImportError:
        raise missing("reading GeoJSON", "city") from None
    return shapely


def _features(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """The features of a file, each with a name for messages."""
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
    """The footprint of a feature, as a shapely geometry."""
    shapely = _shapely()
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        raise ValueError(
            f"{where}: its geometry cannot be read: a Polygon or MultiPolygon is needed, not {shown(geometry)}"
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
    """Shapes in metres about the middle of shapes in degrees (equirectangular projection)."""
    shapely = _shapely()
    west, south, east, north = bounds = shapely.total_bounds(shapes)
    if (np.abs(bounds) > [180, 90, 180, 90]).any():
        raise ValueError(
            f"{path} has coordinates from {bounds[:2]} to {bounds[2:]}, which are no degrees: are they metres?"
        )
    if (
        east - west > 180
    ):  # a town on both sides of the antimeridian: its west is counted on from 180
        shapes = shapely.transform(
            shapes, lambda degrees: np.where([True, False], degrees % 360, degrees)
        )
        west, south, east, north = shapely.total_bounds(shapes)
    middle = np.array([west + east, south + north]) / 2
    metres = EARTH_RADIUS * np.radians([math.cos(math.radians(middle[1])), 1])
    return shapely.transform(shapes, lambda degrees: (degrees - middle) * metres)


def _height(feature: dict[str, Any], name: str, default: float | None, where: str) -> float:
    """The height of a feature, m."""
    properties = feature.get("properties")
    value = properties.get(name) if isinstance(properties, dict) else None
    if value is None:
        value = default
    try:
        top = finite(
            name, float(value) if isinstance(value, str) else value
        )  # which some write as texts
    except ValueError:
        top = math.nan
    if not 0 < top < math.inf:
        raise ValueError(
            f"{where}: its {name} is {shown(value)}: metres above 0, or a default height, are needed"
        )
    if not LEAST_HEIGHT <= top <= MOST_HEIGHT:
        raise ValueError(
            f"{where}: its {name} is {top:g} m: from {LEAST_HEIGHT:g} to {MOST_HEIGHT:g} m is possible"
        )
    return top


def _convex_pieces(polygon: Any) -> list[Any]:
    """Convex polygons that fill a polygon: triangles, joined as long as what they make is convex."""
    pieces: list[Any] = []
    for piece in _shapely().get_parts(_shapely().constrained_delaunay_triangles(polygon)):
        k = 0
        while k < len(pieces):
            union = pieces[k].union(piece)
            if union.convex_hull.area - union.area <= FLUSH * union.area:
                piece = union
                del pieces[k]
                k = 0
            else:
                k += 1
        pieces.append(piece)
    return [piece for piece in pieces if piece.area > SLIVER]


def _extruded(outline: np.ndarray, top: float) -> np.ndarray:
    """(2 V, 3) corners of a prism on the ground over an outline (V, 2)."""
    return np.array([(x, y, z) for (x, y), z in itertools.product(outline, (0.0, top))])
