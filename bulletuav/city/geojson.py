"""Import of cities from JSON files: GeoJSON, Overpass JSON and CityJSON."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.city.assembly import REMEDY, assemble, check_extent, check_flags
from bulletuav.city.building_tags import find_other_kind, has_building_tags, read_tags
from bulletuav.city.cityjson import read_buildings
from bulletuav.city.import_report import Notebook
from bulletuav.city.model import City
from bulletuav.city.overpass import Feature, read_elements
from bulletuav.city.reference_systems import convert_to_degrees, read_code
from bulletuav.city.tags import HeightReader
from bulletuav.earth.geodesy import degree_lengths
from bulletuav.errors import require_file, shown
from bulletuav.geometry.polygons import SLIVER, area_of, convex_pieces, extruded, import_shapely
from bulletuav.parsing import read_json

MIN_AREA = 1e-18
"""Minimum area of a footprint, square degrees or m^2"""

OTHERS = ("Point", "MultiPoint", "LineString", "MultiLineString", "GeometryCollection")
"""Geometry types that are not footprints"""
NONE_OF = (
    "not a FeatureCollection, Feature, Polygon or MultiPolygon (GeoJSON), Overpass JSON with "
    "`elements`, or CityJSON"
)
COVERED = 0.9
"""Minimum fraction of an outline that its parts must cover to avoid a warning"""


class Footprint(NamedTuple):
    """Footprint of a building or building part.

    Attributes:
        where: Name of its feature.
        building: Name of the building.
        properties: Properties of the feature.
        shape: Shapely Polygon or MultiPolygon.
    """

    where: str
    building: str
    properties: Mapping[str, Any]
    shape: Any

    @property
    def is_part(self) -> bool:
        """Whether the feature is a building part in the sense of OpenStreetMap."""
        return self.properties.get("building:part") not in (None, False, "no")


def from_geojson(
    path: str | Path,
    side: float | None = None,
    height: str = "height",
    default_height: float | None = None,
    metres: bool = False,
    strict: bool = False,
) -> City:
    """Read a city from GeoJSON, Overpass JSON or CityJSON.

    GeoJSON is a FeatureCollection of building footprints, which are Polygons or MultiPolygons, or
    one Feature or footprint alone. They are cut into convex pieces; courtyards stay open.
    Coordinates are degrees of longitude and latitude (RFC 7946), or have a member `crs`. They are
    projected around the centre of all footprints such that meridians and the central parallel keep
    their length. The function requires the extra `city`.

    Overpass JSON has `elements`, with the geometries of `out geom` or the nodes of ways. CityJSON
    is read by `cityjson.read_buildings`.

    Of areas with tags of OpenStreetMap, only buildings and building parts above the ground are
    read. Others, such as land use, water, and demolished or underground buildings, are counted in
    the report. In a file without tags of buildings, each area without such a tag is a building.

    Properties are read as OpenStreetMap defines them. A height may have a unit ("40 ft"); of a list
    ("12;14") the maximum is used. Without a height, `building:levels` and `roof:levels` define it,
    3 m each. `min_height`, or `building:min_level`, is the height of the underside. If an outline
    contains features with `building:part`, these replace it.

    Args:
        path: The file.
        side: Side of the city's square, m. The square is centred on the origin of the coordinates,
            which is the centre of all footprints if they are in degrees; nothing is shifted. None
            for the smallest square around the footprints, whose centre becomes the origin.
        height: Property with the height of a building, m.
        default_height: Height of buildings without height and levels, m; None for an estimate of 10
            m.
        metres: Whether coordinates are metres east and north instead of degrees. A member `crs` is
            not needed then.
        strict: Whether to raise an error instead of repairing, estimating or skipping.

    Returns:
        The city, with streets on its free ground. Its `report` lists all repairs.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If the extra `city` is not installed.
        ValueError: If the file is none of the three, coordinates are not degrees, the city
            does not fit into `side` or a world, an option is invalid, or `strict` forbids a repair,
            an estimate or a skipped feature; the message names the feature.
    """
    path = require_file("city", path, REMEDY)
    check_flags(metres=metres, strict=strict)
    notes = Notebook(path, strict)
    reader = HeightReader(height, default_height, notes)
    shapely = import_shapely("reading GeoJSON")
    content = read_json(path, "GeoJSON")
    if not isinstance(content, dict):
        raise ValueError(f"{path} is {NONE_OF}")
    if content.get("type") == "CityJSON":
        if metres:
            raise ValueError(f"metres has no effect for CityJSON such as {path}: leave it out")
        return assemble(path, read_buildings(path, content, reader, notes), side, notes)
    code = read_code(path, content.get("crs"))
    if metres and content.get("crs") is not None and code is None:
        raise ValueError(f"metres is True, and {path} has a crs in degrees: leave metres out")
    footprints = _footprints(path, content, height, notes)
    # Project to metres around the centre, unless the file is in metres
    if footprints:
        shapes = np.array([footprint.shape for footprint in footprints])
        if code is not None and not metres:
            shapes = convert_to_degrees(shapes, code, path)
        if not metres:
            shapes = _projected(shapes, path)
        west, south, east, north = shapely.total_bounds(shapes)
        check_extent(path, np.array([west, south]), np.array([east, north]), side)
        moved = zip(footprints, shapes, strict=True)
        footprints = [footprint._replace(shape=shape) for footprint, shape in moved]

    # Each footprint becomes convex prisms that share the building's name
    pieces: list[tuple[str, np.ndarray]] = []
    for footprint in _without_outlines(footprints, notes):
        bottom, top = reader.span(footprint.properties, footprint.where)
        outlines = _outlines(footprint.shape)
        if not outlines:
            notes.add("skipped", footprint.where, "it has no area")
        pieces += [(footprint.building, extruded(outline, bottom, top)) for outline in outlines]
    return assemble(path, pieces, side, notes)


def _features(path: Path, content: Mapping[str, Any], notes: Notebook) -> Iterator[Feature]:
    """Yield the features of GeoJSON or Overpass JSON."""
    if isinstance(content.get("elements"), list):
        if "remark" in content:
            remedy = "query a smaller area, or with a longer [timeout:...] or larger [maxsize:...]"
            report = f"the server reports {shown(content['remark'])}, so that data may be missing"
            notes.add("skipped", "remark", f"{report}: {remedy}")
        yield from read_elements(content["elements"])
        return
    listed = content.get("features")
    if content.get("type") == "Feature":
        listed = [content]
    elif content.get("type") in ("Polygon", "MultiPolygon"):
        listed = [{"type": "Feature", "properties": {}, "geometry": content}]
    if not isinstance(listed, list):
        raise ValueError(f"{path} is {NONE_OF}")
    for k, feature in enumerate(listed):
        known = feature if isinstance(feature, dict) else {}
        tags = read_tags(known.get("properties"))
        yield Feature(f"feature {k} (from 0)", tags, known.get("geometry"))


def _footprints(
    path: Path, content: Mapping[str, Any], height: str, notes: Notebook
) -> list[Footprint]:
    """Read the features with a footprint, in the coordinates of the file."""
    features = list(_features(path, content, notes))
    is_tagged = has_building_tags(feature.tags for feature in features)
    found = []
    # Features that are no buildings, or unusable, are noted and skipped
    for where, tags, geometry, problem in features:
        kind = find_other_kind(tags, height, is_tagged) if tags or geometry is not None else None
        if kind is not None:
            notes.add("other", where, kind)
        elif problem:
            notes.add("skipped", where, problem)
        elif (shape := _shape(geometry, where, notes)) is not None:
            found.append(Footprint(where, where, tags, shape))
    return found


def _shape(geometry: Any, where: str, notes: Notebook) -> Any:
    """Return the footprint of a geometry as a valid two-dimensional shapely geometry, or None."""
    shapely = import_shapely("reading GeoJSON")
    if not isinstance(geometry, dict):
        notes.add(
            "skipped",
            where,
            f"its geometry cannot be read: a Polygon or MultiPolygon is needed, "
            f"not {shown(geometry)}",
        )
        return None
    # Points and lines (trees, lamps, paths) are never passed to GEOS
    kind = geometry.get("type")
    if kind in OTHERS:
        notes.add("skipped", where, f"it is a {kind}: only Polygon and MultiPolygon are footprints")
        return None
    # Drop the third coordinate
    try:
        shape = shapely.force_2d(shapely.from_geojson(json.dumps(geometry)))
    except shapely.errors.ShapelyError as error:
        notes.add("skipped", where, f"its geometry cannot be read: {error}")
        return None
    if shape.is_empty:
        notes.add("skipped", where, f"it is an empty {shape.geom_type}, without coordinates")
        return None
    # Self-intersecting outlines are common, and are repaired
    corners = shape.bounds
    if not shape.is_valid and np.isfinite(corners).all():
        reason = shapely.is_valid_reason(shape)
        notes.add("repaired", where, f"it is not a valid polygon: {reason}")
        shape = _polygons(shapely.make_valid(shape))
    # The repaired shape may be degenerate
    if not np.isfinite(corners).all() or shape.area < MIN_AREA:
        notes.add(
            "skipped",
            where,
            f"it has no area: its corners range from {corners[:2]} to {corners[2:]}",
        )
        return None
    return shape


def _polygons(shape: Any) -> Any:
    """Return the polygons of a geometry, without lines and points."""
    shapely = import_shapely("reading GeoJSON")
    parts = shapely.get_parts(shapely.get_parts(shape))
    return shapely.union_all([part for part in parts if part.geom_type == "Polygon"])


def _projected(shapes: np.ndarray, path: Path) -> np.ndarray:
    """Project shapes from degrees to metres around their centre.

    Distances to the east and north are exact at the centre, on the WGS-84 ellipsoid.
    """
    shapely = import_shapely("reading GeoJSON")
    west, south, east, north = bounds = shapely.total_bounds(shapes)
    if (np.abs(bounds) > [180, 90, 180, 90]).any():
        raise ValueError(
            f"{path} has coordinates from {bounds[:2]} to {bounds[2:]}, which are not degrees: "
            f"are they metres?"
        )
    if east - west > 180:
        # A city that crosses the antimeridian: continue longitudes beyond 180
        shapes = shapely.transform(
            shapes, lambda degrees: np.where([True, False], degrees % 360, degrees)
        )
        west, south, east, north = shapely.total_bounds(shapes)
    middle = np.array([west + east, south + north]) / 2
    metres = np.array(degree_lengths(middle[1]))
    projected: np.ndarray = shapely.transform(shapes, lambda degrees: (degrees - middle) * metres)
    return projected


def _without_outlines(footprints: Sequence[Footprint], notes: Notebook) -> list[Footprint]:
    """Remove the outlines of buildings with parts, and name the parts after the building.

    References:
        OpenStreetMap wiki, Simple_3D_Buildings: a 3-D renderer ignores the outline of a building
        that has parts.
    """
    shapely = import_shapely("reading GeoJSON")
    outlines = [footprint for footprint in footprints if not footprint.is_part]
    parts = [footprint for footprint in footprints if footprint.is_part]
    # A part belongs to the outline that contains its representative point
    points = [part.shape.representative_point() for part in parts]
    tree = shapely.STRtree([outline.shape for outline in outlines])
    owners = dict(zip(*tree.query(points, predicate="within"), strict=True)) if parts else {}
    # Parts get the name of their building; a part without an outline is a building itself
    own: dict[str, list[Any]] = {}
    named = {}
    for k, part in enumerate(parts):
        building = outlines[owners[k]].where if k in owners else part.where
        own.setdefault(building, []).append(part.shape)
        named[part.where] = part._replace(building=building)

    # Parts replace outlines, with a note that depends on the covered fraction
    left = []
    for footprint in footprints:
        if footprint.where in named:
            left.append(named[footprint.where])
        elif footprint.where in own:
            shapes = own[footprint.where]
            covered = shapely.union_all(shapes).intersection(footprint.shape).area
            fraction = covered / footprint.shape.area
            what = f"its {len(shapes)} parts cover {fraction:.0%} of it and replace it"
            notes.add("outline" if fraction >= COVERED else "uncovered", footprint.where, what)
        else:
            left.append(footprint)
    return left


def _outlines(shape: Any) -> list[np.ndarray]:
    """Return the outlines (V, 2) of the convex pieces of a footprint, m."""
    shapely = import_shapely("reading GeoJSON")
    pieces = [piece for polygon in shapely.get_parts(shape) for piece in convex_pieces(polygon)]
    return [piece for piece in pieces if area_of(piece - piece[0]) > SLIVER]
