"""The centre of Helsinki, from OpenStreetMap, as the package `pyrosm` brings it.

Data: © OpenStreetMap contributors, Open Database Licence. None of them are in this repository.
"""

import warnings

import numpy as np
import pyrosm
import pytest
import shapely

import bulletuav
from bulletuav.city.import_report import MendedWarning
from bulletuav.city.imports import from_geojson

LEVEL = 3.0
"""Height of a level, m"""


@pytest.fixture(scope="module")
def buildings():
    """The buildings as a table of GeoPandas."""
    with warnings.catch_warnings(action="ignore"):
        return pyrosm.OSM(pyrosm.get_data("helsinki_pbf")).get_buildings()


@pytest.fixture(scope="module")
def district(buildings, tmp_path_factory):
    """The city that our reader makes of them."""
    path = tmp_path_factory.mktemp("osm") / "helsinki.geojson"
    path.write_text(buildings.to_json(drop_id=True))
    with pytest.warns(MendedWarning):
        return from_geojson(path)


def solid_ones(buildings):
    """Tell which features enclose ground."""
    return shapely.area(buildings.geometry.to_numpy()) > 0


def test_all_buildings_stand_and_oddities_are_told(buildings, district):
    solid = solid_ones(buildings)
    told = buildings["height"].notna() & solid
    by_levels = buildings["building:levels"].notna() & ~told & solid
    counts = district.report.counts
    assert len(district.heights) == solid.sum() > 400
    assert counts["skipped"] == (~solid).sum()
    assert counts["levels"] == by_levels.sum()
    assert counts["guessed"] == (solid & ~told & ~by_levels).sum()
    assert counts["repaired"] == (~buildings.geometry.is_valid).sum()


def test_heights_are_those_of_the_tags(buildings, district):
    solid = buildings[solid_ones(buildings)]
    levels = solid["building:levels"][solid["height"].isna()].astype(float)
    told = solid["height"].dropna().str.removesuffix(" m").astype(float)
    expected = np.sort([*told, *(LEVEL * levels.dropna())])
    found = np.sort(district.heights)
    assert set(np.round(expected, 6)) <= set(np.round(found, 6))
    assert found.max() == expected.max()


def test_pieces_cover_the_footprints_of_a_map_projection(buildings, district):
    """UTM of GeoPandas against our metres: scale differs by at most 0.04 % near its meridian."""
    grid = buildings[solid_ones(buildings)].to_crs(buildings.estimate_utm_crs())
    expected = grid.geometry.make_valid().area.sum()
    covered = sum(shapely.Polygon(corners).area for corners in district.footprints)
    assert covered == pytest.approx(expected, rel=2e-3)


def test_drones_fly_through_it(district):
    env = bulletuav.batch_env("navigation", 2, city=district, dynamics="point_mass", horizon=20)
    env.reset(seed=0)
    for _ in range(20):
        observations, *_ = env.step(np.zeros((2, env.num_drones, 3)))
        assert np.isfinite(observations).all()
    env.close()
