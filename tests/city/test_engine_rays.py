"""What the engine's rays promise in cities of other shapes than boxes; compiled rays are exact."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import bulletuav
from bulletuav.city.imports import from_obj

BEYOND = 1e-4
"""Share of a face's size by which Bullet lets it reach beyond its edges"""
MARGIN = 1e-3
"""Thickness that Bullet adds to hulls, m"""


def prisms(count, rng):
    """Corners (2 V, 3) of houses in a grid: turned boxes and hexagons, 15 to 36 m high."""
    for k in range(count):
        turn, (width, depth, top) = rng.uniform(0, np.pi), rng.uniform(5, 12, 3)
        sides = 6 if k % 2 else 4
        angle = turn + 2 * np.pi * (np.arange(sides) + 0.5) / sides
        plan = np.stack([width * np.cos(angle), depth * np.sin(angle)], axis=1)
        plan += [(k % 4) * 40 - 60.0, (k // 4) * 40 - 60.0]
        yield np.array([(x, y, z) for z in (0.0, 3 * top) for x, y in plan])


def blocked(houses, start, end, beyond):
    """Whether segments meet a house whose planes are moved out, cut plane by plane, (R,) bool."""
    meets = np.zeros(len(start), dtype=bool)
    for corners in houses:
        planes = ConvexHull(corners).equations
        a, b = (points @ planes[:, :3].T + planes[:, 3] - beyond for points in (start, end))
        share = a / np.where(a == b, np.inf, a - b)
        low = np.max(np.where(a > b, share, -np.inf), axis=1).clip(0)
        high = np.min(np.where(a < b, share, np.inf), axis=1).clip(max=1)
        parallel = np.any((a == b) & (a > 0), axis=1)
        meets |= (low < high) & ~parallel
    return meets


@pytest.fixture(scope="module")
def houses():
    return list(prisms(16, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def city(houses, tmp_path_factory):
    lines, first = [], 1
    for k, corners in enumerate(houses):
        lines += [f"o house{k}", *("v {:.17g} {:.17g} {:.17g}".format(*one) for one in corners)]
        hull = ConvexHull(corners)
        for face, plane in zip(hull.simplices, hull.equations, strict=True):
            a, b, c = corners[face]
            outward = np.dot(np.cross(b - a, c - a), plane[:3]) > 0
            lines.append("f {} {} {}".format(*((face if outward else face[::-1]) + first)))
        first += len(corners)
    path = tmp_path_factory.mktemp("city") / "houses.obj"
    path.write_text("\n".join(lines))
    return from_obj(path, side=220.0)


@pytest.mark.parametrize("rays", ["compiled", "bullet"])
def test_rays_near_roof_edges_are_as_wrong_as_promised(rays, houses, city):
    rng, start, end = np.random.default_rng(1), [], []
    for _ in range(4000):
        corners = houses[rng.integers(len(houses))]
        roof = corners[len(corners) // 2 :]
        k, along = rng.integers(len(roof)), rng.uniform(0.05, 0.95)
        edge = (1 - along) * roof[k] + along * roof[(k + 1) % len(roof)]
        near = edge + rng.uniform(-0.02, 0.02, 3)
        way = rng.normal(size=3) * (1, 1, 0.5)
        way /= np.linalg.norm(way)
        start.append(near - rng.uniform(1, 20) * way)
        end.append(near + rng.uniform(1, 20) * way)
    start, end = np.array(start), np.array(end)
    above = (start[:, 2] > 0.1) & (end[:, 2] > 0.1)
    start, end = start[above], end[above]
    aviary = bulletuav.Aviary(
        "navigation", city=city, rays=rays, num_drones=1, leg=50.0, dynamics="point_mass"
    )
    aviary.reset(seeds=0)
    meets = ~aviary.line_of_sight(start, end)
    aviary.close()
    size = max(np.linalg.norm(np.ptp(one, axis=0)) for one in houses)
    rounding = 1e-9
    assert not (blocked(houses, start, end, -rounding) & ~meets).any()
    allowed = rounding if rays == "compiled" else BEYOND * size + MARGIN
    assert not (meets & ~blocked(houses, start, end, allowed)).any()
    # Some rays are near enough to an edge that the promise is needed, and half of them meet.
    assert 0.3 < meets.mean() < 0.9
    is_thick = (meets & ~blocked(houses, start, end, rounding)).any()
    assert is_thick == (rays == "bullet")
