from dataclasses import replace

import numpy as np
import pytest

from bulletuav.city.generator import generate
from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.geometry.solids import Solids
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.ground import OFF_GRID, Ground
from bulletuav.network.mobility.raster import MARGIN, bounce, move_straight

NO_STREETS = Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int))


def city_of(boxes, side, hulls=()):
    """A city without a grid."""
    solids = Solids(np.array(boxes, float).reshape(-1, 2, 3), hulls)
    bare = City("own", side, solids, np.arange(len(boxes) + len(hulls)), NO_STREETS)
    return replace(bare, streets=free_streets(side, bare.outdoors, 5.0))


def askew_city():
    """Turned prisms, some over each other or over the edge."""
    rng = np.random.default_rng(3)
    hulls = []
    for _ in range(25):
        angle, middle, size = rng.uniform(0, np.pi), rng.uniform(-90, 90, 2), rng.uniform(2, 14, 2)
        turned = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        outline = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size @ turned
        hulls.append(np.column_stack([np.tile(outline, (2, 1)), np.repeat([0.0, 20.0], 4)]))
    return city_of([], 200.0, tuple(hulls))


@pytest.fixture(scope="module")
def cities():
    rng = np.random.default_rng(0)
    made = [
        generate("urban", 300.0, rng),
        generate("dense", 250.0, rng, 1.0),
        askew_city(),
        city_of([], 123.4),
    ]
    return (*made, city_of([[[2, 2, 0], [6, 6, 9]]], 20.0))


@pytest.fixture(scope="module")
def ground(cities):
    return Ground(cities)


def is_free(ground, layout, points):
    index = np.floor((points + ground.raster.half_side) / ground.raster.cell).astype(int)
    return ground.raster.free[layout, index[..., 0], index[..., 1]]


@pytest.mark.parametrize("layout", range(5))
def test_places_are_outdoors_with_a_margin(cities, ground, layout):
    city, places = cities[layout], ground.places(np.random.default_rng(1), layout, 20_000)
    assert city.outdoors(places, MARGIN * (1 - 1e-6)).all()
    assert (np.abs(places[:, :2]) < city.side / 2).all()
    assert (places[:, 2] == 1.5).all()
    assert is_free(ground, layout, places).all()


@pytest.mark.parametrize("layout", range(5))
def test_only_ground_near_walls_and_edges_is_closed(cities, ground, layout):
    city = cities[layout]
    points = np.random.default_rng(2).uniform(-city.side / 2 + 1, city.side / 2 - 1, (20_000, 2))
    clear = city.outdoors(points, np.sqrt(2) * (1 + MARGIN))
    assert is_free(ground, layout, points)[clear].all()
    assert not is_free(ground, layout, points)[~city.outdoors(points)].any()
    assert clear.mean() > 0.1


def test_places_are_uniform_over_free_ground(ground):
    places = ground.places(np.random.default_rng(3), 2, 40_000)
    count = ground.raster.free.shape[1]
    column = ((places[:, :2] + ground.raster.half_side) // ground.raster.cell).astype(int)
    for axis in range(2):
        share = ground.raster.free[2].mean(axis=1 - axis) / ground.raster.free[2].mean() / count
        found = np.bincount(column[:, axis], minlength=count)
        expected = 40_000 * share
        chi = ((found - expected)[expected > 5] ** 2 / expected[expected > 5]).sum()
        freedom = (expected > 5).sum()
        assert abs(chi - freedom) < 4 * np.sqrt(2 * freedom)
    within = (places[:, :2] + ground.raster.half_side) % ground.raster.cell
    assert within.mean(axis=0) == pytest.approx(0.5, abs=4 / np.sqrt(12 * 40_000))


@pytest.mark.parametrize(
    ("start", "way", "end", "share", "stopped"),
    [
        (
            (-3.5, 4.25),
            (10.0, 0.0),
            (1.0, 4.25),
            0.45,
            0,
        ),  # the cell from 1 to 2 m touches the building from 2 to 6 m
        ((9.5, 4.25), (-5.0, 0.0), (7.0, 4.25), 0.5, 0),
        ((4.25, -9.0), (0.0, 16.0), (4.25, 1.0), 0.625, 1),
        ((-3.5, -8.0), (-13.0, 0.0), (-10.0, -8.0), 0.5, 0),
        (
            (-0.5, -0.75),
            (3.0, 3.5),
            (1.0, 1.0),
            0.5,
            1,
        ),  # at a corner of cells: first into the next column, then not north
        ((-0.5, -0.5), (0.25, -0.25), (-0.25, -0.75), 1.0, -1),
        ((8.5, -9.5), (0.0, 19.0), (8.5, 9.5), 1.0, -1),
        ((4.0, 4.0), (9.0, 9.0), (4.0, 4.0), 0.0, -1),  # in a building
        ((30.0, 0.0), (-9.0, 0.0), (30.0, 0.0), 0.0, -1),  # out of bounds
    ],
)
def test_walk_ends_where_free_cells_end(start, way, end, share, stopped):
    ground = Ground([city_of([[[2, 2, 0], [6, 6, 9]]], 20.0)])
    found = move_straight(ground.raster, 0, *start, *way)
    assert found[:2] == pytest.approx(end, abs=2e-9)
    assert found[2:] == (pytest.approx(share, abs=1e-12), stopped)


@pytest.mark.parametrize("layout", [0, 1, 2])
def test_walk_agrees_with_points_along_it(cities, ground, layout):
    rng = np.random.default_rng(4)
    starts = ground.places(rng, layout, 200)[:, :2]
    ways = rng.uniform(-40, 40, (200, 2)) * rng.choice([0, 1], (200, 2), p=[0.1, 0.9])
    shares = np.linspace(0, 1, 2001)  # at most 3 cm apart
    stopped = 0
    for start, way in zip(starts, ways, strict=True):
        x, y, share, axis = move_straight(ground.raster, layout, *start, *way)
        points = start + shares[:, None] * way
        inside = (np.abs(points) < ground.raster.half_side).all(axis=1)
        free = inside.copy()
        free[inside] = is_free(ground, layout, points[inside])
        assert free[shares < share].all()
        assert (axis == -1) == (share == 1)
        end = start + share * way
        assert (x, y) == pytest.approx(end, abs=3e-9)
        assert is_free(ground, layout, np.array([x, y]))
        assert cities[layout].outdoors(points[shares <= share], MARGIN * (1 - 1e-6)).all()
        if axis >= 0:
            stopped += 1
            beyond = end + np.sign(way) * np.eye(2)[axis] * 1e-7
            assert np.abs(beyond).max() >= ground.raster.half_side or not is_free(
                ground, layout, beyond
            )
    assert 60 < stopped < 200


def test_a_bounce_folds_the_way():
    ground = Ground([city_of([], 20.0)])
    rng = np.random.default_rng(5)
    for start, way in zip(
        rng.uniform(-9, 9, (200, 2)), rng.uniform(-150, 150, (200, 2)), strict=True
    ):
        x, y, *turned = bounce(ground.raster, 0, *start, *way)
        walls = np.floor((start + way + 10) / 20)
        mirrored = np.where(walls % 2 == 0, 1, -1)
        assert (x, y) == pytest.approx(mirrored * (start + way - 20 * walls), abs=1e-6)
        assert turned == mirrored.tolist()


def test_a_bounce_in_a_lane_one_cell_wide():
    walls = np.array([[[-50, -50, 0], [-0.2, 50, 9]], [[1.2, -50, 0], [50, 50, 9]]], float)
    streets = Streets(np.array([[0.5, -50], [0.5, 50]]), np.array([[0, 1]]))
    ground = Ground([City("lane", 100.0, Solids(walls), np.arange(2), streets)])
    assert np.array_equal(np.argwhere(ground.raster.free[0])[:, 0], np.full(100, 50))
    x, y, turned_x, turned_y = bounce(ground.raster, 0, 0.5, -45.0, 30.2, 70.0)
    assert (x, y, turned_x, turned_y) == (
        pytest.approx(0.7, abs=1e-7),
        pytest.approx(25.0, abs=1e-7),
        1.0,
        1.0,
    )


def test_street_places_are_uniform_along_streets():
    nodes = np.array([[-40.0, -40], [40, -40], [40, -30], [0, 0], [-40, 40]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [3, 0]])
    ground = Ground([replace(city_of([], 100.0), streets=Streets(nodes, edges))])
    behind, ahead, along = ground.street_places(np.random.default_rng(6), 0, 50_000).T
    lengths = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
    for (one, two), length in zip(edges, lengths, strict=True):
        share = length / lengths.sum() / 2
        for way in ((one, two), (two, one)):
            here = (behind == way[0]) & (ahead == way[1])
            assert here.mean() == pytest.approx(share, abs=4 * np.sqrt(share / 50_000))
            assert along[here].min() >= 0
            assert along[here].max() < length
            assert along[here].mean() == pytest.approx(
                length / 2, abs=4 * length / np.sqrt(12 * here.sum())
            )


def test_graph_has_the_streets_of_each_layout(cities, ground):
    for layout, city in enumerate(cities):
        node, neighbour = (array[layout] for array in ground.graph)
        assert np.array_equal(node[: len(city.streets.nodes)], city.streets.nodes)
        pairs = {(a, b) for a, row in enumerate(neighbour.tolist()) for b in row if b != OFF_GRID}
        edges = city.streets.edges.tolist()
        assert pairs == {(a, b) for a, b in edges} | {(b, a) for a, b in edges}
        assert (neighbour != OFF_GRID).sum() == 2 * len(edges)


def test_a_large_city():
    city = generate("suburban", 2000.0, np.random.default_rng(7))
    ground = Ground([city], height=1.2, cell=2.0)
    places = ground.places(np.random.default_rng(8), 0, 1000)
    assert ground.raster.free.shape == (1, 1000, 1000)
    assert 0.7 < ground.raster.free.mean() < 1 - city.coverage
    assert city.outdoors(places).all()
    assert (places[:, 2] == 1.2).all()


def full_city(streets):
    return City(
        "full", 20.0, Solids(np.array([[[-10.0, -10, 0], [10, 10, 9]]])), np.array([0]), streets
    )


def streets_of(streets):
    ground = Ground([replace(city_of([], 20.0), streets=streets)])
    assert ground.places(np.random.default_rng(0), 0, 3).shape == (3, 3)  # others can do without
    find_mobility("manhattan").require(ground)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Ground([]), "cities is empty"),
        (lambda: Ground([city_of([], 20.0)], cell=0.0), "cell is 0.0 m"),
        (lambda: Ground([city_of([], 20.0)], height=float("nan")), "height is nan"),
        (lambda: Ground([city_of([], 20.0)], height=-1.0), "height is -1.0 m"),
        (lambda: Ground([full_city(city_of([], 20.0).streets)]), "'full' has no free cell of 1 m"),
        (lambda: streets_of(NO_STREETS), "'own' has no streets"),
        (
            lambda: streets_of(Streets(np.zeros((3, 2)), np.array([[1, 2]]))),
            "'own' has a street of zero length at node 1",
        ),
    ],
)
def test_impossible_grounds_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
