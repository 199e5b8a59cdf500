"""Rays through boxes by the walk, beside the engine's and by hand."""

import numpy as np
import pytest

from bulletuav.city.generator import generate
from bulletuav.engine.calls import VISIBLE
from bulletuav.engine.engine import Engine
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.raycast import walk
from bulletuav.geometry.solids import Solids, box_corners
from bulletuav.vehicle.airframe import load_airframe

TOWER = np.array([[(20.0, -5.0, 0.0), (40.0, 5.0, 60.0)]])


@pytest.fixture
def make_world():
    made = []

    def make(solids, obstacles=()):
        made.append(Engine([load_airframe("cf2x")], 1, 1 / 240, obstacles, [solids]))
        made[-1].set_layouts(np.zeros(1, dtype=int), np.ones(1, dtype=bool))
        return made[-1]

    yield make
    for engine in made:
        engine.close()


def cast(engine, start, end):
    start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
    return engine.cast_rays(start, end, np.zeros(len(start), dtype=int))


def test_a_tower_by_hand(make_world):
    engine = make_world(Solids(TOWER))
    ends = [(60, 0, 30), (-60, 0, 30), (60, 0, 90), (0, 0, -30), (30, 0, 90)]
    # To the wall at x = 20; away; to the wall where z = 50; to the ground half way; and over the
    # roof, as z = 70 at the wall.
    np.testing.assert_allclose(
        cast(engine, [(0, 0, 30)] * 5, ends), (20 / 60, 1, 20 / 60, 0.5, 1), atol=1e-12
    )


def test_a_ray_that_starts_inside_meets_the_wall_from_within(make_world):
    engine = make_world(Solids(TOWER))
    np.testing.assert_allclose(
        cast(engine, [(30, 0, 30)] * 2, [(30, 20, 30), (30, 3, 30)]), (0.25, 1.0), atol=1e-12
    )


@pytest.mark.parametrize("irregularity", [0.0, 1.0])
def test_the_engine_gives_the_same(make_world, irregularity):
    rng = np.random.default_rng(7)
    engine = make_world(generate("urban", 300.0, rng, irregularity).solids)
    start = rng.uniform((-200, -200, -2), (200, 200, 60), (20000, 3))
    way = rng.normal(size=start.shape)
    way[:5000, 2] = way[5000:6000, 0] = way[6000:7000, 1] = 0  # level, and along the axes
    way *= rng.uniform(1, 300, (len(start), 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    walked = cast(engine, start, start + way)
    reference = engine._calls.rays(start, start + way, VISIBLE)
    apart = np.abs(walked - reference) * np.linalg.norm(way, axis=1)
    assert (walked < 1).mean() > 0.3
    # Those that differ graze an edge, where the engine's triangles are wider.
    assert (apart > 1e-6).mean() < 2e-4
    beside = np.cross(way, rng.normal(size=way.shape))
    beside *= 0.05 / np.linalg.norm(beside, axis=1, keepdims=True)
    # A hand's breadth aside both tell the same, on one side at least.
    for k in np.flatnonzero(apart > 1e-6):
        sides = start[k] + [beside[k], -beside[k]]
        gaps = cast(engine, sides, sides + way[k]) - engine._calls.rays(
            sides, sides + way[k], VISIBLE
        )
        assert np.abs(gaps).min() < 1e-9


def test_what_is_no_box_is_left_to_the_engine(make_world):
    ramp = np.array([(10.0, -5, 0), (20, -5, 0), (20, -5, 10), (10, 5, 0), (20, 5, 0), (20, 5, 10)])
    engine = make_world(Solids(TOWER, (ramp,)))
    # The ramp is 5 m high at x = 15.
    assert cast(engine, (0, 0, 5), (30, 0, 5))[0] == pytest.approx(0.5)
    _, left = walk(engine.city_grid, np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1, int), False)
    assert left.tolist() == [0]


def test_obstacles_are_left_to_the_engine(make_world):
    engine = make_world(Solids(TOWER), (Obstacle("sphere", (2.0,)),))
    engine.set_obstacles(
        np.array([[(10.0, 0.0, 30.0)]]), np.array([[(0, 0, 0, 1.0)]]), np.ones(1, bool)
    )
    assert cast(engine, (0, 0, 30), (16, 0, 30))[0] == pytest.approx(0.5)


def test_corners_of_boxes_are_those_of_the_mesh():
    corners = box_corners(TOWER[0])
    assert sorted(map(tuple, corners)) == sorted(
        (x, y, z) for x in (20, 40) for y in (-5, 5) for z in (0, 60)
    )
