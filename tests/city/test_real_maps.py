"""What real map data has: each oddity by itself, with what it must become."""

import math
import warnings

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from bulletuav.city.import_report import KINDS, MendedWarning
from bulletuav.city.imports import from_geojson
from bulletuav.city.tags import read_length
from bulletuav.engine.engine import Engine
from bulletuav.geometry.polygons import area_of, convex_pieces, extruded, turns_left
from bulletuav.vehicle.airframes import load_airframe

LOT = [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]
FAR = [[60, 0], [80, 0], [80, 10], [60, 10], [60, 0]]
WEST_HALF = [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]
EAST_HALF = [[10, 0], [20, 0], [20, 10], [10, 10], [10, 0]]
BOW_TIE = [[0, 0], [10, 10], [10, 0], [0, 10], [0, 0]]
STANDS = {"height": 8}


def feature(properties, ring=LOT, kind="Polygon", coordinates=None):
    coordinates = [ring] if coordinates is None else coordinates
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


OTHER = feature(STANDS, FAR)


def read(path, **options):
    """The city, without its warning."""
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return from_geojson(path, metres=True, **options)


def spans(city):
    """Between which heights the pieces of the first building are."""
    return sorted({tuple(bounds) for bounds in city.solids.bounds[city.building == 0, :, 2]})


HEIGHTS = [
    ({"height": "12 m"}, 12, "unit"),
    ({"height": "12m"}, 12, "unit"),
    ({"height": "40 ft"}, 12.192, "unit"),
    ({"height": "40'"}, 12.192, "unit"),
    ({"height": "7'4\""}, 2.2352, "unit"),
    ({"height": "12,5"}, 12.5, "unit"),
    ({"height": "12;14"}, 14, "list"),
    ({"height": "40 ft; 3 m"}, 12.192, "list"),
    ({"height": [3, 9]}, 9, "list"),
    ({"building:levels": "4"}, 12, "levels"),
    ({"building:levels": 2.5}, 7.5, "levels"),
    ({"building:levels": "4", "roof:levels": "1"}, 15, "levels"),
    ({"building:levels": "4", "roof:levels": "1", "roof:height": "2.5"}, 14.5, "levels"),
    ({}, 10, "guessed"),
    (None, 10, "guessed"),
    ({"height": "tall"}, 10, "unreadable"),
    ({"height": "tall", "building:levels": "2"}, 6, "unreadable"),
    ({"height": "12 parsecs"}, 10, "unreadable"),
    ({"height": "a;b"}, 10, "unreadable"),
    ({"height": 0}, 10, "unreadable"),
    ({"height": -3}, 10, "unreadable"),
    ({"height": 5000}, 10, "unreadable"),
    ({"building:levels": "1000"}, 10, "unreadable"),
    ({"height": 12, "min_height": "high"}, 12, "underside"),
    ({"height": 12, "min_height": 12}, 12, "underside"),
    ({"height": 12, "min_height": -2}, 12, "underside"),
    ({"height": [[[3]]]}, 10, "unreadable"),
    ({"height": "9" * 5000 + "'1\""}, 10, "unreadable"),
    ({"min_height": 1995}, 10, "underside"),
    ({"min_height": "9" * 400 + " m"}, 10, "underside"),
    ({"building:min_level": "1e9"}, 10, "underside"),
]


@pytest.mark.parametrize(("properties", "height", "kind"), HEIGHTS)
def test_heights_of_all_kinds(geojson, properties, height, kind):
    path = geojson(feature(properties), OTHER)
    city = read(path)
    assert city.heights == pytest.approx([height, 8])
    assert spans(city)[0][0] == 0
    assert city.roof([-30.0, 0.0]) == pytest.approx(height)
    assert city.report.counts[kind] == 1
    assert city.report.first(kind) == ["feature 0 (from 0)"]
    assert {note.where for note in city.report.notes} == {"feature 0 (from 0)"}
    with pytest.raises(ValueError, match=r"town.geojson, feature 0 \(from 0\): its "):
        read(path, strict=True)


def test_lengths_that_are_none():
    for value in (None, True, "", ";", [], "1.2.3", {}, "3 m high", math.nan, "nan"):
        assert math.isnan(read_length(value)[0]), value
        assert read_length(value)[1] == "unreadable"
    assert read_length("12.5") == (12.5, "")
    assert read_length(7) == (7, "")


def test_a_default_height_of_ones_own_is_no_guess(geojson):
    path = geojson(feature({}), feature({"building:levels": "3"}, FAR))
    city = read(path, default_height=4.0)
    assert city.heights.tolist() == [4, 9]
    assert city.report.counts == {"levels": 1, "default": 1}
    # Strict readers take a default that is given, and no levels
    assert read(path, default_height=4.0, strict=True).heights.tolist() == [4, 4]
    for height in (0, -1, math.nan, 3000, "4"):
        with pytest.raises(ValueError, match="default_height is"):
            read(path, default_height=height)


SKIPPED = [
    (feature(STANDS, kind="Point", coordinates=[1, 2]), "it is a Point"),
    (feature(STANDS, kind="LineString", coordinates=LOT), "it is a LineString"),
    (feature(STANDS, coordinates=[]), "it is an empty Polygon"),
    (feature(STANDS, kind="MultiPolygon", coordinates=[]), "it is an empty MultiPolygon"),
    (feature(STANDS, LOT[:-1]), "its geometry cannot be read"),
    (feature(STANDS, [[0, 0], [5, 0], [9, 0], [0, 0]]), "not a valid polygon|no area"),
    (feature(STANDS, [[0, 0], [0.005, 0], [0, 0.005], [0, 0]]), None),
    ({**OTHER, "geometry": None}, "its geometry cannot be read"),
    (None, "its geometry cannot be read"),
]


@pytest.mark.parametrize(("odd", "message"), SKIPPED)
def test_features_without_a_footprint_are_left_out(geojson, odd, message):
    path = geojson(OTHER, odd, feature(STANDS))
    city = read(path)
    assert city.heights.tolist() == [8, 8]
    assert city.report.first("skipped") == ["feature 1 (from 0)"]
    with pytest.raises(
        ValueError, match=rf"feature 1 \(from 0\): .*({message or 'it has no area'})"
    ):
        read(path, strict=True)


def test_a_file_of_nothing_but_points_tells_why_it_is_empty(geojson):
    with pytest.raises(
        ValueError, match=r"contains no buildings: 1 without a usable shape.*\(feature 0"
    ):
        from_geojson(geojson(feature({}, kind="Point", coordinates=[1, 2])))


def test_a_ring_that_crosses_itself_is_two_triangles(geojson):
    city = read(geojson(feature({"height": 5}, BOW_TIE), OTHER))
    assert city.report.counts == {"repaired": 1}
    pieces = [shapely.Polygon(city.footprints[k]) for k in np.flatnonzero(city.building == 0)]
    assert [piece.area for piece in pieces] == pytest.approx([25, 25])
    # Its middle is in neither of them for more than a point
    middle = np.array([-35.0, 0.0])
    assert city.roof(middle + [[-3, 0], [3, 0], [0, 3], [0, -3]]).tolist() == [5, 5, 0, 0]


def test_wings_of_a_multipolygon_are_one_building(geojson):
    wings = feature({"height": 6}, kind="MultiPolygon", coordinates=[[LOT], [FAR]])
    city = from_geojson(geojson(wings), metres=True)
    assert city.building.tolist() == [0, 0]
    assert city.report.notes == ()


UNDERSIDES = [
    ({"height": 16, "min_height": 4}, (4, 16)),
    ({"height": 16, "min_height": "4 m"}, (4, 16)),
    ({"height": 16, "building:min_level": "2"}, (6, 16)),
    ({"building:levels": "5", "building:min_level": 2}, (6, 15)),
    ({"min_height": 4}, (4, 14)),
]


@pytest.mark.parametrize(("properties", "span"), UNDERSIDES)
def test_parts_in_the_air(geojson, properties, span):
    city = read(geojson(feature(properties), OTHER))
    assert spans(city) == [span]
    assert city.report.counts["above"] == 1
    assert city.heights[0] == span[1]
    # Built up is what stands on the ground, but nothing starts or walks below
    assert city.coverage == pytest.approx(200 / 80**2)
    assert not city.outdoors([-30.0, 0.0])


def test_rays_pass_below_a_part_in_the_air(geojson):
    city = read(geojson(feature({"height": 16, "min_height": 4}), OTHER))
    engine = Engine([load_airframe("cf2x")], 1, 1 / 240, layouts=[city.solids])
    engine.set_layouts(np.zeros(1, dtype=np.int64), np.ones(1, dtype=bool))
    # The part is over x from -40 to -20 m; from its west to its east at five heights
    height = np.array([1.0, 3.9, 4.1, 15.9, 16.1])
    start = np.stack([np.full(5, -45.0), np.zeros(5), height], axis=1)
    free = engine.cast_rays(start, start + [40, 0, 0], np.zeros(5, dtype=np.int64))
    engine.close()
    assert free == pytest.approx([1, 1, 5 / 40, 5 / 40, 1], abs=1e-4)


def tower(**properties):
    """A lot with two halves of its own."""
    return (
        feature({"building": "yes", "height": 40}),
        feature({"building:part": "yes", "height": 5}, WEST_HALF),
        feature({"building:part": "yes", **properties}, EAST_HALF),
    )


def test_parts_count_in_place_of_their_outline(geojson):
    path = geojson(*tower(height=30, min_height=10), OTHER)
    city = from_geojson(path, metres=True)
    assert len(city.heights) == 2  # the parts are one building
    assert city.heights.tolist() == [30, 8]
    assert spans(city) == [(0, 5), (10, 30)]
    assert city.roof([[-35.0, 0], [-25, 0]]).tolist() == [5, 30]
    assert city.report.counts == {"outline": 1, "above": 1}
    assert "cover 100% of it" in city.report.notes[0].what
    # That is what such files mean, so that nothing has to be refused
    assert from_geojson(path, metres=True, strict=True).heights.tolist() == [30, 8]


def test_parts_that_leave_a_hole_are_warned_of(geojson):
    path = geojson(*tower(height=30)[:2], OTHER)
    with pytest.warns(MendedWarning, match=r"1 outlines replaced by parts .*\(feature 0"):
        city = from_geojson(path, metres=True)
    assert spans(city) == [(0, 5)]
    assert city.roof([-25.0, 0.0]) == 0
    with pytest.raises(ValueError, match=r"feature 0 \(from 0\): its 1 parts cover 50% of it"):
        from_geojson(path, metres=True, strict=True)


def test_a_part_without_an_outline_is_a_building(geojson):
    city = from_geojson(geojson(tower()[1], OTHER), metres=True)
    assert city.heights.tolist() == [5, 8]
    whole = feature({"building:part": "no", "height": 9})
    assert read(geojson(whole, tower()[1], OTHER)).heights.tolist() == [5, 8]


def test_the_library_warns_once_and_only_where_something_was_mended(geojson):
    odd = [feature({"height": "tall"}), feature({}, FAR)]
    with pytest.warns(MendedWarning) as told:
        city = from_geojson(geojson(*odd), metres=True)
    assert len(told) == 1
    text = str(told[0].message)
    assert text.count("\n") == 0
    assert "1 invalid heights, ignored (feature 0 (from 0))" in text
    assert "2 missing heights, estimated (feature 0 (from 0), ...)" in text
    assert told[0].filename == __file__
    assert list(city.report.counts) == [kind for kind in KINDS if kind in city.report.counts]
    exact = from_geojson(geojson(feature({"height": "12 m"}), OTHER), metres=True)
    assert exact.report.counts == {"unit": 1}
    assert exact.report.summary() == ""


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(2.0, 30.0), min_size=5, max_size=24), st.booleans(), st.floats(-500, 500))
def test_pieces_are_convex_and_cover_the_polygon(radii, courtyard, away):
    turn = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    corners = np.array(radii)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1) + away
    hole = 0.3 * corners[::-1] + 0.7 * away
    polygon = shapely.Polygon(corners, [hole] if courtyard else [])
    pieces = list(convex_pieces(polygon))
    assert all(turns_left(piece) for piece in pieces)
    assert sum(map(area_of, pieces)) == pytest.approx(polygon.area, rel=1e-9)
    whole = shapely.union_all([shapely.Polygon(piece) for piece in pieces])
    assert whole.symmetric_difference(polygon).area < 1e-6 * polygon.area
    # At most four times the fewest, of which there are no more than reflex corners and one
    reflex = 2 * len(radii)
    assert len(pieces) <= 4 * (reflex + 1)


def test_few_pieces_are_made_of_usual_shapes():
    comb = [(0, 0), (70, 0)]
    for x in range(60, -1, -20):
        comb += [(x + 10, 10), (x + 10, 30), (x, 30), (x, 10)]
    shapes = {
        "square with a corner on a side": ([(0, 0), (5, 0), (10, 0), (10, 9), (0, 9)], 1),
        "L": ([(0, 0), (9, 0), (9, 4), (4, 4), (4, 9), (0, 9)], 2),
        "T": ([(0, 6), (0, 9), (9, 9), (9, 6), (6, 6), (6, 0), (3, 0), (3, 6)], 2),
        "plus": (
            [(3, 0), (6, 0), (6, 3), (9, 3), (9, 6), (6, 6), (6, 9), (3, 9), (3, 6), (0, 6), (0, 3)]
            + [(3, 3)],
            3,
        ),
        "comb": (comb, 5),
    }
    for name, (corners, most) in shapes.items():
        pieces = list(convex_pieces(shapely.Polygon(corners)))
        assert len(pieces) <= 2 * most - 1, name
        assert sum(map(area_of, pieces)) == pytest.approx(shapely.Polygon(corners).area), name


def test_a_round_house_of_many_corners_is_cut_into_faces_that_can_be():
    turn = np.linspace(0, 2 * np.pi, 600, endpoint=False)
    polygon = shapely.Polygon(20 * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    pieces = list(convex_pieces(polygon))
    assert [len(piece) for piece in pieces] == [256, 256, 92]
    assert sum(map(area_of, pieces)) == pytest.approx(polygon.area, rel=1e-12)
    assert shapely.union_all([shapely.Polygon(piece) for piece in pieces]).area == pytest.approx(
        polygon.area
    )


def test_a_prism_has_its_outline_at_both_heights():
    corners = extruded(np.array([[0.0, 0], [4, 0], [0, 3]]), 2.0, 7.0)
    assert corners.tolist() == [[0, 0, 2], [4, 0, 2], [0, 3, 2], [0, 0, 7], [4, 0, 7], [0, 3, 7]]
