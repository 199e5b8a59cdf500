"""Features that are no buildings: which are left out, and how they are counted."""

import json
import warnings

import pytest

from bulletuav.city.building_tags import read_tags
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_geojson

LOT = [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]
FAR = [[60, 0], [80, 0], [80, 10], [60, 10], [60, 0]]


def feature(properties, ring=LOT):
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


BUILDING = feature({"building": "yes", "height": "8"}, FAR)


def read(path, **options):
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return from_geojson(path, metres=True, side=200.0, **options)


def test_a_district_has_only_its_building(geojson):
    """Areas of an export of OpenStreetMap with one building among six others."""
    others = [
        {"landuse": "residential"},
        {"natural": "water"},
        {"leisure": "park"},
        {"amenity": "parking"},
        {"demolished:building": "yes"},
        {"highway": "pedestrian", "area": "yes"},
    ]
    city = read(geojson(BUILDING, *map(feature, others)), strict=True)
    assert city.heights.tolist() == [8]
    assert city.report.counts == {"other": 6}
    assert city.report.others == {
        "landuse": 1,
        "natural": 1,
        "leisure": 1,
        "amenity": 1,
        "demolished:building": 1,
        "highway": 1,
    }


ABSENT = [
    ({"building": "no"}, "building=no"),
    ({"building": None}, "without tags of a building"),
    ({}, "without tags of a building"),
    ({"building": "no", "landuse": "farm"}, "landuse=farm"),
    ({"razed:building": "house"}, "razed:building=house"),
    ({"abandoned:building": "house"}, "abandoned:building=house"),
    ({"building": "no", "height": "5"}, "building=no"),
    ({"building": "yes", "demolished": "yes"}, "demolished building"),
    ({"building": "proposed"}, "proposed building"),
    ({"building": "yes", "location": "underground"}, "underground building"),
    ({"building:part": "yes", "location": "underground"}, "underground building"),
    ({"building": "yes", "layer": "-1"}, "underground building"),
    (
        {"building": "garage", "building:levels": "0", "building:levels:underground": "2"},
        "underground building",
    ),
]


@pytest.mark.parametrize(("tags", "kind"), ABSENT)
def test_what_is_no_building_above_the_ground(geojson, tags, kind):
    city = read(geojson(BUILDING, feature(tags)), strict=True)
    assert city.heights.tolist() == [8]
    assert [(note.where, note.what) for note in city.report.notes] == [("feature 1 (from 0)", kind)]


@pytest.mark.parametrize(
    "tags",
    [
        {"building": "yes", "height": 5},
        {"building:part": "roof", "height": 5},
        {"building": "yes", "layer": "-1", "building:levels": "2", "height": 5},
        {"building": "yes", "layer": "1", "height": 5},
        {"building": "yes", "amenity": "school", "height": 5},
        {"building": "ruins", "abandoned": "yes", "height": 5},
    ],
)
def test_what_is_a_building(geojson, tags):
    city = read(geojson(BUILDING, feature(tags)), strict=True)
    assert city.heights.tolist() == [8, 5]
    assert city.report.notes == ()


def test_plain_footprints_need_no_tags_of_buildings(geojson):
    plain = [feature({"height": 8, "landuse": "commercial"}), feature({"id": 4}, FAR)]
    assert read(geojson(*plain), default_height=6.0).heights.tolist() == [8, 6]
    with pytest.raises(ValueError, match=r"no buildings: .*other kinds \(2 landuse, 1 natural\)"):
        read(geojson(*map(feature, ({"landuse": "a"}, {"landuse": "b"}, {"natural": "wood"}))))


def test_nested_tags_of_converters(geojson):
    hstore = r'"building:levels"=>"4","name"=>"a \"b\" \\"'
    expected = {"building": "yes", "building:levels": "4", "name": 'a "b" \\', "other_tags": hstore}
    assert read_tags({"building": "yes", "other_tags": hstore}) == expected
    nested = feature({"type": "way", "id": 3, "tags": {"building": "yes", "height": "12 m"}})
    assert read(geojson(nested)).heights.tolist() == [12]


def test_a_byte_order_mark_is_accepted(tmp_path):
    path = tmp_path / "town.geojson"
    text = json.dumps({"type": "FeatureCollection", "features": [BUILDING]})
    path.write_text(text, encoding="utf-8-sig")
    assert read(path).heights.tolist() == [8]
