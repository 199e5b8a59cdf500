"""Maps in JSON: reference systems of GeoJSON, Overpass JSON and CityJSON."""

import json
import sys
import warnings

import numpy as np
import pytest

from bulletuav.city import overpass as overpass_module
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import READERS, from_geojson

LOT = [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]


def write(folder, content, name="town.json"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def read(path, **options):
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return from_geojson(path, **{"side": 300.0, **options})


def collection(ring, **members):
    geometry = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"height": 8}, "geometry": geometry}
    return {"type": "FeatureCollection", "features": [feature], **members}


def named(name):
    return {"type": "name", "properties": {"name": name}}


# Reference systems


def utm(degrees):
    """Eastings and northings of UTM zone 32 near its central meridian (9 degrees), by series.

    Krueger's series to the third order; the centre of the town is at 48 degrees north.
    """
    lon, lat = np.radians(np.asarray(degrees, dtype=float)).T
    a, f = 6378137.0, 1 / 298.257222101
    n = f / (2 - f)
    radius = a / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    alpha = (
        n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16,
        13 * n**2 / 48 - 3 * n**3 / 5,
        61 * n**3 / 240,
    )
    e = 2 * np.sqrt(n) / (1 + n)
    t = np.sinh(np.arctanh(np.sin(lat)) - e * np.arctanh(e * np.sin(lat)))
    away = lon - np.radians(9.0)
    xi, eta = np.arctan2(t, np.cos(away)), np.arctanh(np.sin(away) / np.sqrt(1 + t**2))
    east, north = eta.copy(), xi.copy()
    for j, factor in enumerate(alpha, 1):
        east += factor * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
        north += factor * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
    return np.stack([500000 + 0.9996 * radius * east, 0.9996 * radius * north], axis=1)


RING = [[9.1, 48.0], [9.1003, 48.0], [9.1003, 48.0001], [9.1, 48.0001], [9.1, 48.0]]


@pytest.mark.parametrize(
    "crs",
    [
        named("urn:ogc:def:crs:EPSG::25832"),
        named("EPSG:25832"),
        named("http://www.opengis.net/def/crs/EPSG/0/25832"),
        {"type": "EPSG", "properties": {"code": 25832}},
    ],
)
def test_coordinates_in_utm_become_those_in_degrees(tmp_path, crs):
    expected = read(write(tmp_path, collection(RING)))
    city = read(write(tmp_path, collection(utm(RING).tolist(), crs=crs)))
    assert len(city.heights) == 1
    np.testing.assert_allclose(city.footprints[0], expected.footprints[0], atol=1e-3)


@pytest.mark.parametrize("name", ["urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326"])
def test_a_crs_in_degrees_changes_nothing(tmp_path, name):
    expected = read(write(tmp_path, collection(RING)))
    path = write(tmp_path, collection(RING, crs=named(name)))
    assert np.array_equal(read(path).footprints[0], expected.footprints[0])
    with pytest.raises(ValueError, match="metres is True, and .* has a crs in degrees"):
        read(path, metres=True)


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        (named("urn:ogc:def:crs:EPSG::999999"), "EPSG:999999, which is unknown"),
        (named("local"), "name is unknown: convert the file to degrees, as by `ogr2ogr"),
        ({"type": "link", "properties": {"href": "http://a"}}, "name is unknown: convert"),
        (3, "name is unknown: convert"),
    ],
)
def test_a_crs_that_is_unknown_is_refused(tmp_path, crs, message):
    with pytest.raises(ValueError, match=message):
        read(write(tmp_path, collection(LOT, crs=crs)))


def test_a_crs_needs_the_extra_but_metres_do_not(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    path = write(tmp_path, collection(LOT, crs=named("EPSG:25832")))
    with pytest.raises(ImportError, match=r"EPSG:25832 needs the extra 'city'"):
        read(path)
    assert read(path, metres=True).heights.tolist() == [8]


# Overpass JSON

# Corners about 10 m apart at the equator, by their numbers
PLACES = {1: (0, 0), 2: (3e-4, 0), 3: (3e-4, 2e-4), 4: (0, 2e-4), 5: (1e-4, 5e-5), 6: (2e-4, 5e-5)}
PLACES |= {7: (2e-4, 15e-5), 8: (1e-4, 15e-5)}
NODES = [{"type": "node", "id": k, "lon": x, "lat": y} for k, (x, y) in PLACES.items()]
YES = {"building": "yes", "height": "9"}


def way(number, *nodes, geom=False, **tags):
    found = {"type": "way", "id": number, "nodes": list(nodes)}
    if geom:
        found["geometry"] = [{"lon": PLACES[k][0], "lat": PLACES[k][1]} for k in nodes]
    return {**found, **({"tags": tags} if tags else {})}


def relation(number, roles, geom=None, **tags):
    members = [
        {"type": "way", "ref": ref, "role": role, **({"geometry": geom[ref]} if geom else {})}
        for ref, role in roles.items()
    ]
    return {"type": "relation", "id": number, "members": members, "tags": tags}


def overpass(*elements, **members):
    return {"version": 0.6, "generator": "Overpass API", "elements": list(elements), **members}


def test_ways_of_both_outputs_of_overpass(tmp_path):
    tree = {**NODES[4], "id": 90, "tags": {"natural": "tree"}}
    path = [way(11, 1, 3, highway="footway"), way(12, 5, 6, 7, 8, 5, landuse="grass")]
    body = [*NODES, tree, way(10, 1, 2, 3, 4, 1, **YES), *path]
    geom = [tree, way(10, 1, 2, 3, 4, 1, geom=True, **YES), *path]
    for elements in (body, geom):
        city = read(write(tmp_path, overpass(*elements)), strict=True)
        assert city.heights.tolist() == [9]
        extent = np.ptp(city.footprints[0], axis=0)
        # A degree at the equator has 111,319.49 m to the east and 110,574.28 m to the north
        np.testing.assert_allclose(extent, [3e-4 * 111319.49, 2e-4 * 110574.28], rtol=1e-6)
        assert city.report.others == {"natural": 1, "highway": 1, "landuse": 1}


def test_multipolygons_have_their_courtyards(tmp_path):
    """The outer ring consists of two ways, and the inner one has no tags."""
    halves = [way(20, 1, 2, 3), way(21, 1, 4, 3), way(22, 5, 6, 7, 8, 5)]
    roles = {20: "outer", 21: "outer", 22: "inner"}
    tags = {"type": "multipolygon", **YES}
    geometries = {one["id"]: way(0, *one["nodes"], geom=True)["geometry"] for one in halves}
    for elements in (
        [*NODES, *halves, relation(30, roles, **tags)],
        [relation(30, roles, geometries, **tags)],
    ):
        city = read(write(tmp_path, overpass(*elements)), strict=True)
        assert city.heights.tolist() == [9]
        assert city.report.notes == ()
        area = (6e-8 - 1e-8) * 111319.49 * 110574.28
        assert city.coverage * 300**2 == pytest.approx(area, rel=1e-6)
        assert city.outdoors(np.zeros((1, 2))).all()


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (
            {"type": "way", "id": 7, "tags": YES},
            "it has no geometry: query the data with `out geom",
        ),
        ({**way(7, 1, 2, 99, 1), "tags": YES}, "its node 99 is not in the file: query"),
        ({**way(7, 1, 2), "geometry": [None], "tags": YES}, "a corner of it is not in the file"),
        ({**NODES[0], "id": 9, "lon": "x", "tags": YES}, "a corner of it is not numbers"),
        (way(7, 1, 2, 3, **YES), "it is a LineString"),
        (relation(7, {99: "outer"}, type="multipolygon", **YES), "its way 99 is not in the file"),
        (relation(7, {10: "outer", 50: "outer"}, type="multipolygon", **YES), "no closed rings"),
        (relation(7, {}, type="multipolygon", **YES), "no outer ways"),
        (relation(7, {10: "outer"}, type="site", **YES), "no node, way or multipolygon"),
        ({"type": "area", "id": 7, "tags": YES}, "no node, way or multipolygon"),
        (3, "it is 3"),
    ],
)
def test_incomplete_elements_are_left_out(tmp_path, element, message):
    content = overpass(*NODES, way(10, 1, 2, 3, 4, 1, **YES), way(50, 5, 7), element)
    path = write(tmp_path, content)
    city = read(path)
    assert city.heights.tolist() == [9]
    assert city.report.counts.get("skipped") == 1
    with pytest.raises(ValueError, match=message):
        read(path, strict=True)


def test_a_remark_of_the_server_is_reported(tmp_path):
    remark = "runtime error: Query timed out"
    path = write(tmp_path, overpass(*NODES, way(10, 1, 2, 3, 4, 1, **YES), remark=remark))
    assert remark in read(path).report.notes[0].what
    with pytest.raises(ValueError, match="Query timed out.*query a smaller area, or with a longer"):
        read(path, strict=True)


def test_centres_alone_name_the_output_that_is_needed(tmp_path):
    """As of `out center;`."""
    centre = {"lat": 48.0, "lon": 9.0}
    lone = {"type": "way", "id": 3, "center": centre, "tags": YES, "nodes": []}
    many = {**relation(4, {3: "outer"}, type="multipolygon", **YES), "center": centre}
    for element in (lone, many):
        with pytest.raises(ValueError, match=r"its centre only: query the data with `out geom;`"):
            read(write(tmp_path, overpass(element)), strict=True)
        with pytest.raises(ValueError, match=r"contains no buildings.*`out geom;`"):
            read(write(tmp_path, overpass(element)))


@pytest.mark.parametrize("kind", ["Polygon", "MultiPolygon", "Feature"])
def test_a_feature_or_footprint_alone_is_read(tmp_path, kind):
    whole = collection(LOT)
    feature = whole["features"][0]
    content = feature if kind == "Feature" else feature["geometry"]
    if kind == "MultiPolygon":
        content = {"type": kind, "coordinates": [feature["geometry"]["coordinates"]]}
    city = read(write(tmp_path, content), metres=True, default_height=8.0)
    expected = read(write(tmp_path, whole), metres=True)
    np.testing.assert_array_equal(city.solids.boxes, expected.solids.boxes)


# CityJSON


def solid(*ground, eaves, ridge=None):
    """Vertices and surfaces of a house over a rectangle, flat or with a gable roof along x."""
    (x0, y0), (x1, y1) = ground
    low = [(x0, y0, 3), (x1, y0, 3), (x1, y1, 3), (x0, y1, 3)]
    high = [(x, y, 3 + eaves) for x, y, _ in low]
    walls = [[[k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k]] for k in range(4)]
    if ridge is None:
        return low + high, [[[0, 3, 2, 1]], [[4, 5, 6, 7]], *walls]
    top = [(x, (y0 + y1) / 2, 3 + ridge) for x in (x0, x1)]
    roof = [[[4, 5, 9, 8]], [[6, 7, 8, 9]], [[4, 8, 7]], [[5, 6, 9]]]
    return low + high + top, [[[0, 3, 2, 1]], *roof, *walls]


def cityjson(objects, vertices, version="2.0", **members):
    """Coordinates are millimetres from a place in the Dutch grid."""
    whole = [[round(1000 * number) for number in vertex] for vertex in vertices]
    return {
        "type": "CityJSON",
        "version": version,
        "transform": {"scale": [0.001] * 3, "translate": [84000.0, 446000.0, -2.0]},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/7415"},
        "CityObjects": objects,
        "vertices": whole,
        **members,
    }


def building(boundaries, kind="Solid", lod="2.2", **members):
    geometry = {"type": kind, "lod": lod, "boundaries": boundaries}
    return {"type": "Building", "geometry": [geometry], **members}


@pytest.mark.parametrize("kind", ["Solid", "MultiSurface", "CompositeSurface", "MultiSolid"])
@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0"])
def test_a_gable_roof_is_exact(tmp_path, kind, version):
    vertices, surfaces = solid((0, 0), (20, 10), eaves=6, ridge=9)
    nested = {"Solid": [surfaces], "MultiSolid": [[surfaces]]}.get(kind, surfaces)
    city = read(write(tmp_path, cityjson({"h": building(nested, kind)}, vertices, version)))
    assert city.report.counts == {"moved": 1}
    assert city.heights == pytest.approx([9])
    place = np.array([[0, 0], [0, 4.999], [5, 2.5], [-9.9, -2.5], [0, 6]])
    assert city.roof(place) == pytest.approx([9, 6.0006, 7.5, 7.5, 0], abs=2e-3)


def test_courtyards_and_parts_of_cityjson(tmp_path):
    outer, _ = solid((0, 0), (30, 30), eaves=10)
    inner, _ = solid((10, 10), (20, 20), eaves=10)
    tower, surfaces = solid((40, 0), (50, 10), eaves=25)
    tower = [(x, y, z + 5) for x, y, z in tower]
    vertices = outer + inner + tower
    yard = [[[4, 5, 6, 7], [12, 13, 14, 15]], [[0, 3, 2, 1], [8, 11, 10, 9]]]
    moved = [[[k + 16 for k in ring] for ring in surface] for surface in surfaces]
    flat = building([[[0, 1, 2, 3]]], "MultiSurface", "0")
    objects = {
        "a": {**flat, "children": ["a-1", "a-2"]},
        "a-1": {**building([yard]), "type": "BuildingPart", "parents": ["a"]},
        "a-2": {**building([moved]), "type": "BuildingPart", "parents": ["a"]},
        "tree": {"type": "SolitaryVegetationObject"},
        "bridge": {"type": "Bridge"},
    }
    city = read(write(tmp_path, cityjson(objects, vertices)), strict=True)
    assert city.heights == pytest.approx([30])
    assert city.report.counts == {"other": 2, "outline": 1, "moved": 1}
    assert city.report.others == {"SolitaryVegetationObject": 1, "Bridge": 1}
    place = np.array([[-10.0, 0.0], [-24.0, 0.0], [20.0, -10.0]])
    assert city.roof(place) == pytest.approx([0, 10, 30])
    assert city.outdoors(place).tolist() == [True, False, False]
    assert sorted(set(city.solids.bounds[:, 0, 2].round(6))) == [0, 5]  # the tower is in the air


def test_footprints_and_levels_of_detail_of_cityjson(tmp_path):
    vertices, surfaces = solid((0, 0), (20, 10), eaves=6)
    fine, _ = solid((0, 0), (20, 10), eaves=8)
    flat = [[[0, 1, 2, 3]]]
    for attributes, height in (
        ({"measuredHeight": 12.5}, 12.5),
        ({"height": 7, "measuredHeight": 12.5}, 7),
        ({"storeysAboveGround": 4}, 12),
        ({}, 10),
    ):
        one = building(flat, "MultiSurface", "0.1", attributes=attributes)
        city = read(write(tmp_path, cityjson({"b": one}, vertices)))
        assert city.heights == pytest.approx([height])
    geometry = [
        {"type": "MultiSurface", "lod": "0", "boundaries": flat},
        {"type": "Solid", "lod": "1.3", "boundaries": [surfaces]},
        {
            "type": "Solid",
            "lod": 3,
            "boundaries": [[[[k + 8 for k in r] for r in s] for s in surfaces]],
        },
        {"type": "MultiPoint", "lod": "2", "boundaries": [0]},
    ]
    content = cityjson({"b": {"type": "Building", "geometry": geometry}}, vertices + fine)
    assert read(write(tmp_path, content)).heights == pytest.approx([6])
    del geometry[1]
    assert read(write(tmp_path, content)).heights == pytest.approx([8])


VERTICES, SURFACES = solid((0, 0), (20, 10), eaves=6)
GOOD = building([SURFACES])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": "0.9"}, "version '0.9' of CityJSON: .* `cjio in.json upgrade"),
        ({"version": 2}, "version 2 of CityJSON"),
        ({"vertices": [], "CityObjects": {}}, "contains no buildings"),
        ({"vertices": [[1, 2]]}, "no vertices of three numbers"),
        ({"vertices": "x"}, "vertices of .* are not numbers"),
        ({"transform": {"scale": [1]}}, "translate of .* is not numbers|no vertices of three"),
        ({"transform": 3}, "is not numbers"),
        ({"CityObjects": [1]}, "as CityObjects: objects are needed"),
        ({"CityObjects": {}}, "contains no buildings"),
        (
            {"metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/4979"}},
            "in degrees .*: metres are needed; convert it",
        ),
        (
            {"metadata": {"referenceSystem": "urn:ogc:def:crs,crs:EPSG::4326,crs:EPSG::5773"}},
            "in degrees .EPSG:4326.",
        ),
    ],
)
def test_files_that_are_no_cityjson(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        read(write(tmp_path, {**cityjson({"b": GOOD}, VERTICES), **change}))


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        (building([[[[0, 1, 99]]]]), "a ring has the vertex 99, and there are 8, from 0 on"),
        (building([[[[0, 1, -1]]]]), "a ring has the vertex -1, and there are 8"),
        (building([[[[0, 1]]]]), "a ring is"),
        (building([[[[0, 1, 0.5]]]]), "a ring is"),
        (building([[["abc"]]]), "a ring is"),
        (building([]), "cannot be read"),
        (building([3]), "cannot be read"),
        (building(SURFACES, "GeometryInstance"), "no geometry of MultiSurface"),
        ({"type": "Building"}, "no geometry of MultiSurface"),
        ({"type": "Building", "geometry": 3}, "no geometry of MultiSurface"),
    ],
)
def test_bad_buildings_of_cityjson_are_left_out(tmp_path, odd, message):
    path = write(tmp_path, cityjson({"b": GOOD, "odd": odd}, VERTICES))
    city = read(path)
    assert city.heights == pytest.approx([6])
    assert city.report.first("skipped") == ["odd"]
    with pytest.raises(ValueError, match=message):
        read(path, strict=True)


def test_parents_in_a_circle_end(tmp_path):
    objects = {
        "a": {**GOOD, "parents": ["b"]},
        "b": {**GOOD, "parents": ["a"]},
    }
    assert len(read(write(tmp_path, cityjson(objects, VERTICES))).heights) == 2


def test_options_without_effect_are_refused(tmp_path):
    with pytest.raises(ValueError, match="metres has no effect for CityJSON"):
        read(write(tmp_path, cityjson({"b": GOOD}, VERTICES)), metres=True)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("a.gml", "CityGML: convert it to CityJSON, as by `citygml-tools to-cityjson"),
        ("a.city.jsonl", "CityJSONSeq: convert"),
        ("a.osm", "osmtogeojson"),
        ("a.osm.pbf", "osmium export"),
    ],
)
def test_other_formats_name_their_converter(tmp_path, name, message):
    path = write(tmp_path, "", name)
    with pytest.raises(ValueError, match=message):
        READERS[path.suffix](path)


def test_cityjson_in_feet(tmp_path):
    vertices, surfaces = solid((0, 0), (100, 100), eaves=100)
    feet = {"metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/2263"}}
    city = read(write(tmp_path, cityjson({"h": building([surfaces])}, vertices, **feet)))
    # The US survey foot is 1200 / 3937 m
    assert city.heights == pytest.approx([100 * 1200 / 3937])


def test_long_chains_of_parents_are_read_in_linear_time(tmp_path):
    vertices, surfaces = solid((0, 0), (20, 10), eaves=6)
    objects = {"top": building([surfaces])}
    # Twenty thousand took days
    for k in range(20_000):
        parent = f"p{k - 1}" if k else "top"
        objects[f"p{k}"] = {"type": "BuildingPart", "parents": [parent], "geometry": []}
    objects["last"] = {**building([surfaces]), "type": "BuildingPart", "parents": ["p19999"]}
    city = read(write(tmp_path, cityjson(objects, vertices)))
    assert city.heights.max() == pytest.approx(6)


def test_corners_of_all_relations_are_limited(tmp_path, monkeypatch):
    """Each relation has the 5 corners of the same way."""
    monkeypatch.setattr(overpass_module, "MAX_CORNERS", 10)
    relations = [relation(k, {10: "outer"}, type="multipolygon", **YES) for k in range(20, 25)]
    path = write(tmp_path, overpass(*NODES, way(10, 1, 2, 3, 4, 1), *relations))
    assert read(path).report.counts["skipped"] == 2
    with pytest.raises(ValueError, match="more than 10 corners: .* a smaller area"):
        read(path, strict=True)


def test_a_relation_names_a_way_once(tmp_path):
    twice = {"members": [{"type": "way", "ref": 10, "role": "outer"}] * 2}
    element = {**relation(7, {}, type="multipolygon", **YES), **twice}
    path = write(tmp_path, overpass(*NODES, way(10, 1, 2, 3, 4, 1), element))
    with pytest.raises(ValueError, match="way 10 is listed twice"):
        read(path, strict=True)
