import numpy as np
import pytest
import sensing
from bench import MULTIROTORS
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sensing import swarm_at

import bulletuav
from bulletuav.city.generator import generate
from bulletuav.engine.calls import bullet
from bulletuav.geometry.city_grid import NO_LAYOUT
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.sight import clearances, line_of_sight, sights

RADIUS, HALF = 0.27, 0.055  # m, of a hummingbird's disc
CITY = generate("dense", 400.0, np.random.default_rng(0), 1.0)
GRAZE = 1e-6  # m
EDGE = 2e-4
"""Of a building's size: by so much the engine's triangles reach over their edges, never less"""


@pytest.fixture
def make_world():
    """Builds worlds in which the first of some layouts stands, or those that `stands` says."""
    made = []

    def make(*arguments, **options):
        made.append(sensing.open_world(*arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.fixture(scope="module", params=["walk", "engine"])
def town(request):
    """A world in which `CITY` stands.

    With an obstacle, which is nowhere near, the engine can be asked for rays.
    """
    options = {}
    if request.param == "engine":
        options = {"obstacles": (Obstacle("sphere", (1.0,)),), "rays": "bullet"}
    engine = sensing.open_world((CITY.solids,), **options)
    yield engine
    engine.close()


def clear(engine, start, end, where=0):
    start, end = np.broadcast_arrays(
        np.atleast_2d(start).astype(float), np.atleast_2d(end).astype(float)
    )
    return line_of_sight(engine, start, end, np.broadcast_to(where, len(start)))


def places(rng, count, top):
    """(count, 3) points outside all buildings up to `top` m."""
    found = np.empty((0, 3))
    while len(found) < count:
        points = rng.uniform((-200, -200, 0.5), (200, 200, top), (count, 3))
        found = np.concatenate([found, points[points[:, 2] > CITY.roof(points) + GRAZE]])
    return found[:count]


# Lines of sight


@pytest.mark.parametrize(
    ("height", "seen"), [(40, True), (41, False), (40.89, True), (40.901, False)]
)
def test_a_building_blocks_from_its_height_on(make_world, height, seen):
    """From 100 m to 1.5 m over 100 m: 60.6 m high at x = 40, 40.9 m at x = 60."""
    engine = make_world((Solids(np.array([[(40.0, -5, 0), (60, 5, height)]])),))
    for start, end in (((0, 0, 100), (100, 0, 1.5)), ((100, 0, 1.5), (0, 0, 100))):
        assert clear(engine, start, end) == [seen]


def test_each_world_is_asked_for_itself(make_world):
    layouts = [Solids(np.array([[(40.0, -5, 0), (60, 5, height)]])) for height in (40, 41)]
    engine = make_world(layouts, worlds=3, stands=[0, 1, NO_LAYOUT])
    np.testing.assert_array_equal(
        clear(engine, [(0, 0, 100)] * 4, (100, 0, 1.5), [0, 1, 2, 1]), (True, False, True, False)
    )


def test_the_ground_blocks_and_what_is_no_way_apart_is_in_sight(make_world):
    engine = make_world()
    assert clear(engine, (0, 0, 1), (50, 0, 1)) == [True]
    assert clear(engine, (0, 0, 1), (50, 0, -1)) == [False]
    assert clear(engine, (3, 4, 5), (3, 4, 5)) == [True]


def test_obstacles_block_and_drones_do_not(make_world):
    engine = make_world(drones=3, obstacles=(Obstacle("box", (2.0, 2.0, 2.0)),))
    swarm_at(engine, [(0, 0, 10), (10, 0, 10), (20, 0, 10)])
    assert clear(engine, (0, 0, 10), (20, 0, 10)) == [True]
    place, turn = np.array([[(5.0, 0.5, 10)]]), np.array([[sensing.LEVEL]])
    engine.set_obstacles(place, turn, np.array([True]))
    np.testing.assert_array_equal(
        clear(engine, (0, 0, 10), [(20, 0, 10), (20, -9, 10)]), (False, True)
    )


def test_either_way_is_the_same(town):
    """5,000 links each between any points, on the level, plumb, and along one axis.

    There ties are broken.
    """
    rng = np.random.default_rng(1)
    for same in ((), (2,), (0, 1), (1, 2), (0, 2), (0,)):
        start, end = places(rng, 5000, 60), places(rng, 5000, 60)
        end[:, same] = start[:, same]
        one, two = clear(town, start, end), clear(town, end, start)
        np.testing.assert_array_equal(one, two)
        assert one.any()
        assert same == (0, 1) or not one.all()


def test_either_way_is_the_same_where_links_just_touch(town):
    """Ends between one in sight and one that is not, halved until nothing is between.

    There rounding decides.
    """
    rng = np.random.default_rng(4)
    start, free, hidden = places(rng, 4000, 60), places(rng, 4000, 60), places(rng, 4000, 60)
    useful = clear(town, start, free) & ~clear(town, start, hidden)
    start, free, hidden = start[useful], free[useful], hidden[useful]
    assert len(start) > 500
    for _ in range(60):
        middle = (free + hidden) / 2
        seen = clear(town, start, middle)
        np.testing.assert_array_equal(clear(town, middle, start), seen)
        free, hidden = (
            np.where(seen[:, None], middle, free),
            np.where(seen[:, None], hidden, middle),
        )
    assert np.linalg.norm(free - hidden, axis=1).max() < 1e-12


WHOLE = st.tuples(*[st.integers(-200, 200)] * 2, st.integers(1, 60))


@given(WHOLE, WHOLE)
def test_either_way_is_the_same_between_any_two_points(town, one, two):
    assert clear(town, one, two) == clear(town, two, one)


def test_who_rises_loses_nothing_from_sight(town):
    """5,000 links that are clear stay so when either end, or both, are raised.

    Buildings stand on the ground.
    """
    rng = np.random.default_rng(2)
    start, end = places(rng, 20000, 60), places(rng, 20000, 60)
    end[:, :2] = start[:, :2] + 0.3 * (end[:, :2] - start[:, :2])
    free = clear(town, start, end) & (end[:, 2] > CITY.roof(end))
    start, end = start[free], end[free]
    assert len(start) > 5000
    rises = np.stack([np.zeros((2, len(start))), rng.exponential(10, (2, len(start)))])[
        :, :, :, None
    ] * (0, 0, 1)
    assert clear(town, start + rises[1, 0], end).all()
    assert clear(town, start, end + rises[1, 1]).all()
    assert clear(town, start + rises[1, 0], end + rises[1, 1]).all()


def slab(boxes, start, end):
    """(M,) whether straight ways from start to end (M, 3) stay clear of boxes (B, 2, 3).

    By the slabs of their faces.
    """
    free = np.ones(len(start), dtype=bool)
    for low, high in boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.stack([(low - start) / (end - start), (high - start) / (end - start)])
        enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
        free &= ~((enter <= leave) & (enter <= 1) & (leave >= 0))
    return free


def grown(boxes, margin):
    """Boxes that reach farther by `margin` (m, or of each box) to all sides."""
    return boxes + np.stack([-np.ones(3), np.ones(3)]) * margin


@pytest.mark.parametrize("ends", ["users", "drones"])
def test_links_are_clear_where_they_miss_every_box(town, ends):
    """20,000 links from drones to users on the ground, or to each other.

    L-shaped buildings are two boxes side by side.
    """
    rng = np.random.default_rng(3)
    start, end = places(rng, 20000, 80), places(rng, 20000, 80)
    if ends == "users":
        end[:, 2] = 1.5
        outdoors = CITY.outdoors(end)
        start, end = start[outdoors], end[outdoors]
    boxes = CITY.solids.boxes
    seen = clear(town, start, end)
    misses = slab(grown(boxes, EDGE * (boxes[:, 1:] - boxes[:, :1])), start, end)
    hits = ~slab(grown(boxes, -GRAZE), start, end)
    assert seen[misses].all()
    assert not seen[hits].any()
    assert (~misses & ~hits).sum() < 20
    assert 0.02 < misses.mean() < 0.7


def test_drones_see_targets_of_their_own_world(make_world):
    layouts = [Solids(np.array([[(40.0, -5, 0), (60, 5, height)]])) for height in (40, 41)]
    engine = make_world(layouts, worlds=2, drones=2, stands=[0, 1])
    position = np.array([[(0.0, 0, 100), (50, 20, 100)]] * 2)
    targets = np.array([[(100.0, 0, 1.5), (20, 0, 1.5)]] * 2)
    seen = sights(engine, position, targets, np.ones((2, 2), dtype=bool))
    np.testing.assert_array_equal(
        seen, [[(True, True), (True, True)], [(False, True), (True, True)]]
    )
    seen = sights(engine, position, targets, np.array([[True, False], [False, False]]))
    np.testing.assert_array_equal(
        seen, [[(True, True), (False, False)], [(False, False), (False, False)]]
    )


@pytest.mark.parametrize("dynamics", ["bullet", "point_mass"])
def test_an_environment_tells_who_sees_users_and_each_other(dynamics):
    aviary = bulletuav.Aviary(
        "los", 2, num_drones=4, dynamics=dynamics, area=250.0, height=(5.0, 20.0), num_layouts=2
    )
    with pytest.raises(RuntimeError, match="call reset"):
        aviary.line_of_sight((0, 0, 1), (1, 0, 1))
    aviary.reset(seeds=0)
    for _ in range(5):
        aviary.step(np.random.default_rng(0).uniform(-1, 1, (2, 4, 3)))
    position, users = aviary.swarm.position, aviary.scene.memory["users"]
    start, end = (
        array.reshape(-1, 3) for array in np.broadcast_arrays(position[:, :, None], users[:, None])
    )
    where = np.repeat([0, 1], 4 * users.shape[1])
    boxes = [aviary.solids(world).boxes for world in (0, 1)]
    expected = np.concatenate([slab(boxes[w], start[where == w], end[where == w]) for w in (0, 1)])
    np.testing.assert_array_equal(aviary.line_of_sight(start, end, where), expected)
    seen = aviary.worlds.frame.readings["sight"]
    np.testing.assert_array_equal(seen[aviary.alive], expected.reshape(2, 4, -1)[aviary.alive])
    assert 0.05 < expected.mean() < 0.95
    between = aviary.line_of_sight(position[1, 0], position[1], 1)
    np.testing.assert_array_equal(between, slab(boxes[1], position[1, [0] * 4], position[1]))
    aviary.close()


# Clearances


def nearest(engine, position, quaternion=sensing.LEVEL, most=50.0, mask=None):
    """(N,) clearances of the drones of world 0."""
    everyone = np.ones(engine.shape, dtype=bool)
    swarm = swarm_at(engine, position, quaternion)
    return clearances(engine, swarm, everyone if mask is None else np.array(mask), most)[0]


BLOCK = Solids(np.array([[(-5.0, -5, 0), (5, 5, 8)]]))


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ((0, 0, 30), 22 - HALF),  # over the roof
        ((20, 0, 6), 6 - HALF),  # over the ground
        ((-8, 0, 6), 3 - RADIUS),  # beside the wall
        ((-4.9, 0, 8.5), 0.5 - HALF),  # over the roof, at its edge
    ],
)
def test_distance_from_ground_wall_and_roof(make_world, position, expected):
    assert nearest(make_world((BLOCK,)), position) == pytest.approx(expected, abs=1e-6)


def test_distance_from_the_edge_of_a_roof(make_world):
    expected = np.hypot(1.5 - RADIUS, 1.5 - HALF)
    assert nearest(make_world((BLOCK,)), (-6.5, 0, 9.5)) == pytest.approx(expected, abs=1e-6)


def test_distance_from_a_hull(make_world):
    turned = Rotation.from_euler("z", 30, degrees=True)
    corners = np.array([(x, y, z) for x in (-5, 5) for y in (-5, 5) for z in (0, 8)], dtype=float)
    engine = make_world((Solids(np.zeros((0, 2, 3)), (turned.apply(corners),)),))
    assert nearest(engine, turned.apply((-8, 0, 6))) == pytest.approx(3 - RADIUS, abs=1e-6)


def test_distance_from_an_obstacle(make_world):
    engine = make_world(obstacles=(Obstacle("sphere", (1.0,)), Obstacle("box", (2.0, 2.0, 2.0))))
    engine.set_obstacles(
        np.array([[(4.0, 0, 20), (0, -3, 20)]]), np.array([[sensing.LEVEL] * 2]), np.array([True])
    )
    assert nearest(engine, (0, 0, 20)) == pytest.approx(2 - RADIUS, abs=1e-6)  # the box
    assert nearest(engine, (1, 1, 20)) == pytest.approx(
        np.sqrt(10) - 1 - RADIUS, abs=1e-6
    )  # the sphere


@pytest.mark.parametrize(
    ("apart", "expected"), [((2, 0, 0), 2 - 2 * RADIUS), ((0, 0, 2), 2 - 2 * HALF)]
)
def test_distance_from_another_drone(make_world, apart, expected):
    distance = nearest(make_world(drones=2), [(0, 0, 30), np.add((0, 0, 30), apart)])
    np.testing.assert_allclose(distance, expected, atol=1e-6)


def test_a_city_of_many_cells_as_by_hand(make_world):
    """A level disc beside the nearest of many boxes: across by its rim, and upwards by its face."""
    city = generate("dense", 400.0, np.random.default_rng(0), 0.0)
    boxes = city.solids.boxes
    engine = make_world((city.solids,), drones=60)
    assert not city.solids.hulls
    assert engine.city_grid.cells > 10
    position = np.random.default_rng(5).uniform((-200, -200, 1), (200, 200, 60), (4000, 3))
    position = position[position[:, 2] > city.roof(position) + 1][:60]
    away = np.maximum(boxes[:, 0] - position[:, None], position[:, None] - boxes[:, 1]).clip(0)
    across = (np.hypot(away[..., 0], away[..., 1]) - RADIUS).clip(0)
    upwards = (away[..., 2] - HALF).clip(0)
    expected = np.minimum(np.hypot(across, upwards).min(axis=1), position[:, 2] - HALF)
    swarm = swarm_at(engine, position)
    # Some discs reach into a wall beside them.
    clear_of = np.flatnonzero(expected > 0)
    for i in clear_of:
        mask = np.arange(60)[None] == i
        distance = clearances(engine, swarm, mask, 500.0)[0, i]
        assert distance == pytest.approx(expected[i], abs=1e-6)
    assert (expected[clear_of] < position[clear_of, 2] - HALF).sum() > 20


def test_what_overlaps_is_deep_in_all_of_it(make_world):
    """Two boxes about one drone: the deeper overlap counts, whichever comes first."""
    boxes = np.array([[(-5.0, -5, 0), (5, 5, 20)], [(-1.0, -1, 0), (1, 1, 20)]])
    for order in ((0, 1), (1, 0)):
        engine = make_world((Solids(boxes[list(order)]),))
        # Deep overlaps are told to a thousandth, and never too shallow
        deep = nearest(engine, (0, 0, 10))
        assert deep == pytest.approx(-5 - RADIUS, rel=1e-3)
        assert deep <= -5 - RADIUS + 1e-9


def test_measuring_moves_no_body(make_world):
    engine = make_world((BLOCK,), drones=2, obstacles=(Obstacle("sphere", (1.0,)),))
    swarm = swarm_at(engine, [(0, 0, 20), (3, 0, 20)])
    engine._bullet.bodies.layouts.make(), engine._bullet.bodies.obstacle  # all that can be moved
    bodies = [bullet.getBodyUniqueId(k, engine._bullet.client) for k in range(7)]
    before = [bullet.getBasePositionAndOrientation(k, engine._bullet.client) for k in bodies]
    everyone = np.ones((1, 2), dtype=bool)
    moved = swarm.copy()
    moved.position[:] += 5
    clearances(engine, moved, everyone, 50.0)
    after = [bullet.getBasePositionAndOrientation(k, engine._bullet.client) for k in bodies]
    assert after == before
    assert bullet.getNumBodies(engine._bullet.client) == len(bodies)


def test_overlap_is_negative(make_world):
    assert nearest(make_world((BLOCK,)), (-5.2, 0, 4)) == pytest.approx(0.2 - RADIUS, abs=1e-6)


@pytest.mark.parametrize("airframe", MULTIROTORS)
def test_distance_of_a_tilted_shape(make_world, airframe):
    """A disc of radius r and half-height h, turned by 30 degrees and rolled by 30.

    Its rim is r sin + h cos lower.
    """
    engine, one = make_world(airframe=airframe), bulletuav.load_airframe(airframe)
    high = one.thinnest / 2
    wide = np.sqrt(one.collision_radius**2 - high**2)
    attitude = Rotation.from_euler("ZX", (30, 30), degrees=True).as_quat()
    assert nearest(engine, (0, 0, 3), attitude) == pytest.approx(
        3 - wide / 2 - high * np.sqrt(0.75), abs=1e-6
    )


def test_who_is_far_or_not_asked_for_has_the_limit(make_world):
    engine = make_world((BLOCK,), drones=3)
    places = [(20, 0, 6), (20, 3, 6), (0, 0, 40)]
    np.testing.assert_allclose(
        nearest(engine, places, most=4.0), (3 - 2 * RADIUS, 3 - 2 * RADIUS, 4), atol=1e-6
    )
    np.testing.assert_allclose(nearest(engine, places, most=2.0), 2.0)
    masked = nearest(engine, places, most=10.0, mask=[[True, False, False]])
    np.testing.assert_allclose(
        masked, (6 - HALF, 10, 10), atol=1e-6
    )  # who is not asked for is not met either


def test_other_worlds_and_parked_layouts_are_far(make_world):
    engine = make_world((BLOCK,), worlds=2, stands=[NO_LAYOUT, 0])
    swarm = swarm_at(engine, [[(0, 0, 9)], [(0, 0, 9)]])
    distance = clearances(engine, swarm, np.ones((2, 1), dtype=bool), 50.0)[:, 0]
    np.testing.assert_allclose(distance, (9 - HALF, 1 - HALF), atol=1e-6)
