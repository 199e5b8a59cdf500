import numpy as np
import pytest
import shapely
from scipy.optimize import linprog
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bulletuav.city.generator import generate
from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.geometry.graphs import connect_components
from bulletuav.geometry.solids import Solids

NO_STREETS = Streets(np.zeros((0, 2)), np.zeros((0, 2), dtype=int))


def some_city(seed, hulls=6):
    """Boxes and hulls of any shape, which may lie over each other."""
    rng = np.random.default_rng(seed)
    corner = rng.uniform(-40, 30, (5, 3)) * [1, 1, 0]
    boxes = np.stack([corner, corner + rng.uniform(2, 20, (5, 3))], axis=1)
    clouds = tuple(
        rng.uniform(-40, 25, 3) * [1, 1, 0] + rng.uniform(0, 20, (rng.integers(4, 12), 3))
        for _ in range(hulls)
    )
    return City("some", 100.0, Solids(boxes, clouds), np.arange(5 + hulls), NO_STREETS), rng


def corners_of(made):
    boxes = [np.stack(np.meshgrid(*box.T), axis=-1).reshape(-1, 3) for box in made.solids.boxes]
    return boxes + list(made.solids.hulls)


def top(corners, point):
    """Greatest height of a convex combination of the corners over a point; 0 for none."""
    equal = np.vstack([corners[:, :2].T, np.ones(len(corners))])
    found = linprog(-corners[:, 2], A_eq=equal, b_eq=[*point, 1])
    return -found.fun if found.success else 0.0


@pytest.mark.parametrize("hulls", [0, 6])
def test_queries_against_brute_force(hulls):
    made, rng = some_city(1, hulls)
    points = rng.uniform(-45, 35, (150, 2))
    shapes = [shapely.MultiPoint(corners[:, :2]).convex_hull for corners in corners_of(made)]
    gap = np.array(
        [min(shapely.distance(shape, shapely.Point(point)) for shape in shapes) for point in points]
    )
    assert 10 < (gap == 0).sum() < 120
    np.testing.assert_allclose(made.clearance(points, 200), gap, atol=1e-9)
    np.testing.assert_allclose(made.clearance(points, 2), np.minimum(gap, 2), atol=1e-9)
    for margin in (0, 0.5, 3):
        assert np.array_equal(made.outdoors(points, margin), gap > margin)
    roof = [max(top(corners, point) for corners in corners_of(made)) for point in points]
    np.testing.assert_allclose(made.roof(points), roof, atol=1e-6)


def test_shapes_of_queries():
    made, rng = some_city(2)
    points = rng.uniform(-50, 50, (3, 4, 3))
    for query in (made.outdoors, made.roof, lambda at: made.clearance(at, 5)):
        answers = query(points)
        assert answers.shape == (3, 4)
        assert query(points[..., :2])[1, 2] == answers[1, 2] == query(points[1, 2])
        assert query(np.zeros((0, 2))).shape == (0,)


def test_a_wall_is_not_outdoors():
    made = City(
        "one", 100.0, Solids(np.array([[[0.0, 0, 0], [10, 10, 7]]])), np.array([0]), NO_STREETS
    )
    assert made.outdoors([[10.0, 5], [10.001, 5], [13, 14], [13, 14]], 0).tolist() == [
        False,
        True,
        True,
        True,
    ]
    assert made.outdoors([[13.0, 14], [13, 14.001]], 5).tolist() == [
        False,
        True,
    ]  # round the corner
    assert made.roof([[10.0, 5, 99], [10.001, 5, 99]]).tolist() == [7, 0]
    assert made.coverage == pytest.approx(0.01)


def test_ground_without_buildings():
    made = City("plain", 100.0, Solids(np.zeros((0, 2, 3))), np.zeros(0, dtype=int), NO_STREETS)
    assert made.outdoors([[0.0, 0]]).all()
    assert not made.roof([[0.0, 0]]).any()
    assert made.coverage == 0
    assert len(made.heights) == 0


def test_many_questions_are_answered_in_pieces():
    made = generate("urban", 2236.0, np.random.default_rng(0))
    assert len(made.building) == 2500
    points = np.random.default_rng(1).uniform(-1118, 1118, (10_000, 2))
    low, high = made.solids.boxes[:, 0], made.solids.boxes[:, 1]
    x, y = points[:1000, :, None].swapaxes(0, 1)
    inside = (x >= low[:, 0]) & (x <= high[:, 0]) & (y >= low[:, 1]) & (y <= high[:, 1])
    assert np.array_equal(made.outdoors(points)[:1000], ~inside.any(axis=1))
    np.testing.assert_array_equal(made.roof(points)[-1000:], made.roof(points[-1000:]))
    assert made.outdoors(points).mean() == pytest.approx(0.7, abs=0.02)


def test_free_streets_go_round_buildings():
    wall = Solids(np.array([[[-50.0, 20, 0], [50, 24, 9]], [[-10.0, -30, 0], [10, 0, 9]]]))
    made = City("wall", 100.0, wall, np.array([0, 1]), NO_STREETS)
    streets = free_streets(made.side, made.outdoors, spacing=10.0)
    ends = streets.nodes[streets.edges]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) == pytest.approx(10)
    points = ends[:, None, 0] + np.linspace(0, 1, 101)[:, None] * (
        ends[:, None, 1] - ends[:, None, 0]
    )
    assert made.outdoors(points, 0.5).all()
    assert (
        streets.nodes[:, 1].max() == 10
    )  # the part behind the wall, which is smaller, is not in the graph
    assert [-20.0, -20.0] in streets.nodes.tolist()
    assert set(np.unique(streets.edges)) == set(range(len(streets.nodes)))


@pytest.mark.parametrize("edges", [0, 20, 45, 120])
def test_parts_of_a_graph_are_those_of_scipy(edges):
    pairs = np.random.default_rng(edges).integers(0, 60, (edges, 2))
    part = np.arange(60)
    connect_components(part, pairs)
    graph = coo_array((np.ones(edges), pairs.T), shape=(60, 60))
    count, known = connected_components(graph, directed=False)
    assert len(set(part.tolist())) == count
    for k in range(count):
        assert set(part[known == k].tolist()) == {int((known == k).argmax())}
