"""Mobility of users against closed forms, and where it may never lead them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bulletuav.city.generator import generate
from bulletuav.city.model import City
from bulletuav.city.streets import Streets, free_streets
from bulletuav.geometry.solids import Solids
from bulletuav.network.mobility import find_mobility
from bulletuav.network.mobility.base import Walking, stream_uniform
from bulletuav.network.mobility.gauss_markov import CORRELATION_TIME, GaussMarkov, gauss_markov
from bulletuav.network.mobility.ground import OFF_GRID, Ground
from bulletuav.network.mobility.hotspot import TURNING_TIME, HotspotMobility
from bulletuav.network.mobility.manhattan import next_node
from bulletuav.network.mobility.waypoint import Waypoint
from bulletuav.registry import names

WALKS = [name for name in names("mobility") if name != "still"]
COURTYARD = [
    [[-9, -9, 0], [9, -1.2, 9]],
    [[-9, 1.2, 0], [9, 9, 9]],
    [[-9, -9, 0], [-1.2, 9, 9]],
    [[1.2, -9, 0], [9, 9, 9]],
]


def city_of(side, boxes=(), hulls=(), streets=None):
    """A city without a grid, on whose free ground streets are laid where none are given."""
    solids = Solids(np.array(boxes, float).reshape(-1, 2, 3), hulls)
    bare = City(
        "own",
        side,
        solids,
        np.arange(len(boxes) + len(hulls)),
        Streets(np.zeros((0, 2)), np.zeros((0, 2), int)),
    )
    return replace(bare, streets=free_streets(side, bare.outdoors) if streets is None else streets)


def askew_city():
    """Turned prisms, some over each other or over the edge."""
    rng = np.random.default_rng(3)
    hulls = []
    for _ in range(40):
        angle, middle, size = (
            rng.uniform(0, np.pi),
            rng.uniform(-140, 140, 2),
            rng.uniform(2, 16, 2),
        )
        turned = [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        outline = middle + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size @ turned
        hulls.append(np.column_stack([np.tile(outline, (2, 1)), np.repeat([0.0, 20.0], 4)]))
    return city_of(300.0, hulls=tuple(hulls))


@pytest.fixture(scope="module")
def cities():
    rng = np.random.default_rng(0)
    grids = [
        generate("urban", 300.0, rng),
        generate("dense", 350.0, rng, 1.0),
        generate("suburban", 250.0, rng, 0.5),
    ]
    return (*grids, askew_city(), city_of(200.0))


@pytest.fixture(scope="module")
def ground(cities):
    return Ground(cities)


class Crowd:
    """W worlds of users, all new."""

    def __init__(self, model, ground, layouts, count, seed=0):
        self.model, self.ground, self.layout = find_mobility(model), ground, np.array(layouts)
        self.rng = [np.random.default_rng((seed, k)) for k in range(len(layouts))]
        worlds = [
            self.model.start(rng, ground, layout, count)
            for rng, layout in zip(self.rng, layouts, strict=True)
        ]
        self.state = {name: np.stack([world[name] for world in worlds]) for name in worlds[0]}
        assert {name: array.shape[1:] for name, array in self.state.items()} == self.model.state(
            count
        )
        assert {array.dtype for array in self.state.values()} == {np.dtype(float)}

    def move(self, dt=1.0, flying=None, steps=1):
        """Users (steps + 1, W, U, 3), before and after each step."""
        flying = np.ones(len(self.rng), dtype=bool) if flying is None else np.array(flying)
        users = [self.state["users"].copy()]
        for _ in range(steps):
            self.model.move(self.state, self.ground, self.layout, flying, dt, self.rng)
            users.append(self.state["users"].copy())
        return np.array(users)


def standard_error(samples):
    """Of the mean of independent samples."""
    return samples.std(ddof=1) / math.sqrt(samples.size)


# ---- all models ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", names("mobility"))
def test_long_walks_stay_outdoors_in_bounds_and_slow(cities, ground, name):
    crowd = Crowd(name, ground, range(5), 50)
    users = crowd.move(steps=600)
    for layout, city in enumerate(cities):
        assert city.outdoors(users[:, layout]).all()
        assert np.abs(users[:, layout, :, :2]).max() <= city.side / 2 + 1e-9
    assert (users[..., 2] == 1.5).all()
    steps = np.linalg.norm(np.diff(users, axis=0), axis=-1)
    assert steps.max() <= crowd.model.max_speed + 1e-7
    assert (
        np.linalg.norm(crowd.state["user_velocity"], axis=-1) <= crowd.model.max_speed + 1e-9
    ).all()
    if name != "still":
        assert np.median(steps.sum(axis=0)) > 300  # m
        assert (np.ptp(users, axis=0).max(axis=-1) > 5).mean() > 0.99


@pytest.mark.parametrize("name", ["gauss_markov", "hotspot", "waypoint"])
def test_users_in_a_courtyard_stay_in_it(name):
    crowd = Crowd(name, Ground([city_of(60.0, COURTYARD)]), [0], 20)
    crowd.state["users"][..., :2] = crowd.state["users"][..., :2] % 1.0 - 0.5
    if name == "waypoint":
        crowd.state["user_goal"][:] = crowd.state["users"][..., :2]
    assert np.abs(crowd.move(0.7, steps=300)[..., :2]).max() <= 1.0


@pytest.mark.parametrize("dt", [0.05, 7.3, 90.0])
@pytest.mark.parametrize("name", WALKS)
def test_any_step_keeps_the_rules(cities, ground, name, dt):
    crowd = Crowd(name, ground, range(5), 20)
    users = crowd.move(dt, steps=40)
    for layout, city in enumerate(cities):
        assert city.outdoors(users[:, layout]).all()
        assert np.abs(users[:, layout, :, :2]).max() <= city.side / 2 + 1e-9
    assert (
        np.linalg.norm(np.diff(users, axis=0), axis=-1).max() <= crowd.model.max_speed * dt + 1e-6
    )


@pytest.mark.parametrize("name", WALKS)
def test_small_steps_lead_as_far_as_large_ones(ground, name):
    """Mean squares of the ways gone after 10 s and 60 s agree within four standard errors."""
    gone = []
    for dt in (0.1, 1.0):
        crowd = Crowd(name, ground, [1, 3] * 8, 60, seed=round(1 / dt))
        start = crowd.state["users"].copy()
        gone.append([])
        for span in (10, 50):
            now = crowd.move(dt, steps=round(span / dt))[-1]
            gone[-1].append(((now - start)[..., :2] ** 2).sum(axis=-1))
    for small, large in zip(*gone, strict=True):
        assert small.mean() == pytest.approx(
            large.mean(), abs=4 * math.hypot(standard_error(small), standard_error(large))
        )
        assert standard_error(large) < 0.05 * large.mean()


@pytest.mark.parametrize("name", names("mobility"))
def test_worlds_do_not_feel_each_other(ground, name):
    crowd = Crowd(name, ground, [0, 1, 2, 3], 12)
    crowd.rng[1], still = None, {key: array[1].copy() for key, array in crowd.state.items()}
    users = crowd.move(flying=[True, False, True, True], steps=60)
    assert all(np.array_equal(crowd.state[key][1], array) for key, array in still.items())
    again = Crowd(name, ground, [0, 1, 2, 3], 12)
    alone = again.move(flying=[False, False, True, False], steps=60)
    assert np.array_equal(alone[:, 2], users[:, 2])
    assert all(np.array_equal(again.state[key][2], crowd.state[key][2]) for key in crowd.state)
    assert np.array_equal(alone[:, 0], np.repeat(alone[:1, 0], 61, axis=0))


@pytest.mark.parametrize("name", WALKS)
def test_seeds_tell_walks(ground, name):
    one, same, other = (
        Crowd(name, ground, [0, 3], 10, seed).move(0.5, steps=20) for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same)
    assert not np.isclose(one, other).all(axis=-1).any()


@pytest.mark.parametrize("dt", [0.0, -1.0, math.nan, math.inf, "1"])
def test_steps_of_no_time_are_refused(ground, dt):
    with pytest.raises(ValueError, match="dt is"):
        Crowd("still", ground, [0], 1).move(dt)


# ---- random numbers ------------------------------------------------------------------------------


def test_streams_are_those_of_splitmix64():
    """The first five outputs that the reference implementation gives for the seed 1234567."""
    known = (
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    )
    assert [stream_uniform(np.uint64(1234567), k) for k in range(5)] == [
        (value >> 11) * 2.0**-53 for value in known
    ]


# ---- Gauss-Markov --------------------------------------------------------------------------------


def test_gauss_markov_step():
    found = gauss_markov(
        np.array([1.0, 0.0]), np.array([0.5, 0.0]), 0.75, 0.5, np.array([1.0, -1.0])
    )
    assert found == pytest.approx((1.2057189, -0.3307189), abs=5e-8)
    assert math.exp(-1 / CORRELATION_TIME) == pytest.approx(0.75, abs=1e-12)
    assert pytest.approx(3.476059, abs=5e-7) == CORRELATION_TIME


def test_gauss_markov_limits():
    assert gauss_markov(1.3, 0.2, 1.0, 0.5, 2.0) == 1.3  # no time
    assert gauss_markov(1.3, 0.2, 0.0, 0.5, 2.0) == pytest.approx(
        1.2, abs=1e-15
    )  # long after: mean and deviation alone


@pytest.mark.parametrize("dt", [0.1, 1.0, 4.0])
def test_gauss_markov_statistics_on_open_ground(dt):
    """Mean, deviation and correlation, within four standard errors of 8000 independent users."""
    crowd = Crowd(GaussMarkov(deviation=0.4), Ground([city_of(1500.0)]), [0] * 8, 1000)
    crowd.state["users"][..., :2] *= 0.5  # none reaches the edge
    mean = crowd.state["user_mean_velocity"].copy()
    first = crowd.state["user_velocity"] - mean
    crowd.move(dt, steps=round(4 / dt))
    last = crowd.state["user_velocity"] - mean
    assert np.array_equal(crowd.state["user_mean_velocity"], mean)
    for velocity in (first, last):
        assert velocity.mean(axis=(0, 1)) == pytest.approx(0, abs=4 * 0.4 / math.sqrt(8000))
        assert velocity.std(axis=(0, 1)) == pytest.approx(0.4, abs=4 * 0.4 / math.sqrt(2 * 8000))
    correlation = (first * last).mean(axis=(0, 1)) / 0.4**2
    assert correlation == pytest.approx(0.75**4, abs=4 * math.sqrt(1 + 0.75**8) / math.sqrt(8000))
    speeds = np.linalg.norm(mean, axis=-1)
    assert speeds.min() >= 0.5
    assert speeds.max() <= 3.0
    assert speeds.mean() == pytest.approx(1.75, abs=4 * 2.5 / math.sqrt(12 * 8000))


def test_gauss_markov_speed_is_cut_at_four_deviations():
    model = GaussMarkov(speed=(0.2, 0.3), deviation=2.0)
    crowd = Crowd(model, Ground([city_of(800.0)]), [0] * 8, 1000)
    speeds = []
    for _ in range(12):
        crowd.move()
        most = np.linalg.norm(crowd.state["user_mean_velocity"], axis=-1) + 8.0
        speeds.append(np.linalg.norm(crowd.state["user_velocity"], axis=-1) / most)
    assert model.max_speed == 8.3
    assert np.max(speeds) == pytest.approx(1.0, abs=1e-12)  # some would have been faster
    assert np.mean(np.array(speeds) > 1 - 1e-9) < 1e-3


def test_gauss_markov_users_turn_away_from_walls():
    """One cell is closed before the wall, whose face is at x = 0."""
    crowd = Crowd(
        GaussMarkov(deviation=0.0), Ground([city_of(100.0, [[[0, -50, 0], [9, 50, 9]]])]), [0], 3
    )
    crowd.state["users"][0, :, :2] = [[-2.0, 0], [-1.5, 0], [-48.5, -48.5]]
    crowd.state["user_velocity"][0] = [[3.0, 1], [3, 1], [-2, -1]]
    crowd.state["user_mean_velocity"][0] = [[3.0, 1], [-3, 1], [-2, -1]]
    crowd.move(2.0)
    pace = (
        2 * 0.75**2 - 1
    ) * 3  # of the second, who comes from a mean that leads away from the wall
    assert crowd.state["users"][0, :, :2] == pytest.approx(
        np.array([[-6, 2], [-0.5 - 2 * pace, 2], [-47.5, -49.5]]), abs=1e-7
    )
    assert crowd.state["user_velocity"][0] == pytest.approx(
        np.array([[-3, 1], [-pace, 1], [2, 1]]), abs=1e-12
    )
    assert crowd.state["user_mean_velocity"][0].tolist() == [[-3, 1], [-3, 1], [2, 1]]


# ---- Manhattan -----------------------------------------------------------------------------------


def star(*angles):
    """Ground with a node 0 from which streets lead to nodes 1, 2, ... at these angles, degrees."""
    nodes = 40 * np.array(
        [
            (0, 0),
            *((math.cos(math.radians(angle)), math.sin(math.radians(angle))) for angle in angles),
        ]
    )
    edges = np.array([(0, k + 1) for k in range(len(angles))])
    return Ground([city_of(100.0, streets=Streets(nodes, edges))])


@pytest.mark.parametrize(
    ("angles", "shares"),
    [
        ((180, 0, 90, -90), {2: 0.5, 3: 0.25, 4: 0.25}),  # a crossing, reached from the west
        ((180, 90, -90), {2: 0.5, 3: 0.5}),
        ((180, 0, 90), {2: 2 / 3, 3: 1 / 3}),
        ((180, 0, -90), {2: 2 / 3, 3: 1 / 3}),
        ((180, -160), {2: 1.0}),  # a hairpin bend
        ((180,), {1: 1.0}),  # the end of a street
        ((180, 40, 50, -50), {2: 0.5, 3: 0.25, 4: 0.25}),
        ((180, 20, -20), {2: 0.5, 3: 0.5}),
        ((180, 100, 60), {2: 0.5, 3: 0.5}),
    ],
)
def test_manhattan_turns(angles, shares):
    graph = star(*angles).graph
    chances = (np.arange(2400) + 0.5) / 2400
    nodes = [next_node(graph, 0, 1, 0, (0.5, 0.25, 0.25), chance) for chance in chances]
    found, counts = np.unique(nodes, return_counts=True)
    assert dict(zip(found.tolist(), counts / 2400, strict=True)) == pytest.approx(shares, abs=1e-3)


def test_manhattan_left_is_left_from_everywhere():
    for east in (0, 30, 90, 180, 200, 271):
        graph = star(east + 180, east, east + 90, east - 90).graph
        assert next_node(graph, 0, 1, 0, (1e-9, 1.0, 1e-9), 0.5) == 3
        assert next_node(graph, 0, 1, 0, (1e-9, 1e-9, 1.0), 0.5) == 4
        assert next_node(graph, 0, 4, 0, (1e-9, 1.0, 1e-9), 0.5) == 1


def test_manhattan_users_choose_each_for_themselves():
    crowd = Crowd("manhattan", star(180, 0, 90, -90), [0], 4000)
    crowd.state["user_street"][0] = 1, 0, 39.0
    crowd.move(3.0)
    counts = np.bincount(crowd.state["user_street"][0, :, 1].astype(int), minlength=5)
    shares = np.array([0, 0, 0.5, 0.25, 0.25])
    assert np.abs(counts / 4000 - shares).max() < 4 * math.sqrt(0.25 / 4000)
    assert counts[:2].tolist() == [0, 0]


def test_manhattan_users_keep_to_streets_and_to_their_speed(cities, ground):
    crowd = Crowd("manhattan", ground, [0, 3, 4], 60)
    speed = crowd.state["user_speed"].copy()
    assert 0.5 <= speed.min() < speed.max() <= 3
    before = crowd.state["user_street"].copy()
    ends = np.sum(ground.graph.neighbour != OFF_GRID, axis=-1) == 1
    turned, passed = 0, 0
    for _ in range(300):
        crowd.move()
        behind, ahead, along = np.moveaxis(crowd.state["user_street"], -1, 0)
        for world, layout in enumerate(crowd.layout):
            one, two = (
                ground.graph.node[layout, nodes[world].astype(int)] for nodes in (behind, ahead)
            )
            heading = (two - one) / np.linalg.norm(two - one, axis=1)[:, None]
            place = one + along[world][:, None] * heading
            np.testing.assert_allclose(crowd.state["users"][world, :, :2], place, atol=1e-9)
            np.testing.assert_allclose(
                crowd.state["user_velocity"][world], speed[world][:, None] * heading, atol=1e-12
            )
            back = (behind[world] == before[world, :, 1]) & (ahead[world] == before[world, :, 0])
            assert ends[layout, behind[world][back].astype(int)].all()
            turned += back.sum()
            passed += (behind[world] != before[world, :, 0]).sum()
        before = crowd.state["user_street"].copy()
    assert np.array_equal(crowd.state["user_speed"], speed)
    assert passed > 5 * turned > 0


def test_manhattan_carries_the_rest_of_the_way_over_nodes():
    """A ring of streets without crossings, 160 m round: where one is after any step is known."""
    corners = np.array([[-20.0, -20], [0, -20], [20, -20], [20, 20], [-20, 20]])
    ring = Ground(
        [
            city_of(
                100.0, streets=Streets(corners, np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]]))
            )
        ]
    )
    crowd = Crowd("manhattan", ring, [0], 1)
    crowd.state["user_street"][0, 0] = 0, 1, 5.0
    crowd.state["user_speed"][:] = 2.0
    for dt, place in (
        (1.0, (-13, -20)),
        (6.5, (0, -20)),
        (30.0, (20, 20)),
        (80.0, (20, 20)),
        (17.0, (-14, 20)),
        (813.0, (-20, 0)),
    ):
        crowd.move(dt)
        assert crowd.state["users"][0, 0, :2] == pytest.approx(place, abs=1e-9)


# ---- hotspots ------------------------------------------------------------------------------------


def test_headings_blend_on_the_circle():
    old, towards = np.radians(170), np.radians(-170)
    keep = math.exp(-1 / TURNING_TIME)
    assert keep == pytest.approx(0.4, abs=1e-15)
    x = gauss_markov(np.cos(old), np.cos(towards), keep, 0.0, 0.0)
    y = gauss_markov(np.sin(old), np.sin(towards), keep, 0.0, 0.0)
    assert math.degrees(math.atan2(y, x)) == pytest.approx(-178.0, abs=0.05)


@pytest.mark.parametrize("steps", [1, 10])
def test_hotspot_users_turn_towards_their_hotspot(steps):
    model = HotspotMobility(speed=(1e-6, 1e-6), drift=(0.0, 0.0), wobble=0.0, num_hotspots=1)
    crowd = Crowd(model, Ground([city_of(200.0)]), [0], 1)
    crowd.state["users"][0, 0, :2], crowd.state["hotspots"][0, 0] = (
        (0, 0),
        90 * np.array([-np.cos(0.3), -np.sin(0.3)]),
    )
    crowd.state["user_heading"][0, 0] = -np.cos(0.3), np.sin(0.3)
    crowd.move(1 / steps, steps=steps)
    blend = np.array([-np.cos(0.3), (0.4 - 0.6) * np.sin(0.3)])
    assert crowd.state["user_heading"][0, 0] == pytest.approx(blend, abs=1e-6)
    assert crowd.state["user_velocity"][0, 0] == pytest.approx(
        1e-6 * blend / np.linalg.norm(blend), abs=1e-12
    )


def test_hotspots_and_their_users_turn_at_walls():
    """One cell is closed before the wall, whose face is at x = 0."""
    model = HotspotMobility(wobble=0.0, num_hotspots=1)
    crowd = Crowd(model, Ground([city_of(100.0, [[[0, -50, 0], [9, 50, 9]]])]), [0], 1)
    crowd.state["hotspots"][0, 0], crowd.state["hotspot_velocity"][0, 0] = (-1.5, 3.0), (0.5, 0.25)
    crowd.state["users"][0, 0, :2], crowd.state["user_heading"][0, 0] = (-2.0, 0.0), (0.6, -0.8)
    crowd.state["user_speed"][:] = 2.0
    crowd.move(2.0)
    assert crowd.state["hotspots"][0, 0] == pytest.approx((-1.5, 3.5), abs=1e-8)
    assert crowd.state["hotspot_velocity"][0, 0] == pytest.approx((-0.5, 0.25), abs=1e-12)
    assert crowd.state["users"][0, 0, :2] == pytest.approx((-2.4, -3.2), abs=1e-8)
    assert crowd.state["user_heading"][0, 0] == pytest.approx((-0.6, -0.8), abs=1e-12)
    assert crowd.state["user_velocity"][0, 0] == pytest.approx((-1.2, -1.6), abs=1e-12)


def test_hotspot_users_gather_and_mill_around(cities, ground):
    crowd = Crowd("hotspot", ground, [0, 1, 2, 3, 4] * 2, 60)

    def gaps():
        own = np.take_along_axis(
            crowd.state["hotspots"], crowd.state["user_hotspot"].astype(int)[..., None], axis=1
        )
        return np.linalg.norm(crowd.state["users"][..., :2] - own, axis=-1)

    before = np.median(gaps())
    hotspots = []
    for _ in range(900):
        crowd.move()
        hotspots.append(crowd.state["hotspots"].copy())
    after = gaps()
    assert before > 80
    assert 8 < np.median(after) < 25
    assert np.percentile(after, 10) > 3  # nobody sticks to the point
    hotspots = np.array(hotspots)
    speeds = np.linalg.norm(np.diff(hotspots, axis=0), axis=-1)
    assert speeds.max() <= 1.0 + 1e-7
    assert np.median(speeds) > 0.2
    for world, layout in enumerate(crowd.layout):
        assert cities[layout].outdoors(hotspots[:, world]).all()
        assert np.abs(hotspots[:, world]).max() < cities[layout].side / 2
    assert set(crowd.state["user_hotspot"].ravel()) == {0, 1}


# ---- waypoints -----------------------------------------------------------------------------------


def test_waypoint_speed_is_the_harmonic_mean():
    """The time average on the way is (3 - 0.5) / ln 6 = 1.3953 m/s.

    Within four standard errors of 1000 independent users.
    """
    crowd = Crowd(Waypoint(pause=(0.0, 0.0)), Ground([city_of(150.0)]), [0] * 20, 50)
    speeds = np.empty((1200, 20, 50))
    for row in speeds:
        crowd.move(2.0)
        row[:] = np.linalg.norm(crowd.state["user_velocity"], axis=-1)
    means = speeds.mean(axis=0).ravel()
    error = standard_error(means)
    assert error < 0.01
    assert means.mean() == pytest.approx(1.3953, abs=4 * error)
    early = speeds[:5].mean(axis=0).ravel()
    assert early.mean() == pytest.approx(
        1.3953, abs=4 * standard_error(early)
    )  # from the start, no decay
    assert speeds[speeds > 0].min() >= 0.5
    assert speeds.max() <= 3.0


def test_waypoint_arrival_pause_and_next_leg_in_one_step():
    model = Waypoint(speed=(2.0, 2.0), pause=(3.0, 3.0))
    crowd = Crowd(model, Ground([city_of(400.0)]), [0], 1)
    crowd.state["users"][0, 0, :2], crowd.state["user_goal"][0, 0] = (0.0, 0.0), (6.0, 8.0)
    place = crowd.state["users"][0, 0]
    crowd.move(2.5)
    assert place[:2] == pytest.approx((3.0, 4.0), abs=1e-12)
    assert crowd.state["user_velocity"][0, 0] == pytest.approx((1.2, 1.6), abs=1e-12)
    crowd.move(4.5)
    assert place[:2].tolist() == [6.0, 8.0]
    assert crowd.state["user_velocity"][0, 0].tolist() == [0.0, 0.0]
    assert crowd.state["user_pause"][0, 0] == pytest.approx(1.0, abs=1e-12)
    crowd.move(2.0)
    way = crowd.state["user_goal"][0, 0] - (6.0, 8.0)
    assert place[:2] == pytest.approx((6, 8) + 2.0 * way / np.linalg.norm(way), abs=1e-12)
    assert crowd.state["user_velocity"][0, 0] == pytest.approx(
        2.0 * way / np.linalg.norm(way), abs=1e-12
    )
    crowd.state["user_goal"][0, 0] = place[:2] + (0.0, 1.0)
    goal = crowd.state["user_goal"][0, 0].copy()
    crowd.move(0.5 + 3.0 + 0.25)
    assert np.linalg.norm(place[:2] - goal) == pytest.approx(0.5, abs=1e-12)


def test_waypoint_speeds_and_pauses_are_uniform_and_independent():
    crowd = Crowd(
        Waypoint(speed=(1.0, 2.0), pause=(10.0, 50.0)), Ground([city_of(100.0)]), [0] * 4, 1000
    )
    crowd.state["user_goal"] += 0.1
    crowd.move()
    speed, pause = crowd.state["user_speed"].ravel(), crowd.state["user_pause"].ravel()
    assert speed.mean() == pytest.approx(1.5, abs=4 / math.sqrt(12 * 4000))
    assert (pause.min(), pause.max()) == pytest.approx((9, 50), abs=1.2)
    assert pause.mean() == pytest.approx(29.1, abs=4 * 40 / math.sqrt(12 * 4000) + 0.1)
    assert abs(np.corrcoef(speed, pause)[0, 1]) < 4 / math.sqrt(4000)


def test_waypoint_legs_are_straight_and_in_view(cities, ground):
    crowd = Crowd(Waypoint(pause=(0.0, 0.0)), ground, [0, 1, 2, 3], 60)
    shares = np.linspace(0, 1, 200)[:, None, None]  # at most 2 m apart
    far = []
    for _ in range(8):
        crowd.move(25.0)
        for world, layout in enumerate(crowd.layout):
            place, goal = crowd.state["users"][world, :, :2], crowd.state["user_goal"][world]
            assert cities[layout].outdoors(place + shares * (goal - place)).all()
            far.append(np.linalg.norm(goal - place, axis=-1).max())
    assert max(far) > 150


def test_waypoint_goals_are_uniform_over_the_ground_in_view():
    """A wall parts the square, and one cell before it is closed.

    On its west 49 by 100 m are left to see.
    """
    crowd = Crowd("waypoint", Ground([city_of(100.0, [[[0, -50, 0], [9, 50, 9]]])]), [0] * 10, 500)
    crowd.state["users"][..., :2] = crowd.state["user_goal"][:] = -30.0, 10.0
    crowd.move(1e-3)
    goals = crowd.state["user_goal"].reshape(-1, 2)
    cells = np.histogram2d(*goals.T, bins=5, range=[(-50, -1), (-50, 50)])[0]
    assert cells.sum() == 5000
    assert ((cells - 200) ** 2 / 200).sum() < 24 + 4 * math.sqrt(48)
    assert np.abs(goals - goals.round()).min() > 1e-6  # none was moved to a cell's side


def test_waypoint_users_who_see_no_place_look_again_after_a_second():
    crowd = Crowd(Waypoint(pause=(0.0, 0.0)), Ground([city_of(300.0, COURTYARD)]), [0], 100)
    crowd.state["users"][..., :2] = crowd.state["user_goal"][:] = 0.5
    crowd.move(0.25)
    assert (crowd.state["user_pause"] == 0.75).mean() > 0.95
    assert (crowd.state["user_velocity"] == 0).mean() > 0.95
    crowd.move(1.0)
    assert (crowd.state["user_pause"] == 0.75).mean() > 0.95


def test_waypoint_share_of_time_at_rest():
    """Pauses of 10 s after legs at 1 m/s, as long as the mean distance of two places in a square.

    That distance is 0.521405 of the side of the square.
    """
    crowd = Crowd(
        Waypoint(speed=(1.0, 1.0), pause=(10.0, 10.0)), Ground([city_of(60.0)]), [0] * 20, 50
    )
    crowd.move(500.0)
    resting = np.empty((100, 20, 50))
    for row in resting:
        crowd.move(10.0)
        row[:] = ~crowd.state["user_velocity"].any(axis=-1)
    means = resting.mean(axis=0).ravel()
    assert means.mean() == pytest.approx(10 / (10 + 60 * 0.521405), abs=4 * standard_error(means))
    assert standard_error(means) < 0.005


# ---- names and options ---------------------------------------------------------------------------


def test_models_by_name_mapping_and_instance():
    assert names("mobility") == ["gauss_markov", "hotspot", "manhattan", "still", "waypoint"]
    for name in names("mobility"):
        model = find_mobility(name)
        assert model.name == name
        assert model == find_mobility({"model": name}) == type(model)()
    own = GaussMarkov(deviation=0.3)
    assert find_mobility({"model": "gauss_markov", "deviation": 0.3}) == own
    assert find_mobility(own) is own
    assert find_mobility(GaussMarkov) == find_mobility({"model": GaussMarkov}) == GaussMarkov()
    path = "bulletuav.network.mobility.gauss_markov:GaussMarkov"
    assert find_mobility({"model": path, "deviation": 0.3}) == own
    assert find_mobility("still").max_speed == 0
    assert find_mobility({"model": "hotspot", "speed": [1, 2]}).max_speed == 2


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("gaus_markov", "unknown mobility model 'gaus_markov': did you mean 'gauss_markov'"),
        (7, "unknown mobility model 7: choose from gauss_markov, hotspot"),
        ({"deviation": 0.3}, "unknown mobility model None"),
        (dict, "unknown mobility model <class 'dict'>"),
        (Walking, "unknown mobility model .*Walking"),
        ("math:pi", "mobility math:pi is 3.14.*: that is no mobility"),
        ({"model": "gauss_markov", "deviatoin": 0.3}, "'deviatoin': did you mean 'deviation'"),
        ({"model": "still", "speed": (1, 2)}, "unknown option of mobility model 'still', 'speed'"),
        ({"model": "waypoint", "speed": (0.0, 1.0)}, "speed is .* above 0"),
        ({"model": "waypoint", "speed": (2.0, 1.0)}, "speed is .* from low to high"),
        ({"model": "waypoint", "speed": (1.0, math.inf)}, "speed is inf"),
        ({"model": "waypoint", "speed": 1.0}, "speed is 1.0: a list or tuple of 2"),
        ({"model": "waypoint", "pause": (-1.0, 1.0)}, "pause is .* at least 0"),
        ({"model": "gauss_markov", "correlation_time": 0}, "correlation_time is 0 s"),
        ({"model": "gauss_markov", "deviation": -0.1}, "deviation is -0.1 m/s"),
        ({"model": "gauss_markov", "deviation": math.nan}, "deviation is nan"),
        ({"model": "manhattan", "turns": (0.5, 0.5, 0.0)}, "turns has 0.0"),
        ({"model": "manhattan", "turns": (0.5, 0.5)}, "turns is .* of 3 values"),
        ({"model": "hotspot", "num_hotspots": 0}, "num_hotspots is 0"),
        ({"model": "hotspot", "drift": (1.0, 0.2)}, "drift is .* from low to high"),
        ({"model": "hotspot", "radius": -1.0}, "radius is -1.0"),
        ({"model": "hotspot", "wobble": "much"}, "wobble is 'much'"),
        ({"model": "hotspot", "turning_time": 0.0}, "turning_time is 0.0 s"),
    ],
)
def test_unknown_and_impossible_options_are_named(source, message):
    with pytest.raises(ValueError, match=message):
        find_mobility(source)
