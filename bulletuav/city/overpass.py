"""Overpass JSON: nodes, ways and relations of OpenStreetMap as GeoJSON geometries.

References:
    OpenStreetMap wiki: Overpass API/Overpass QL (out), Relation:multipolygon.
"""

import json
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from bulletuav.city.building_tags import MAX_NAME, read_tags
from bulletuav.errors import numbers_of, shown
from bulletuav.geometry.polygons import import_shapely

INNER = "inner"
OUTPUT = "query the data with `out geom;`"
MAX_CORNERS = 2_000_000
"""Number of corners of all members of relations from which no further member is read"""


class Feature(NamedTuple):
    """Feature of a map.

    Attributes:
        where: Name of the feature.
        tags: Tags of the feature.
        geometry: Geometry as in GeoJSON; anything else is reported.
        problem: Reason why there is no geometry; "" if there is one.
    """

    where: str
    tags: dict[str, Any]
    geometry: Any
    problem: str = ""


class _Elements(dict[tuple[str, str], Any]):
    """Elements by type and identifier.

    Attributes:
        num_corners: Number of corners of all members of relations that were read.
    """

    num_corners = 0


def read_elements(elements: list[Any]) -> Iterator[Feature]:
    """Yield the features of Overpass JSON: tagged nodes, ways and relations, and untagged ways.

    Ways that are members of multipolygons are features only if they have tags themselves. All
    output formats with geometries are read: `out geom`, and `out body` with the nodes of ways.

    Args:
        elements: The list `elements` of the file.
    """
    known = [one for one in elements if isinstance(one, dict)]
    by_id = _Elements(((str(one.get("type")), str(one.get("id"))), one) for one in known)
    members = {
        ("way", str(member.get("ref")))
        for one in known
        if _is_multipolygon(one)
        for member in _members(one)
    }
    for k, element in enumerate(elements):
        if not isinstance(element, dict):
            yield Feature(f"element {k} (from 0)", {}, None, f"it is {shown(element)}")
            continue
        kind, number = str(element.get("type")), str(element.get("id"))
        where, tags = f"{kind} {number}"[:MAX_NAME], read_tags(element.get("tags"))
        is_vertex = not tags and (kind == "node" or (kind, number) in members)
        if is_vertex:
            continue
        try:
            geometry = _geometry(element, kind, by_id)
        except ValueError as error:
            yield Feature(where, tags, None, str(error))
        else:
            yield Feature(where, tags, geometry)


def _geometry(element: Mapping[str, Any], kind: str, by_id: _Elements) -> dict[str, Any] | None:
    """Return the geometry of an element. Raises ValueError if it is incomplete."""
    if kind == "node":
        return {"type": "Point", "coordinates": _place(element)}
    if kind == "way":
        line = _line(element, by_id)
        if len(line) > 3 and line[0] == line[-1]:
            return {"type": "Polygon", "coordinates": [line]}
        return {"type": "LineString", "coordinates": line}
    if _is_multipolygon(element):
        return _multipolygon(element, by_id)
    raise ValueError("it is no node, way or multipolygon")


def _line(element: Mapping[str, Any], by_id: Mapping[tuple[str, str], Any]) -> list[list[float]]:
    """Return the corners of a way, degrees east and north."""
    if isinstance(element.get("geometry"), list):
        return [_place(place) for place in element["geometry"]]
    nodes = element.get("nodes")
    if not isinstance(nodes, list) or not nodes:
        which = "its centre only" if "center" in element else "no geometry"
        raise ValueError(f"it has {which}: {OUTPUT}")
    return [_place(by_id.get(("node", str(node))), f"its node {shown(node)}") for node in nodes]


def _place(element: Any, what: str = "a corner of it") -> list[float]:
    """Return the longitude and latitude of a node, degrees."""
    if not isinstance(element, dict) or not {"lon", "lat"} <= element.keys():
        raise ValueError(f"{what} is not in the file: {OUTPUT}")
    place = numbers_of(f"{what} is", [element["lon"], element["lat"]])
    if place.shape != (2,) or not np.isfinite(place).all():
        raise ValueError(f"{what} is {shown(element)}: numbers lon and lat are needed")
    corner: list[float] = place.tolist()
    return corner


def _is_multipolygon(element: Mapping[str, Any]) -> bool:
    tags = element.get("tags")
    return isinstance(tags, dict) and tags.get("type") == "multipolygon"


def _members(element: Mapping[str, Any]) -> list[dict[str, Any]]:
    members = element.get("members")
    found = [one for one in members if isinstance(one, dict)] if isinstance(members, list) else []
    return [one for one in found if one.get("type") == "way"]


def _multipolygon(element: Mapping[str, Any], by_id: _Elements) -> dict[str, Any]:
    """Join the member ways of a relation to rings, and cut the inner ones out."""
    shapely = import_shapely("reading Overpass JSON")
    lines: dict[bool, list[Any]] = {False: [], True: []}
    listed = set()
    for member in _members(element):
        # `out geom` has the geometry in the member, `out body` in an element of its own
        has_own = isinstance(member.get("geometry"), list)
        if not has_own and "center" in element:
            raise ValueError(f"it has its centre only: {OUTPUT}")
        way = member if has_own else by_id.get(("way", str(member.get("ref"))))
        if way is None:
            raise ValueError(f"its way {shown(member.get('ref'))} is not in the file: {OUTPUT}")
        # A short file can name a long way many times
        if not has_own and str(member.get("ref")) in listed:
            raise ValueError(
                f"its way {shown(member.get('ref'))} is listed twice: delete one of the two members"
            )
        listed.add(str(member.get("ref")))
        if by_id.num_corners > MAX_CORNERS:
            raise ValueError(
                f"its ways and those of relations before it have more than {MAX_CORNERS} corners: "
                f"query a smaller area"
            )
        line = _line(way, by_id)
        by_id.num_corners += len(line)
        if len(line) < 2:
            raise ValueError(f"its way {shown(member.get('ref'))} has {len(line)} corners")
        lines[member.get("role") == INNER].append(shapely.LineString(line))
    areas = []
    for ways in (lines[False], lines[True]):
        try:
            rings, cuts, dangles, invalid = shapely.polygonize_full(ways)
        except shapely.errors.ShapelyError as error:
            raise ValueError(f"its ways form no rings: {error}") from None
        if not all(rest.is_empty for rest in (cuts, dangles, invalid)):
            raise ValueError("its ways form no closed rings")
        areas.append(shapely.union_all(shapely.get_parts(rings)))
    if areas[0].is_empty:
        raise ValueError("it has no outer ways")
    geometry: dict[str, Any] = json.loads(shapely.to_geojson(areas[0].difference(areas[1])))
    return geometry
