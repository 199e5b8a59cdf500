import math
import sys

import numpy as np
import pytest
import shapely
from matplotlib.collections import PolyCollection

from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_geojson, from_obj
from bulletuav.city.maps import draw_map
from bulletuav.report.pictures import blank_figure

SQUARE = [[0, 0], [20, 0], [20, 10], [0, 10], [0, 0]]
BENT = [[40, 0], [70, 0], [70, 10], [52, 10], [50, 40], [40, 40], [40, 0]]
YARD = [
    [[0, 30], [30, 30], [30, 60], [0, 60], [0, 30]],
    [[10, 40], [20, 40], [20, 50], [10, 50], [10, 40]],
]


def feature(*rings, height: object = 12, kind="Polygon"):
    return {
        "type": "Feature",
        "properties": {"height": height},
        "geometry": {"type": kind, "coordinates": rings},
    }


def sorted_rows(points):
    return points[np.lexsort(points.T)]


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_obj_round_trip(tmp_path, irregularity):
    made = generate("urban", 300.0, np.random.default_rng(5), irregularity)
    path = tmp_path / "city.obj"
    write_obj(made, path)
    read = from_obj(path, side=300.0)
    assert np.array_equal(read.solids.boxes, made.solids.boxes)
    assert np.array_equal(read.building, made.building)
    assert read.coverage == made.coverage
    assert read.solids.hulls == ()
    assert read.outdoors(read.streets.nodes).all()
    centred = from_obj(path)
    assert centred.side < 300
    assert abs(np.abs(centred.solids.boxes[..., :2]).max() - centred.side / 2) < 1e-9


def test_obj_of_hulls_round_trip(tmp_path, geojson):
    made = from_geojson(geojson(feature(SQUARE), feature(BENT, height=30)), metres=True)
    write_obj(made, tmp_path / "again.obj")
    read = from_obj(tmp_path / "again.obj", side=made.side)
    assert np.array_equal(read.solids.boxes, made.solids.boxes)
    assert np.array_equal(read.building, made.building)
    for one, two in zip(read.solids.hulls, made.solids.hulls, strict=True):
        assert np.array_equal(sorted_rows(one), sorted_rows(two))


def test_obj_by_others(obj):
    wedge = "v 0 0 0\nv 40 0 0\nv 0 0 -40\nv 0 20 0\nf 1 2 3 \nf -1/1/1 2//3 1\nf 3 4 1\n"
    unused = "v 900 900 900\n"
    box = (
        "".join(f"v {x} {y} {z}\n" for x in (100, 120) for y in (0, 30) for z in (0, 10))
        + "f 6 7 8 9\nf 10 11 12 13\n"
    )
    text = f"# by hand\nmtllib no.mtl\ng wedge # a ramp\n{wedge}{unused}g shop\n{box}"
    with pytest.warns(MendedWarning, match="2 meshes that are not closed, replaced"):
        made = from_obj(obj(text), scale=0.5, y_up=True)
    assert made.name == "town"
    assert made.side == 60
    assert len(made.solids.boxes) == len(made.solids.hulls) == 1
    np.testing.assert_allclose(made.solids.boxes[0, 1] - made.solids.boxes[0, 0], [10, 5, 15])
    assert made.building.tolist() == [1, 0]  # boxes come first
    assert made.heights.tolist() == [10, 15]
    south_west = np.array([-30.0, -7.5])  # the corner of the wedge under its top
    assert made.roof(south_west + 1e-6) == pytest.approx(10, abs=1e-5)
    assert made.roof(south_west + [10, 1e-6]) == pytest.approx(5, abs=1e-5)
    assert made.outdoors(south_west + [15, 15])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\n", "contains no buildings"),
        ("v 0 0\n", "line 1 cannot be read: not enough values"),
        ("v 0 0 high\n", "line 1 cannot be read: could not convert"),
        ("v 0 0 inf\n", "line 1 cannot be read: a coordinate is inf"),
        ("v 0 0 0\nf 1 2 3\n", "line 2 cannot be read: there is no vertex 2 among the 1"),
        ("v 0 0 0\nf 0 0 0\n", "line 2 cannot be read: there is no vertex 0"),
        ("o plate\nv 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nf 1 2 3 4\n", "skipped .object plate"),
        ("o dot\nv 0 0 0\nf 1 1 1\n", "contains no buildings: 1 .* skipped .object dot"),
    ],
)
def test_obj_that_cannot_be_read(obj, text, message):
    with pytest.raises(ValueError, match=message):
        from_obj(obj(text))


def test_obj_that_does_not_fit(tmp_path):
    write_obj(generate("urban", 300.0, np.random.default_rng(0)), tmp_path / "city.obj")
    with pytest.raises(ValueError, match=r"does not fit into a side of 250 m"):
        from_obj(tmp_path / "city.obj", side=250)


def test_a_city_without_free_ground(geojson):
    block = geojson(feature([[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]))
    with pytest.raises(ValueError, match="no space for streets .* 10 m: set side to 42 m or more"):
        from_geojson(block, metres=True)
    assert len(from_geojson(block, metres=True, side=42.0).streets.edges) > 0


def test_footprints_in_metres(geojson):
    made = from_geojson(
        geojson(feature(SQUARE), feature(BENT, height=30), feature(*YARD, height="9")), metres=True
    )
    assert made.side == 70
    assert made.heights.tolist() == [12, 30, 9]
    assert made.solids.boxes[0].tolist() == [[-35, -30, 0], [-15, -20, 12]]
    for building, polygon in enumerate(
        (shapely.Polygon(SQUARE), shapely.Polygon(BENT), shapely.Polygon(YARD[0], YARD[1:]))
    ):
        pieces = [
            shapely.Polygon(made.footprints[piece])
            for piece in np.flatnonzero(made.building == building)
        ]
        moved = shapely.transform(polygon, lambda points: points - [35, 30])
        assert sum(piece.area for piece in pieces) == pytest.approx(polygon.area, rel=1e-9)
        assert shapely.union_all(pieces).symmetric_difference(moved).area < 1e-9
    assert np.bincount(made.building).tolist() == [1, 2, 4]  # convex pieces, few of them
    assert made.outdoors([[-20.0, 15]], 4.9).all()  # in the yard
    assert made.roof([[-34.0, 15], [8, 5]]).tolist() == pytest.approx([9, 30])
    assert made.coverage == pytest.approx((200 + shapely.Polygon(BENT).area + 800) / 4900)


def cosine(times):
    """Cosine of a multiple of a latitude."""
    return math.cos(math.radians(times * (48 + 50 / 111200)))


def test_footprints_in_degrees(geojson):
    # Degrees in a metre, by series of the lengths of degrees on the ellipsoid of WGS-84
    turn = 1 / (111132.92 - 559.82 * cosine(2) + 1.175 * cosine(4) - 0.0023 * cosine(6))
    wide = 1 / (111412.84 * cosine(1) - 93.5 * cosine(3) + 0.118 * cosine(5))

    def ring(x, y):
        return [[11 + wide * (x + dx), 48 + turn * (y + dy), 500.0] for dx, dy in SQUARE]

    parts = feature([ring(0, 0)], [ring(60, 90)], kind="MultiPolygon", height=None)
    made = from_geojson(geojson(parts), default_height=7.0)
    assert made.side == pytest.approx(100)
    assert made.building.tolist() == [0, 0]
    expected = [[[-40, -50, 0], [-20, -40, 7]], [[20, 40, 0], [40, 50, 7]]]
    np.testing.assert_allclose(made.solids.boxes, expected, atol=2e-5)
    wider = from_geojson(geojson(parts), side=300.0, default_height=7.0)
    assert wider.side == 300
    np.testing.assert_allclose(wider.solids.boxes, expected, atol=2e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"properties": None}, r"feature 1 \(from 0\): its height is None: .* default height"),
        ({"properties": {"height": "tall"}}, r"feature 1 \(from 0\): its height is 'tall'"),
        ({"properties": {"height": -3}}, r"feature 1 \(from 0\): its height is -3"),
        ({"properties": {"height": [3]}}, r"feature 1 \(from 0\): its height is \[3\]"),
        (
            {"geometry": {"type": "Point", "coordinates": [1, 2]}},
            r"feature 1 \(from 0\): it is a Point",
        ),
        ({"geometry": None}, r"feature 1 \(from 0\): its geometry cannot be read"),
        (
            {"geometry": {"type": "Polygon", "coordinates": [[1]]}},
            r"feature 1 \(from 0\): its geometry cannot be read",
        ),
        (
            {
                "geometry": {
                    "type": "Polygon",
                    "coordinates": [[[0, 0], [5, 5], [5, 0], [0, 5], [0, 0]]],
                }
            },
            r"feature 1 \(from 0\): it is not a valid polygon: Self-intersection",
        ),
    ],
)
def test_features_that_cannot_be(geojson, change, message):
    with pytest.raises(ValueError, match=message):
        from_geojson(
            geojson(feature(SQUARE), {**feature(BENT), **change}), metres=True, strict=True
        )


def test_a_bad_height_is_not_replaced(geojson):
    with pytest.raises(ValueError, match="its height is 0"):
        from_geojson(geojson(feature(SQUARE, height=0)), metres=True, default_height=5, strict=True)


def test_files_that_are_no_footprints(tmp_path, geojson):
    path = tmp_path / "no.geojson"
    for text, message in (
        ("{", "is not valid GeoJSON"),
        ("[]", "not a FeatureCollection"),
        ('{"features": 3}', "not a FeatureCollection"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            from_geojson(path)
    with pytest.raises(ValueError, match="contains no buildings"):
        from_geojson(geojson())
    with pytest.raises(ValueError, match="not degrees: are they metres"):
        from_geojson(geojson(feature([[0, 0], [200, 0], [200, 10], [0, 10], [0, 0]])))


def test_geojson_without_the_extra(geojson, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(ImportError, match=r"\[city\]'"):
        from_geojson(geojson(feature(SQUARE)))


def test_a_map_shows_every_piece_in_the_colour_of_its_height(tmp_path):
    made = generate("urban", 300.0, np.random.default_rng(5), 1.0)
    figure = blank_figure(5, 5)
    axes = figure.add_subplot()
    draw_map(made, axes)
    figure.savefig(tmp_path / "map.png")
    prints = next(one for one in axes.collections if isinstance(one, PolyCollection))
    assert len(prints.get_paths()) == len(made.building)
    assert np.array_equal(prints.get_array(), made.heights[made.building])
    assert "50 m" in [text.get_text() for text in axes.texts]
