"""A town of 250 lots with all that real files have; see tests/city/data/README.md."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely

import bulletuav
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_geojson
from bulletuav.earth import degree_lengths

FILE = Path(__file__).parent / "data" / "synthetic_town.geojson"


@pytest.fixture(scope="module")
def town():
    with warnings.catch_warnings(action="ignore", category=MendedWarning):
        return from_geojson(FILE)


def polygons():
    """The polygons of the file in m, repaired, by shapely alone; outlines with parts left out."""
    content = json.loads(FILE.read_text())["features"]
    shapes = [shapely.from_geojson(json.dumps(one["geometry"])) for one in content]
    is_part = ["building:part" in one["properties"] for one in content]
    solid = [
        (shapely.make_valid(shape), part)
        for shape, part in zip(shapes, is_part, strict=True)
        if shape.area > 0 or not shape.is_valid
    ]
    west, south, east, north = shapely.total_bounds([shape for shape, _ in solid])
    middle = np.array([west + east, south + north]) / 2
    metres = np.array(degree_lengths(middle[1]))
    moved = [
        (shapely.transform(shape, lambda degrees: (degrees - middle) * metres), part)
        for shape, part in solid
    ]
    inside = shapely.union_all([shape.representative_point() for shape, part in moved if part])
    return [shape for shape, part in moved if part or not shape.intersects(inside)]


def test_every_oddity_is_there_and_told(town):
    assert town.report.counts == {
        "skipped": 6,
        "other": 6,  # entrances
        "repaired": 6,
        "unreadable": 10,
        "guessed": 10,
        "levels": 22,
        "list": 6,
        "unit": 17,
        "outline": 12,
        "above": 11,
    }
    assert len(town.heights) == 250 - 6  # six lots have an entrance and no building
    assert 200 < len(town.heights) < 400


def test_pieces_cover_what_shapely_says(town):
    area = sum(shape.area for shape in polygons())
    found = [shapely.Polygon(footprint) for footprint in town.footprints]
    assert sum(piece.area for piece in found) == pytest.approx(area, rel=1e-6)
    whole = shapely.union_all(polygons())
    assert shapely.union_all(found).symmetric_difference(whole).area < 1e-6 * area


def test_streets_are_outdoors(town):
    assert town.outdoors(town.streets.nodes, 0.5).all()
    assert len(town.streets.nodes) > 500


def test_drones_fly_there(town):
    env = bulletuav.batch_env(
        "navigation", 2, city=town, dynamics="single_integrator", num_drones=3
    )
    env.reset(seed=0)
    before = env.aviary.swarm.position.copy()
    assert town.outdoors(before).all()
    for _ in range(20):
        env.step(np.full((2, 3, 3), 0.2))
    assert np.isfinite(env.aviary.swarm.position).all()
    assert (np.linalg.norm(env.aviary.swarm.position - before, axis=-1) > 1).any()
    env.close()
