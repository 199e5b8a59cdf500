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
from bulletuav.errors import finite, missing
from bulletuav.physics.solids import Solids

EARTH_RADIUS = 6_371_008.8  # m, mean (Moritz, Geodetic Reference System 1980)
FLUSH = 1e-9  # relative difference of area or volume below which a shape fills its hull, or a hull its box
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
    path = Path(path)
    features, shapely = _features(path), _shapely()
    shapes = [_geometry(feature, where) for where, feature in features]
    if not metres and shapes:
        shapes = list(_projected(np.array(shapes), path))
    pieces = []
    for (where, feature), shape in zip(features, shapes, strict=True):
        top = _height(feature, height, default_height, where)
        for polygon in shapely.get_parts(shape):
            pieces += [(where, _extruded(np.array(piece.exterior.coords)[:-1], top)) for piece in _convex_pieces(polygon)]
    return _assembled(path, pieces, side)


def from_obj(path: str | Path, side: float | None = None, scale: float = 1.0, y_up: bool = False) -> City:
    """A city from a Wavefront OBJ file: every object (every group, where no object is named) is a convex piece.

    A piece is the convex hull of its faces' corners; pieces whose names agree before `_piece_` make one building. Lengths
    in the file times `scale` are metres; z is up, or y. Without `side`, the city is the smallest square about the middle
    of the pieces; with it, coordinates are taken as they are.

    Raises ValueError, which names the line or piece, for what cannot be read or has no volume.
    """
    path = Path(path)
    lines = [line.partition("#")[0].split() for line in path.read_text().splitlines()]
    starts = "o" if any(line[:1] == ["o"] for line in lines) else "g"
    vertices: list[list[float]] = []
    corners: dict[str, list[int]] = {}
    name = "unnamed"
    for number, line in enumerate(lines, 1):
        try:
            match line:
                case ["v", *words]:
                    x, y, z = (finite("a coordinate", float(word)) for word in words[:3])
                    vertices.append([x, y, z])
                case ["f", *words]:
                    corners.setdefault(name, []).extend(_indices(words, len(vertices)))
                case [word, *words] if word == starts:
                    name = " ".join(words)
        except ValueError as error:
            raise ValueError(f"{path}, line {number} cannot be read: {error}") from None
    points = finite("scale", scale) * np.array(vertices).reshape(-1, 3)
    if y_up:
        points = points[:, [0, 2, 1]] * [1, -1, 1]
    return _assembled(path, [(name.partition("_piece_")[0], points[np.unique(own)]) for name, own in corners.items()], side)


READERS: dict[str, Callable[..., City]] = {".geojson": from_geojson, ".json": from_geojson, ".obj": from_obj}
"""What reads a file, by its ending"""


def _indices(words: Sequence[str], known: int) -> Iterator[int]:
    """Vertices of a face, from 0: in the file they count from 1, or back from the latest."""
    for word in words:
        index = int(word.partition("/")[0])
        if not 1 <= abs(index) <= known:
            raise ValueError(f"there is no vertex {index} among the {known} before it")
        yield index - 1 if index > 0 else known + index


def _assembled(path: Path, pieces: Sequence[tuple[str, np.ndarray]], side: float | None) -> City:
    """A city of pieces, each the name of its building and points (V, 3) whose hull it is."""
    if not pieces:
        raise ValueError(f"{path} holds no buildings")
    plan = np.concatenate([points for _, points in pieces])[:, :2]
    low, high = plan.min(axis=0), plan.max(axis=0)
    middle = np.zeros(3)
    if side is None:
        side = float((high - low).max())
        middle[:2] = (low + high) / 2
    elif max(*-low, *high) > finite("side", side) / 2:
        raise ValueError(f"{path} does not fit into a side of {side!r} m: x, y go from {low} to {high} m")
    hulls = [_hull(points - middle, f"{path}: {name}") for name, points in pieces]
    is_box = np.array([filled for _, filled in hulls])
    order = np.argsort(~is_box, kind="stable")
    boxes = [(points.min(axis=0), points.max(axis=0)) for points, filled in hulls if filled]
    solids = Solids(np.array(boxes).reshape(-1, 2, 3), tuple(points for points, filled in hulls if not filled))
    number = {name: k for k, name in enumerate(dict.fromkeys(name for name, _ in pieces))}
    building = np.array([number[name] for name, _ in pieces])[order]
    bare = City(path.stem, float(side), solids, building, Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int)))
    return replace(bare, streets=free_streets(bare.side, bare.outdoors))


def _hull(points: np.ndarray, where: str) -> tuple[np.ndarray, bool]:
    """The corners of the convex hull of points (V, 3), and whether it is a box along the axes."""
    from scipy.spatial import ConvexHull, QhullError  # which takes long to import

    try:
        hull = ConvexHull(points)
    except QhullError:
        raise ValueError(f"{where} has no volume: a piece is the convex hull of at least four points off a plane") from None
    return points[hull.vertices], hull.volume >= (1 - FLUSH) * np.prod(np.ptp(points, axis=0))


def _shapely() -> ModuleType:
    try:
        import shapely
    except ImportError:
        raise missing("reading GeoJSON", "city") from None
    return shapely


def _features(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """The features of a file, each with a name for messages."""
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path} is not GeoJSON: {error}") from None
    if not isinstance(content, dict) or not isinstance(content.get("features"), list):
        raise ValueError(f"{path} is no FeatureCollection")
    return [(f"{path}, feature {k} (from 0)", feature) for k, feature in enumerate(content["features"])]


def _geometry(feature: dict[str, Any], where: str) -> Any:
    """The footprint of a feature, as a shapely geometry."""
    shapely = _shapely()
    try:
        shape = shapely.from_geojson(json.dumps(feature["geometry"]))
    except (KeyError, TypeError, shapely.errors.ShapelyError) as error:
        raise ValueError(f"{where}: its geometry cannot be read: {error!r}") from None
    if shape.geom_type not in ("Polygon", "MultiPolygon"):
        raise ValueError(f"{where} is a {shape.geom_type}: only Polygon and MultiPolygon are footprints")
    if not shape.is_valid or shape.is_empty:
        raise ValueError(f"{where} is no valid polygon: {shapely.is_valid_reason(shape)}")
    return shapely.force_2d(shape)


def _projected(shapes: np.ndarray, path: Path) -> np.ndarray:
    """Shapes in metres about the middle of shapes in degrees (equirectangular projection)."""
    shapely = _shapely()
    west, south, east, north = bounds = shapely.total_bounds(shapes)
    if (np.abs(bounds) > [180, 90, 180, 90]).any():
        raise ValueError(f"{path} has coordinates from {bounds[:2]} to {bounds[2:]}, which are no degrees: are they metres?")
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
        top = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        top = math.nan
    if not 0 < top < math.inf:
        raise ValueError(f"{where}: its {name} is {value!r}: metres above 0, or a default height, are needed")
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
