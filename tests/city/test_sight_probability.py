import numpy as np
import pytest

from bulletuav.city.generator import generate
from bulletuav.city.sight_probability import SIGMOIDS, elevation_los, fitted_sigmoid, p1410_los
from bulletuav.city.statistics import KINDS

USER = 1.5  # m
P1410 = {
    (100, 50): (1.0, 0.770871, 0.563439, 0.124196),
    (200, 100): (1.0, 0.780563, 0.573454, 0.086636),
    (500, 100): (0.774735, 0.144794, 0.0563555, 0.000200523),
    (500, 200): (0.995524, 0.513323, 0.321488, 0.0179852),
}
ELEVATION = {
    5: (0.177476, 0.047408, 0.036602, 0.006165),
    15: (0.940836, 0.197752, 0.102445, 0.013617),
    30: (0.999901, 0.730979, 0.372770, 0.043826),
    45: (1.000000, 0.967692, 0.755774, 0.132077),
    60: (1.000000, 0.996980, 0.941566, 0.335655),
    90: (1.000000, 0.999975, 0.997716, 0.847778),
}
FITTED = {
    "suburban": (4.87998, 0.42902),
    "urban": (9.61172, 0.15806),
    "dense": (12.08098, 0.11395),
    "high_rise": (27.23038, 0.07975),
}
RAYS = {  # exact rays over an endless grid
    (100, 50): (0.789, 0.400, 0.213, 0.084),
    (200, 100): (0.785, 0.397, 0.219, 0.063),
    (500, 200): (0.748, 0.333, 0.167, 0.043),
}


def blocked(start, end, boxes):
    """(R,) whether segments (R, 3) go through any of the boxes (B, 2, 3)."""
    least, most = np.minimum(start, end)[:, :2], np.maximum(start, end)[:, :2]
    hit = np.zeros(len(start), dtype=bool)
    for low, high in boxes:
        rays = np.flatnonzero(((least < high[:2]) & (most > low[:2])).all(axis=1) & ~hit)
        way = end[rays] - start[rays]
        one, two = (low - start[rays]) / way, (high - start[rays]) / way
        enter, leave = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        hit[rays] = (enter < leave) & (leave > 0) & (enter < 1)
    return hit


@pytest.mark.parametrize("place", P1410)
def test_p1410(place):
    found = [p1410_los(statistics, *place) for statistics in KINDS.values()]
    assert found == pytest.approx(P1410[place], rel=6e-6)


def test_p1410_of_arrays():
    statistics = KINDS["urban"]
    assert p1410_los(statistics, 300, 120) == pytest.approx(0.6332220, rel=1e-6)
    assert 1 - p1410_los(KINDS["suburban"], 200, 100) == pytest.approx(1.8e-9, rel=0.02)
    heights = np.linspace(20, 300, 9)
    found = p1410_los(statistics, np.array([[50.0], [300], [800]]), heights)
    assert found.shape == (3, 9)
    assert found[1, 4] == p1410_los(statistics, 300, heights[4])
    assert (np.diff(found) >= 0).all()
    assert (np.diff(found, axis=0) <= 0).all()
    assert p1410_los(statistics, np.zeros(0), 100).shape == (0,)


@pytest.mark.parametrize("elevation", ELEVATION)
def test_sigmoid_of_elevation(elevation):
    found = [elevation_los(elevation, SIGMOIDS[kind]) for kind in KINDS]
    assert found == pytest.approx(ELEVATION[elevation], abs=6e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_fitted_sigmoids(kind):
    found = fitted_sigmoid(KINDS[kind])
    assert found == pytest.approx(FITTED[kind], abs=6e-6)
    assert found == pytest.approx(SIGMOIDS[kind], rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_rays_in_generated_cities(kind):
    rng = np.random.default_rng(7)
    clear = np.zeros((2, len(RAYS)))
    for found in clear:
        city = generate(kind, 2000.0, rng)
        users = np.column_stack([rng.uniform(-490, 490, (6000, 2)), np.full(6000, USER)])
        users = users[city.outdoors(users)][:2500]
        angle = rng.uniform(0, 2 * np.pi, len(users))
        towards = np.column_stack([np.cos(angle), np.sin(angle)])
        drones = [
            np.column_stack([users[:, :2] + distance * towards, np.full(len(users), height)])
            for distance, height in RAYS
        ]
        starts = np.tile(users, (len(RAYS), 1))
        hit = blocked(starts, np.concatenate(drones), city.solids.boxes)
        found[:] = 1 - hit.reshape(len(RAYS), -1).mean(axis=1)
    expected = [row[list(KINDS).index(kind)] for row in RAYS.values()]
    assert clear.mean(axis=0) == pytest.approx(expected, abs=0.03)
