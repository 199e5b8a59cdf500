"""Hills and forests: their ground, their trees, and their options."""

import math

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from bulletuav.city.exports import write_obj
from bulletuav.city.heightfield import Heightfield
from bulletuav.city.imports import from_obj
from bulletuav.city.model import GROUND
from bulletuav.city.terrain import (
    TERRAINS,
    Terrain,
    find_terrain,
    generate_terrain,
    measure_terrain,
)

STEEP = Terrain(relief=33.0, wavelength=100.0)


def terrain(kind="wooded_hills", side=200.0, seed=0):
    return generate_terrain(kind, side, np.random.default_rng(seed))


def top_of(hull, plan):
    """Height of the upper side of a hull at points (K, 2), -inf outside; plane by plane."""
    planes = ConvexHull(hull).equations
    up, walls = planes[planes[:, 2] > 1e-9], planes[np.abs(planes[:, 2]) <= 1e-9]
    height = -(plan @ up[:, :2].T + up[:, 3]) / up[:, 2]
    is_inside = (plan @ walls[:, :2].T + walls[:, 3] <= 1e-9).all(axis=1)
    return np.where(is_inside, height.min(axis=1), -np.inf)


def test_heights_are_interpolated_in_the_upper_triangles():
    """Barycentric coordinates by hand; the cell is 4 m x 2 m."""
    sides = np.array([4.0, 2.0])
    # Corners (low x, low y) 0, (low x, high y) 1, (high x, low y) 2, (high x, high y) 9
    ridge = Heightfield(np.array([[0.0, 1.0], [2.0, 9.0]]), sides)
    for place, expected in (
        ((-2, -1), 0.0),
        ((2, 1), 9.0),
        ((0, 0), 4.5),  # the middle of the diagonal from 0 to 9
        ((1, -0.5), 0.25 * 0 + 0.5 * 2 + 0.25 * 9),  # u = 3/4, v = 1/4
        ((-1, 0.5), 0.25 * 0 + 0.5 * 1 + 0.25 * 9),
    ):
        assert ridge.height(np.array(place, dtype=float)) == pytest.approx(expected)
    # With 2 instead of 9 the diagonal from 1 to 2 is the higher one
    other = Heightfield(np.array([[0.0, 1.0], [2.0, 2.0]]), sides)
    for place, expected in (
        ((0, 0), 1.5),
        ((-1, -0.5), 0.5 * 0 + 0.25 * 2 + 0.25 * 1),  # u = v = 1/4
        ((1, 0.5), 0.5 * 2 + 0.25 * 1 + 0.25 * 2),  # u = v = 3/4
    ):
        assert other.height(np.array(place, dtype=float)) == pytest.approx(expected)
    assert ridge.height(np.array([(2.1, 0.0), (0.0, -1.1)])) == pytest.approx(0)
    assert ridge.steepest == pytest.approx(math.hypot(8 / 4, 7 / 2))


@pytest.mark.parametrize("kind", [STEEP, "hills"])
def test_columns_end_at_the_surface(kind):
    """Also near seams; columns overlap by 1e-6 m."""
    city = terrain(kind, (200.0, 130.0), 3)
    rng = np.random.default_rng(0)
    plan = rng.uniform(-1, 1, (1500, 2)) * (99.9, 64.9)
    for axis in (0, 1):
        near, cell = slice(300 * axis, 300 * axis + 600), city.ground.cell[axis]
        half = city.sides[axis] / 2
        seam = np.round((plan[near, axis] + half) / cell) * cell - half
        plan[near, axis] = np.clip(seam + rng.normal(0, 0.4, 600), 0.1 - half, half - 0.1)
    tops = np.max([top_of(hull, plan) for hull in city.solids.hulls], axis=0)
    np.testing.assert_allclose(tops, city.surface(plan), atol=3e-6)
    np.testing.assert_array_equal(city.roof(plan), city.surface(plan))


def test_hills_have_their_relief_and_no_steep_slopes():
    for seed in range(20):
        for side in (100.0, 300.0):
            ground = terrain(STEEP, side, seed).ground
            assert ground.corners.min() == 0
            assert ground.corners.max() == pytest.approx(33)
            assert ground.steepest < 1


def test_wavelengths_are_between_one_and_two_times_the_shortest():
    """The spectrum of a large terrain is empty outside, but for the window's side lobes."""
    ground = terrain(Terrain(relief=10.0, wavelength=100.0), 1000.0).ground
    heights = ground.corners[:-1, :-1]
    window = np.hanning(len(heights))
    power = np.abs(np.fft.fft2((heights - heights.mean()) * window[:, None] * window)) ** 2
    number = np.fft.fftfreq(len(heights), ground.cell[0])
    length = 1 / np.maximum(np.hypot(number[:, None], number), 1e-9)
    assert power[(length > 80) & (length < 260)].sum() > 0.98 * power.sum()


@pytest.mark.parametrize("kind", TERRAINS)
def test_the_seed_decides(kind):
    one, same, other = (terrain(kind, seed=seed) for seed in (3, 3, 4))
    assert len(one.solids.hulls) == len(same.solids.hulls)
    assert all(map(np.array_equal, one.solids.hulls, same.solids.hulls))
    assert not all(map(np.array_equal, one.solids.hulls, other.solids.hulls))


@pytest.mark.parametrize("kind", ["forest", "wooded_hills"])
def test_trees_have_their_density_and_sizes(kind):
    numbers = {"tree_density": 150.0, "tree_height": 10.0, "trunk_radius": 0.3}
    city = terrain(find_terrain(kind, numbers), (200.0, 300.0))
    assert len(city.heights) == 150 * 6
    trunks, crowns = np.split(city.raised.bounds, 2)
    middle = trunks.mean(axis=1)
    foot = city.surface(middle)
    height = crowns[:, 1, 2] - foot
    assert ((height > 7.4) & (height < 12.6)).all()
    assert (np.abs(city.raised.bounds[..., :2]) <= (100, 150)).all()
    # Trunks reach from below the ground into the crowns
    assert (trunks[:, 0, 2] < foot - 1.2).all()
    np.testing.assert_allclose(trunks[:, 1, 2] - foot, height / 2, atol=0.01)
    np.testing.assert_allclose(crowns[:, 0, 2] - foot, 0.35 * height, atol=0.01)
    np.testing.assert_array_equal(city.building[city.building != GROUND], [*range(900)] * 2)
    # Radii at the corners, of hexagons and squares
    for pieces, corners, radius in ((0, slice(None), 0.3), (900, slice(4), None)):
        for k in range(0, 900, 90):
            hull = city.raised.hulls[pieces + k][corners]
            away = np.linalg.norm(hull[:, :2] - middle[k, :2], axis=1)
            np.testing.assert_allclose(away, radius or 0.2 * height[k], atol=0.06)


def test_trees_are_uniformly_distributed():
    """Of 2,000 trees a quarter is in each quadrant, within five standard deviations."""
    city = terrain(Terrain(tree_density=500.0))
    place = city.raised.bounds.mean(axis=1)[:2000, :2]
    counts = np.histogram2d(*place.T, bins=2, range=[(-100, 100)] * 2)[0]
    assert np.abs(counts - 500).max() < 5 * math.sqrt(2000 * 3 / 16)
    # Nearest neighbours of a Poisson process are 1 / (2 sqrt(density)) apart on average
    apart = cdist(place, place) + 1e9 * np.eye(2000)
    assert apart.min(axis=1).mean() == pytest.approx(0.5 / math.sqrt(0.05), rel=0.1)


def test_pieces_are_closed_and_crowns_have_the_volume_of_two_pyramids():
    city = terrain()
    for corners, triangles in city.solids.faces:
        edges = np.concatenate([triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
        assert {tuple(edge) for edge in edges.tolist()} == {
            tuple(edge) for edge in edges[:, ::-1].tolist()
        }
        a, b, c = (corners[triangles[:, k]] for k in range(3))
        assert (np.cross(a, b) * c).sum() > 0
    crown = city.raised.hulls[-1]
    height = np.ptp(crown[:, 2])
    radius = np.linalg.norm(crown[0, :2] - crown[-1, :2])
    assert ConvexHull(crown).volume == pytest.approx(2 * radius**2 * height / 3, rel=1e-3)


def test_crowns_leave_headroom():
    city = terrain("forest")
    crown = city.raised.bounds[-1].mean(axis=0)
    trunk_to_the_side = crown[:2] + (0.8, 0)
    assert not city.outdoors(trunk_to_the_side)
    assert city.outdoors(trunk_to_the_side, headroom=2.0)
    assert not city.outdoors(crown[:2], headroom=2.0)
    assert city.surface(crown) == 0
    assert city.roof(crown) == pytest.approx(city.heights[-1])
    # 800 hexagons of radius 0.2 m
    assert city.coverage == pytest.approx(800 * 1.5 * math.sqrt(3) * 0.04 / 200**2, rel=0.02)


def test_measures():
    found = measure_terrain(terrain(Terrain(20.0, 100.0, 100.0, 12.0)))
    assert found["relief, m"] == pytest.approx(20)
    assert 10 < found["steepest slope, degrees"] < 45
    assert found["trees per hectare"] == 100
    assert found["mean height of trees, m"] == pytest.approx(12, rel=0.15)
    flat = measure_terrain(terrain("forest"))
    assert flat["relief, m"] == flat["steepest slope, degrees"] == 0
    assert "mean height of trees, m" not in measure_terrain(terrain("hills"))


def test_an_obj_file_has_all_pieces(tmp_path):
    city = terrain("wooded_hills", 100.0)
    write_obj(city, tmp_path / "wood.obj")
    text = (tmp_path / "wood.obj").read_text()
    assert text.count("\no ground_piece_") == len(city.solids.hulls) - 200
    assert text.count("\no building_") == 200
    with pytest.raises(ValueError, match="no space for streets"):
        from_obj(tmp_path / "wood.obj", elevation="keep")


def test_a_forest_is_read_again(tmp_path):
    city = terrain("forest", 100.0)
    write_obj(city, tmp_path / "wood.obj")
    read = from_obj(tmp_path / "wood.obj", side=100.0, elevation="keep")
    assert len(read.solids.bounds) == len(city.solids.bounds)
    plan = np.random.default_rng(0).uniform(-45, 45, (200, 2))
    np.testing.assert_allclose(read.roof(plan), city.roof(plan), atol=1e-5)


REFUSED = [
    ({"relief": -1.0}, "relief is -1: it must not be below 0"),
    ({"relief": 34.0}, "relief is 34 m: at most 33.33 m, a third of wavelength"),
    ({"relief": float("nan")}, "relief is nan"),
    ({"wavelength": 0.0}, "wavelength is 0 m: it must be above 0"),
    ({"tree_density": -1}, "tree_density is -1"),
    ({"tree_height": 0.5}, "tree_height is 0.5 m: from 1 to 100 m"),
    ({"tree_height": "tall"}, "tree_height is 'tall'"),
    ({"trunk_radius": 0.0}, "trunk_radius is 0 m"),
    ({"trunk_radius": 2.0}, "trunk_radius is 2 m: less than 1.8 m"),
    ({"relieff": 2.0}, "unknown option of terrain 'wooded_hills': 'relieff': .*'relief'"),
    ({"relief": 0.0, "wavelength": 50.0}, "wavelength has no effect .* relief 0"),
    ({"tree_density": 0, "tree_height": 9.0}, "tree_height has no effect .* tree_density 0"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_terrain_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        find_terrain("wooded_hills", options)


@pytest.mark.parametrize(
    ("kind", "side", "message"),
    [
        ("hill", 100.0, "unknown kind of terrain 'hill': did you mean 'hills'"),
        ("hills", 80.0, "wavelength is 100 m: at most the side of the ground, 80 m"),
        ("hills", 1100.0, "wavelength is 100 m: at least 103.125 m .* raise wavelength"),
        ("hills", (100.0, "x"), "side is 'x'"),
        ("forest", 1500.0, "makes 45000 trees on 1500 m x 1500 m: from 1 to 20000"),
        (Terrain(tree_density=0.1), 100.0, "makes 0 trees"),
        (Terrain(tree_density=1e4, tree_height=50.0), 20.0, "crowns are wider than the ground"),
    ],
)
def test_terrain_that_does_not_fit(kind, side, message):
    with pytest.raises(ValueError, match=message):
        terrain(kind, side)
    with pytest.raises(ValueError, match="rng is 0: a generator"):
        generate_terrain("hills", 100.0, 0)
