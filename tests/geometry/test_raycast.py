"""Rays through boxes by the walk, beside the engine's and by hand."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bulletuav.city.generator import generate
from bulletuav.engine.calls import VISIBLE
from bulletuav.engine.engine import RAY_METHODS, Engine
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids, box_corners
from bulletuav.vehicle.airframes import load_airframe

LEVEL = (0.0, 0.0, 0.0, 1.0)
TOWER = np.array([[(20.0, -5.0, 0.0), (40.0, 5.0, 60.0)]])


@pytest.fixture
def make_world():
    made = []

    def make(solids, obstacles=(), **options):
        made.append(Engine([load_airframe("cf2x")], 1, 1 / 240, obstacles, [solids], **options))
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
    engine._bullet.bodies.layouts.make()
    reference = engine._bullet.calls.rays(start, start + way, VISIBLE)
    apart = np.abs(walked - reference) * np.linalg.norm(way, axis=1)
    assert (walked < 1).mean() > 0.3
    # Those that differ graze an edge, where the engine's triangles are wider.
    assert (apart > 1e-6).mean() < 2e-4
    beside = np.cross(way, rng.normal(size=way.shape))
    beside *= 0.05 / np.linalg.norm(beside, axis=1, keepdims=True)
    # A hand's breadth aside both tell the same, on one side at least.
    for k in np.flatnonzero(apart > 1e-6):
        sides = start[k] + [beside[k], -beside[k]]
        gaps = cast(engine, sides, sides + way[k]) - engine._bullet.calls.rays(
            sides, sides + way[k], VISIBLE
        )
        assert np.abs(gaps).min() < 1e-9


RAMP = np.array([(10.0, -5, 0), (20, -5, 0), (20, -5, 10), (10, 5, 0), (20, 5, 0), (20, 5, 10)])


@pytest.mark.parametrize("rays", ["compiled", "bullet"])
def test_a_ramp_by_hand(make_world, rays):
    engine = make_world(Solids(TOWER, (RAMP,)), rays=rays)
    # The ramp is 5 m high at x = 15; from within it ends at x = 20; above it stands the tower.
    near = 1e-12 if rays == "compiled" else 1e-6
    ends = [(30, 0, 5), (30, 0, 5), (30, 0, 12), (30, 6, 5)]
    starts = [(0, 0, 5), (18, 0, 5), (0, 0, 12), (0, 6, 5)]
    expected = (0.5, 2 / 12, 20 / 30, 1)
    np.testing.assert_allclose(cast(engine, starts, ends), expected, atol=near)


OCTAHEDRON = tuple(map(tuple, np.concatenate([np.eye(3), -np.eye(3)]).tolist()))
QUARTER = tuple(Rotation.from_euler("z", 90, degrees=True).as_quat().tolist())
"""Turns a body's x axis to y"""


@pytest.mark.parametrize(
    ("obstacle", "quaternion", "start", "end", "expected"),
    [
        # The sphere is 2 m beside the ray's start at x = -10, its pole 1.5 m off.
        (Obstacle("sphere", (2.5,)), LEVEL, (-10, 1.5, 0), (10, 1.5, 0), 8 / 20),
        # Edges 2, 4, 6 m: turned by a quarter the box is 4 m wide along x.
        (Obstacle("box", (2.0, 4.0, 6.0)), LEVEL, (-10, 0, 0), (10, 0, 0), 9 / 20),
        (Obstacle("box", (2.0, 4.0, 6.0)), QUARTER, (-10, 0, 0), (10, 0, 0), 8 / 20),
        # A cylinder of radius 5 has a chord of 8 m at y = 3; its roof is at z = 1.
        (Obstacle("cylinder", (5.0, 2.0)), LEVEL, (-10, 3, 0), (10, 3, 0), 6 / 20),
        (Obstacle("cylinder", (5.0, 2.0)), LEVEL, (0, 3, 5), (0, 3, -5), 4 / 10),
        (Obstacle("cylinder", (5.0, 2.0)), LEVEL, (-10, 3, 1.1), (10, 3, 1.1), 1.0),
        # |x| + |y| + |z| = 1: at y = 0.25, z = 0.25 from x = -0.5 on; along a face it is missed.
        (
            Obstacle("hull", corners=OCTAHEDRON),
            LEVEL,
            (-10, 0.25, 0.25),
            (10, 0.25, 0.25),
            9.5 / 20,
        ),
        (Obstacle("hull", corners=OCTAHEDRON), LEVEL, (2, 0, 0.1), (0, 2, 0.1), 1.0),
        (Obstacle("hull", corners=OCTAHEDRON), LEVEL, (0.2, 0, 0), (2.2, 0, 0), 0.8 / 2),
        (Obstacle("hull", corners=OCTAHEDRON), LEVEL, (0.2, 0, 0), (0.4, 0, 0), 1.0),
    ],
)
def test_obstacles_by_hand(make_world, obstacle, quaternion, start, end, expected):
    engine = make_world(Solids(TOWER[:0]), (obstacle,))
    place = np.array([(100.0, 50.0, 30.0)])
    engine.set_obstacles(place[None], np.array([[quaternion]]), np.ones(1, bool))
    share = cast(engine, place + start, place + end)
    np.testing.assert_allclose(share, expected, atol=1e-12)


def random_hull(rng):
    return Obstacle("hull", corners=tuple(map(tuple, rng.normal(0, 1.2, (12, 3)).tolist())))


def scattered(rng):
    """Obstacles of all kinds, at random poses."""
    kinds = [Obstacle("sphere", (1.5,)), Obstacle("box", (2, 3, 1)), Obstacle("cylinder", (1, 3))]
    obstacles = 3 * (*kinds, random_hull(rng))
    place = rng.uniform((-15, -15, 0), (15, 15, 10), (1, len(obstacles), 3))
    return obstacles, place, Rotation.random(len(obstacles), rng=rng).as_quat()[None]


def depth(points, obstacles, place, turn):
    """(M,) how deep points are within the nearest obstacle, m, below 0 outside."""
    found = np.full(len(points), -np.inf)
    for k, one in enumerate(obstacles):
        local = Rotation.from_quat(turn[0, k]).inv().apply(points - place[0, k])
        if one.kind == "sphere":
            inner = one.size[0] - np.linalg.norm(local, axis=1)
        elif one.kind == "box":
            inner = (np.array(one.size) / 2 - np.abs(local)).min(axis=1)
        elif one.kind == "cylinder":
            rim = one.size[0] - np.hypot(local[:, 0], local[:, 1])
            inner = np.minimum(rim, one.size[1] / 2 - np.abs(local[:, 2]))
        else:
            planes = ConvexHull(one.corners).equations
            inner = -(local @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        found = np.maximum(found, inner)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_the_engine_meets_obstacles_at_the_same_places(make_world, seed):
    rng = np.random.default_rng(seed)
    obstacles, place, turn = scattered(rng)
    engines = [make_world(Solids(TOWER[:0]), obstacles, rays=one) for one in RAY_METHODS]
    for engine in engines:
        engine.set_obstacles(place, turn, np.ones(1, bool))
    start = rng.uniform((-25, -25, 0.5), (25, 25, 20), (20000, 3))
    # The engine is not asked from within, of which it knows little.
    apart = np.linalg.norm(start[:, None] - place, axis=-1)
    start = start[(apart > engines[0].obstacle_radius).all(axis=1)]
    end = start + rng.uniform(-40, 40, start.shape)
    fast, slow = (cast(engine, start, end) for engine in engines)
    gap = np.abs(fast - slow) * np.linalg.norm(end - start, axis=1)
    assert (fast < 1).mean() > 0.2
    assert len(start) > 10000
    # The engine stops up to 1 mm before a surface, and thickens hulls by another one. Where a ray
    # slants, that is more along it.
    assert (gap > 1e-3).mean() < 0.02
    assert (gap > 0.02).mean() < 1e-3
    both = (fast < 1) & (slow < 1) & (gap < 0.1) & (end[:, 2] > 0)
    place_of = start + slow[:, None] * (end - start)
    assert np.abs(depth(place_of[both], obstacles, place, turn)).max() < 2.2e-3


@pytest.mark.parametrize("seed", range(3))
def test_points_before_what_a_ray_meets_are_outside(make_world, seed):
    """No point of the free share is within an obstacle, and the last one is on its surface."""
    rng = np.random.default_rng(seed)
    obstacles, place, turn = scattered(rng)
    engine = make_world(Solids(TOWER[:0]), obstacles)
    engine.set_obstacles(place, turn, np.ones(1, bool))
    start = rng.uniform((-25, -25, 20), (25, 25, 30), (3000, 3))
    end = place[0, rng.integers(len(obstacles), size=3000)] + rng.uniform(-4, 4, (3000, 3))
    end[:, 2] = np.maximum(end[:, 2], 0.1)
    share = cast(engine, start, end)
    met = share < 1
    assert 0.1 < met.mean() < 0.9
    for part in np.linspace(0, 1, 50):
        points = start + part * share[:, None] * (end - start)
        assert (depth(points, obstacles, place, turn) < 1e-9).all()
    # The last of these points are where the rays end.
    np.testing.assert_allclose(depth(points[met], obstacles, place, turn), 0, atol=1e-9)


def test_corners_of_boxes_are_those_of_the_mesh():
    corners = box_corners(TOWER[0])
    assert sorted(map(tuple, corners)) == sorted(
        (x, y, z) for x in (20, 40) for y in (-5, 5) for z in (0, 60)
    )


def random_world(make_world, rays):
    """Make a world with houses, a ramp and four obstacles at random poses, from the same seed."""
    rng = np.random.default_rng(11)
    boxes = generate("urban", 300.0, rng, 1.0).solids.boxes
    shapes = (
        Obstacle("sphere", (6.0,)),
        Obstacle("box", (4.0, 8.0, 12.0)),
        Obstacle("cylinder", (5.0, 9.0)),
        Obstacle("hull", corners=tuple(tuple(9.0 * x for x in corner) for corner in OCTAHEDRON)),
    )
    engine = make_world(Solids(boxes, (RAMP,)), shapes, rays=rays)
    place = rng.uniform((-100, -100, 30), (100, 100, 80), (1, len(shapes), 3))
    turn = Rotation.random(len(shapes), rng=rng).as_quat()[None]
    engine.set_obstacles(place, turn, np.ones(1, dtype=bool))
    return engine


def test_bullet_casts_all_rays_and_agrees_with_compiled_rays(make_world):
    compiled, bullet = (random_world(make_world, rays) for rays in ("compiled", "bullet"))
    asked = []
    by_bullet = bullet._bullet.calls.rays
    bullet._bullet.calls.rays = lambda *given: asked.append(len(given[0])) or by_bullet(*given)
    rng = np.random.default_rng(12)
    start = rng.uniform((-150, -150, 1), (150, 150, 90), (20000, 3))
    way = rng.normal(size=start.shape)
    way *= rng.uniform(1, 200, (len(start), 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    one, two = cast(compiled, start, start + way), cast(bullet, start, start + way)
    assert asked == [len(start)]
    assert 0.3 < (one < 1).mean() < 0.9
    gap = np.abs(one - two) * np.linalg.norm(way, axis=1)
    # Bullet's shapes reach beyond their edges, where rays that graze one differ
    assert (gap > 1e-3).mean() < 3e-3
    assert (gap > 1e-2).mean() < 1e-3
    assert np.median(gap) < 1e-12
