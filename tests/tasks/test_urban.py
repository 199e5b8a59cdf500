"""Tasks in cities: starts, rewards and ends, what drones sense there, and what flying costs."""

import json
from pathlib import Path

import numpy as np
import pytest
from placing import city_of
from scipy.spatial.distance import pdist

import bulletuav
from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.resolve import resolve
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task
from bulletuav.tasks.families import city_layouts
from bulletuav.tasks.families.city_layouts import ground_cells
from bulletuav.tasks.frame import Spawn
from bulletuav.tasks.targets import share_of
from bulletuav.vehicle.power import airframe_wing, level_power, propulsion_power

URBAN = ("navigation", "lidar_navigation", "los", "coverage", "default")
FLIGHTS = ("navigation", "lidar_navigation")
EXACT = {"dynamics": "single_integrator"}  # flies what it is told, at once
SPEED, PERIOD = 15.0, 0.1  # m/s, s: of all these tasks
RADIUS = 0.27554491  # m, of a hummingbird
UP, EAST, WEST, STAY = (0.0, 0, 1), (1.0, 0, 0), (-1.0, 0, 0), (0.0, 0, 0)

WALL = city_of(((10, -50, 0), (20, 50, 60)))
TOWER = city_of(((-10, -10, 0), (10, 10, 30)))


def placed(task, position, goal=None, users=None):
    """The task, with its drones at rest at `position` (N, 3), m."""
    start = np.array(position, dtype=float)
    memory = {} if users is None else {"users": np.array(users, dtype=float)}

    class Placed(find_task(task)):
        name = "placed"

        def spawn(self, rng):
            to = start + (0.0, -90, 0) if goal is None else np.array(goal, dtype=float)
            return Spawn(position=start, goal=to, layout=self.town.draw(rng), memory=memory)

    return Placed


@pytest.fixture
def make():
    """Builds aviaries, by default small ones, and closes them."""
    made = []

    def one(task, num_worlds=1, **options):
        small = {} if "city" in options or task == "hover" else {"area": 250.0, "num_layouts": 1}
        if task in FLIGHTS:
            small["leg"] = 100.0
        made.append(
            bulletuav.Aviary(task, num_worlds, **{"dynamics": "rigid_body", **small, **options})
        )
        made[-1].reset(seeds=0)
        return made[-1]

    yield one
    for aviary in made:
        aviary.close()


@pytest.fixture
def put(make):
    """Builds aviaries whose drones start at given places."""

    def one(task, city, position, goal=None, users=None, **options):
        more = {"num_drones": len(position), **({} if users is None else {"num_users": len(users)})}
        return make(placed(task, position, goal, users), city=city, **{**EXACT, **more, **options})

    return one


def town(task="navigation", **options):
    """The town of a task, without an engine."""
    return EnvSpec(task, 1, options).task.town


def blocked(start, end, box):
    """Whether the segment from `start` to `end` meets a box (low, high).

    It does where the intervals of its parameter overlap, in which it is within the box on an axis.
    """
    first, last = 0.0, 1.0
    for a, b, low, high in zip(start, end, *box, strict=True):
        if a == b:
            if not low <= a <= high:
                return False
            continue
        near, far = sorted(((low - a) / (b - a), (high - a) / (b - a)))
        first, last = max(first, near), min(last, far)
    return first <= last


# Where they start


@pytest.mark.parametrize("kind", ["suburban", "urban", "high_rise", (0.6, 400.0, 12.0)])
@pytest.mark.parametrize("task", URBAN)
def test_everybody_starts_outdoors_with_room_and_apart(task, kind):
    options = {
        "city": kind,
        "area": 300.0,
        "irregularity": 1.0,
        "num_layouts": 3,
        "num_drones": 5,
        "min_separation": 30.0,
    }
    plan = EnvSpec(task, 1, options | ({"leg": 120.0} if task in FLIGHTS else {}))
    low, high = (20, 60) if task in ("los", "coverage") else (5, 25)
    drawn = set()
    for seed in range(30):
        spawn = plan.task.spawn(np.random.default_rng(seed))
        city = plan.task.town.cities[spawn.layout]
        drawn.add(spawn.layout)
        for places in (spawn.position, spawn.goal):
            assert city.outdoors(places, margin=RADIUS + 1).all()
            assert ((places[:, 2] >= low) & (places[:, 2] <= high)).all()
            assert (np.abs(places[:, :2]) < 150).all()
            assert pdist(places).min() >= 30
        if task in FLIGHTS:
            assert np.linalg.norm(spawn.goal - spawn.position, axis=1).min() >= 120
        if task == "los":
            users = spawn.memory["users"]
            assert city.outdoors(users, margin=0.09).all()
            assert users.shape == (20, 3)
            assert (users[:, 2] == 1.5).all()
    assert drawn == {0, 1, 2}


def test_places_are_spread_over_all_streets_and_heights():
    """Halves of the square, and of the heights, get about as many.

    Of 600 places five standard deviations are 61.
    """
    plan = EnvSpec(
        "los", 1, {"num_drones": 6, "area": 300.0, "num_layouts": 1, "min_separation": 10.0}
    )
    places = np.concatenate(
        [plan.task.spawn(np.random.default_rng(seed)).position for seed in range(100)]
    )
    for axis, middle in enumerate((0.0, 0.0, 40.0)):
        assert 239 < (places[:, axis] > middle).sum() < 361
    assert (np.ptp(places, axis=0) > (280, 280, 38)).all()


def test_every_layout_is_drawn_as_often():
    """Of 1,000 draws 250 each; five standard deviations are 69."""
    one, rng = town(num_layouts=4, area=200.0, leg=50.0), np.random.default_rng(0)
    counts = np.bincount([one.draw(rng) for _ in range(1000)], minlength=4)
    assert (np.abs(counts - 250) < 69).all()


def test_layouts_differ_and_come_from_the_city_seed_alone():
    def boxes(**options):
        return [city.solids.boxes for city in town(area=200.0, leg=50.0, **options).cities]

    mine = boxes(num_layouts=4)
    assert len({one.tobytes() for one in mine}) == 4
    for one, other in zip(mine, boxes(num_layouts=4, seed=9, num_drones=1), strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(mine[1:], boxes(num_layouts=3, city_seed=1), strict=True):
        # `city_seed` is that of the first; the next ones follow.
        np.testing.assert_array_equal(one, other)
    assert not {one.tobytes() for one in mine} & {
        one.tobytes() for one in boxes(num_layouts=4, city_seed=4)
    }


@pytest.mark.parametrize("task", ["lidar_navigation", "los"])
def test_the_same_seed_is_the_same_world_among_however_many(make, task):
    many = make(task, 4, num_layouts=3)
    observations = many.reset(seeds=5)
    one = make(task, 1, num_layouts=3)
    for k in range(4):
        np.testing.assert_array_equal(one.reset(seeds=5 + k)[0], observations[k])
        assert one.scene.layout[0] == many.scene.layout[k]
        np.testing.assert_array_equal(one.scene.goal[0], many.scene.goal[k])
        np.testing.assert_array_equal(one.solids(0).boxes, many.solids(k).boxes)
    assert len(set(many.scene.layout.tolist())) > 1


# What can be a city


def test_a_city_made_by_hand(make):
    aviary = make("default", city=WALL)
    assert aviary.task.town.cities == (WALL,)
    assert aviary.solids(0) is WALL.solids
    np.testing.assert_array_equal(aviary.task.arena_high, (100, 100, 120))
    assert list(aviary.line_of_sight([(0, 0, 10), (0, 70, 10)], [(30, 0, 10), (30, 70, 10)])) == [
        False,
        True,
    ]


def test_a_city_of_ones_own_statistics():
    for numbers in ((0.25, 400.0, 10.0), [0.25, 400.0, 10.0], np.array((0.25, 400.0, 10.0))):
        (city,) = town(city=numbers, area=400.0, num_layouts=1).cities
        assert city.name == "own"
        assert city.coverage == pytest.approx(0.25)
        assert len(city.heights) == 64  # 400 a km^2 on 0.16 km^2


def test_a_city_of_footprints_in_degrees(make, tmp_path):
    """At 60 degrees north a degree of longitude is half as long as one of latitude, 111,195 m."""
    features = []
    for west, south, height in (
        (10.0, 60.0, 12.0),
        (10.0036, 60.0018, 30.0),
    ):  # each 22.2 m x 22.2 m, in two corners
        east, north = west + 0.0004, south + 0.0002
        ring = [(west, south), (east, south), (east, north), (west, north), (west, south)]
        features.append(
            {
                "type": "Feature",
                "properties": {"height": height},
                "geometry": {"type": "Polygon", "coordinates": [ring]},
            }
        )
    path = tmp_path / "corner.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    for source in (path, str(path)):
        aviary = make("los", city=source)
        bounds = aviary.solids(0).bounds
        reach = 0.002 * 111195 / 2
        np.testing.assert_allclose(aviary.task.arena_high, (reach, reach, 120), atol=0.02)
        np.testing.assert_allclose(
            bounds[:, 1] - bounds[:, 0], [(22.24, 22.24, 12), (22.24, 22.24, 30)], atol=0.02
        )
        np.testing.assert_allclose(
            bounds[:, 0, :2], [(-reach, -reach), (reach - 22.24, reach - 22.24)], atol=0.02
        )


@pytest.mark.parametrize("name", ["town.obj", "TOWN.OBJ"])
def test_a_city_of_an_obj_file(tmp_path, name):
    city = generate("urban", 200.0, np.random.default_rng(1))
    write_obj(city, tmp_path / name)
    for source in (tmp_path / name, str(tmp_path / name)):
        (read,) = town(city=source, num_layouts=4, leg=50.0).cities
        assert len(read.heights) == len(city.heights)
        np.testing.assert_allclose(
            read.solids.boxes[:, 1, 2], city.solids.boxes[:, 1, 2], rtol=1e-6
        )


REFUSED = [
    ({"city": "urbn"}, "unknown kind of city 'urbn': did you mean 'urban'"),
    ({"city": "town.stl"}, "town.stl"),
    ({"city": Path("town.stl")}, "town.stl"),
    ({"city": None}, "city is None"),
    ({"city": 5}, "city is 5"),
    ({"city": (0.3, 500.0)}, r"city is \(0.3, 500.0\): .* of 3 values"),
    ({"city": (1.5, 500.0, 15.0)}, "alpha is 1.5: .* between 0 and 1"),
    ({"city": (0.3, float("nan"), 15.0)}, "beta is nan"),
    ({"city": city_of(side=3.0)}, "no street 8.21 m wide"),
    ({"city": city_of(((-100, -100, 0), (100, 100, 10)))}, "'hand' has no street"),
    ({"city": (0.97, 2000.0, 10.0)}, "no street"),
    ({"area": 0.0}, "side is 0.0 m: two blocks need"),
    ({"area": "x"}, "area is 'x'"),
    ({"area": float("nan")}, "area is nan"),
    ({"irregularity": 1.5}, "irregularity is 1.5: .* 0 .* to 1"),
    ({"irregularity": -0.5}, "irregularity is -0.5"),
    ({"num_layouts": 0}, "num_layouts is 0: a whole number, at least 1"),
    ({"city_seed": -1}, "city_seed is -1: a whole number, at least 0"),
    ({"height": (30.0, 20.0)}, r"height is \(30.0, 20.0\): from low to high"),
    (
        {"height": (0.2, 20.0)},
        r"height is \(0.2, 20.0\).*0.276 m, where a drone touches the ground",
    ),
    ({"height": (20.0, 120.0)}, r"height is \(20.0, 120.0\).*ceiling 120 m"),
    ({"height": (float("nan"), 20.0)}, "height is nan"),
    ({"height": 5.0}, "height is 5.0: a list or tuple of 2"),
    ({"ceiling": 2000.0}, "2000 m up"),
    # Starts that could overlap are refused at construction.
    ({"min_separation": 0.0}, "min_separation"),
    ({"min_separation": float("inf")}, "min_separation is inf"),
]


@pytest.mark.parametrize(
    ("options", "message"), REFUSED, ids=[str(options) for options, _ in REFUSED]
)
def test_towns_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("default", 1, {"area": 250.0, **options})


@pytest.mark.parametrize("name", ["nowhere.obj", "nowhere.geojson", "nowhere.json"])
def test_a_file_that_is_not_there(name):
    with pytest.raises(FileNotFoundError, match=name):
        town(city=name)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_separation": 300.0}, "3 drones with min_separation 300 m.* side 250 m"),
        (
            {"min_separation": 60.0, "num_drones": 40},
            "40 drones with min_separation 60 m.* side 250 m",
        ),
    ],
)
def test_too_little_room_for_so_many(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("navigation", 1, {"area": 250.0, **options}).task.spawn(np.random.default_rng(0))


def test_where_there_is_room_no_reset_fails_by_bad_luck():
    """In a square of 250 m nearly all starts have goals 150 m away, those in its middle hardly."""
    plan = EnvSpec("navigation", 1, {"area": 250.0, "num_layouts": 1})
    for seed in range(100):
        plan.task.spawn(np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        ("lidar_navigation", {"proximity_range": 0.0}, "proximity_range is 0"),
        (
            "navigation",
            {"area": 250.0, "leg": 400.0},
            "leg is 400 m: less than .* is needed in this city",
        ),
        ("los", {"area": 5000.0}, "area is 5000 m: less than 4096 m"),
        ("los", {"num_users": 0}, "num_users is 0"),
        ("los", {"wanted": 1.5}, "wanted is 1.5"),
        ("coverage", {"wanted": 1.5}, "wanted is 1.5"),
        ("coverage", {"cell": 0.0}, "cell is 0 m: it must be above 0"),
        ("coverage", {"cell": 300.0}, "cell is 300 m: .* at most the side"),
        (
            "coverage",
            {"city": TOWER, "cell": 200.0},
            "cell is 200 m: the middle of no such square .* smaller",
        ),
    ],
)
def test_options_of_the_tasks_that_cannot_be(task, options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec(task, 1, {"area": 250.0, **options})


DIFFICULTIES = {
    "easy": (3, "urban", 0),
    "medium": (5, "urban", 0.5),
    "hard": (8, "dense", 0.5),
    "extreme": (16, "high_rise", 1),
}
"""Number of drones, city and irregularity"""
RANGES = {"easy": (0, 0), "medium": (0.1, 0), "hard": (0.3, 0.01), "extreme": (0.5, 0.05)}
"""Noise of the lidar, m, and share of its beams that are lost"""


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("task", URBAN)
def test_difficulties_are_those_of_the_docstring(task, difficulty):
    options, config = resolve(find_task(task), {"difficulty": difficulty})
    assert (options.num_drones, config.city, config.irregularity) == DIFFICULTIES[difficulty]
    uncertain = options.randomization
    ranges = RANGES[difficulty] if task == "lidar_navigation" else (0, 0)
    assert (uncertain.lidar_noise, uncertain.lidar_dropout) == ranges
    assert bool(uncertain.active) == (difficulty != "easy")
    assert bool(options.turbulence) == (difficulty == "extreme")
    if task == "coverage":
        assert config.min_separation == (50 if difficulty == "extreme" else 100)


# Ends that all have in common


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
@pytest.mark.parametrize(
    ("task", "weight"), list(zip(URBAN, (-200, -200, -10, -10, -10), strict=True))
)
def test_a_wall_ends_the_episode_of_who_flies_into_it(put, task, weight, dynamics):
    aviary = put(task, WALL, [(0, 0, 10), (-50, -20, 30)], dynamics=dynamics)
    for _ in range(30):
        step = aviary.step(np.array([(EAST, STAY)]))
        if not aviary.alive.all():
            break
    assert step.terminated[0].tolist() == [True, False]
    assert not step.truncated.any()
    assert step.info["collision"][0].tolist() == [True, False]
    assert step.info["reward/collision"][0].tolist() == [weight, 0]
    assert not step.info["success"][0, 0] or task in ("los", "coverage")  # which all share
    # At most one decision's 1.5 m before the wall, never through it.
    assert 7.5 < aviary.swarm.position[0, 0, 0] < 10
    aviary.step(np.array([(STAY, STAY)]))
    assert aviary.alive[0].tolist() == [False, True]


@pytest.mark.parametrize("way", [UP, WEST])
@pytest.mark.parametrize(
    ("task", "weight"), list(zip(URBAN, (-50, -50, -10, -10, None), strict=True))
)
def test_leaving_the_city_ends_the_episode(put, task, weight, way):
    """2 m below the ceiling, and as far from the edge: the second decision of 1.5 m is out."""
    options = {"ceiling": 40.0, "height": (5.0, 25.0)}
    aviary = put(task, WALL, [(-98, 0, 38), (-50, -20, 30)], **options)
    step = aviary.step(np.array([(way, STAY)]))
    assert not step.terminated.any()
    step = aviary.step(np.array([(way, STAY)]))
    assert step.terminated[0].tolist() == [True, False]
    assert not step.info["collision"].any()
    if weight is not None:
        assert step.info["reward/out_of_bounds"][0].tolist() == [weight, 0]


# navigation, lidar_navigation, default


@pytest.mark.parametrize("task", FLIGHTS)
def test_flights_reward_progress_and_end_at_the_goal(put, task):
    """From 4.9 m off, 1.5 m a decision: at 1.9 m it is there."""
    aviary = put(task, WALL, [(-30, 0, 10)], goal=[(-25.1, 0, 10)])
    for way, progress in ((EAST, 7.5), (WEST, -7.5), (EAST, 7.5)):
        step = aviary.step(np.array([[way]]))
        assert step.info["reward/progress"][0, 0] == pytest.approx(progress)
        assert step.info["reward/goal"][0, 0] == 0
        assert not step.terminated.any()
    step = aviary.step(np.array([[EAST]]))
    assert step.info["goal_distance"][0, 0] == pytest.approx(1.9)
    assert step.info["reward/goal"][0, 0] == 50
    assert step.info["success"].all()
    assert step.terminated.all()
    assert not step.info["collision"].any()


def test_default_rewards_by_hand(put):
    """Of 30 m to go 1.5 m nearer, all that max_speed makes good: 1 - 0.1 for time.

    Away from the goal it is -1 - 0.1.
    """
    aviary = put("default", WALL, [(-50, 0, 10)], goal=[(-20, 0, 10)])
    for way, reward in ((EAST, 0.9), (WEST, -1.1), (EAST, 0.9), (STAY, -0.1)):
        step = aviary.step(np.array([[way]]))
        assert step.rewards[0, 0] == pytest.approx(reward)
        assert not step.terminated.any()
    for _ in range(15):  # 28.5 - 15 * 1.5 = 6
        step = aviary.step(np.array([[EAST]]))
        assert not step.terminated.any()
    step = aviary.step(np.array([[EAST]]))  # 4.5 m off: within 5
    assert step.rewards[0, 0] == pytest.approx(10 + 1 - 0.1)
    assert step.terminated.all()
    assert step.info["success"].all()


def test_default_is_cut_at_the_horizon(make):
    aviary = make("default", horizon=3, **EXACT)
    for k in range(3):
        step = aviary.step(np.zeros((1, 3, 3)))
        assert step.truncated.all() == (k == 2)
    assert not step.terminated.any()


@pytest.mark.parametrize(("distance", "nearness"), [(4.0, 0.2), (1.0, 0.8), (5.5, 0.0)])
def test_proximity_by_hand(put, distance, nearness):
    aviary = put("lidar_navigation", WALL, [(10 - distance, 0, 10)])
    step = aviary.step(np.array([[STAY]]))
    assert step.info["reward/proximity"][0, 0] == pytest.approx(-nearness, abs=1e-5)
    assert step.rewards[0, 0] == pytest.approx(-nearness, abs=1e-5)


def test_proximity_follows_its_option_and_weight(put):
    aviary = put(
        "lidar_navigation", WALL, [(0, 0, 10)], proximity_range=20.0, weights={"proximity": -3.0}
    )
    assert aviary.step(np.array([[STAY]])).info["reward/proximity"][0, 0] == pytest.approx(
        -1.5, abs=1e-5
    )


def test_ranges_stand_at_their_place_in_the_observation(put):
    """4 m west of a wall: 4 m ahead, 4 / cos(angle) aside, nothing along it and behind."""
    aviary = put("lidar_navigation", WALL, [(6, 0, 10)])
    observation = aviary.reset(seeds=0)[0, 0]
    assert [label.name for label in aviary.observer.labels][7:10] == [
        "charge",
        "beam 0",
        "beam 22.5",
    ]
    ahead = 4 / np.cos(np.radians(22.5 * np.arange(4)))  # 0, 22.5, 45, 67.5 degrees
    ranges = [*ahead, *[60.0] * 9, *ahead[:0:-1]]
    np.testing.assert_allclose(observation[8:], ranges, atol=1e-4)
    for _ in range(3):
        step = aviary.step(np.array([[(0.2, 0.3, 0.1)]]))
        readings = aviary._frame.readings["lidar"][0, 0]
        np.testing.assert_array_equal(step.observations[0, 0, 8:], readings.astype(np.float32))
    assert readings[0] == pytest.approx(4 - 3 * 0.3, abs=1e-4)


def test_goals_lie_far_away_behind_buildings(make):
    aviary = make("navigation", area=500.0, num_layouts=4, leg=150.0, **EXACT)
    way, hidden = [], []
    for seed in range(100):
        aviary.reset(seeds=seed)
        way += list(aviary.first_info()["goal_distance"][0])
        hidden += list(~aviary.line_of_sight(aviary.scene.start[0], aviary.scene.goal[0]))
    assert min(way) >= 150
    assert np.mean(way) > 200
    assert np.mean(hidden) >= 0.5


# los

DRONES = np.array([(-50.0, 0, 10), (-50.0, 40, 10)])
USERS = np.array(
    [(40.0, 0, 1.5), (20.0, 0, 1.5), (-30.0, -20, 1.5), (40.0, -30, 1.5), (30.0, -40, 1.5)]
)
SEEN = np.array([(0, 0, 1, 1, 1), (1, 0, 1, 0, 0)], dtype=bool)
"""At TOWER.

From the second drone to user 0 the line passes x = 10 at y = 13.3, beside the tower; to user 1 at
5.7; to users 3 and 4 it passes x = -10 at 8.9 and 0. From the first drone those pass x = -10 at
-13.3 and -20.
"""


def test_sight_by_hand(put):
    exact = [
        [not blocked(drone, user, TOWER.solids.boxes[0]) for user in USERS] for drone in DRONES
    ]
    np.testing.assert_array_equal(exact, SEEN)
    aviary = put("los", TOWER, DRONES, users=USERS, weights={"served": 2.0})
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(step.info["reward/sight"][0], (0.6, 0.4))
    # Of 5 users each but the second is seen.
    np.testing.assert_allclose(step.info["reward/served"][0], 2 * 0.8)
    np.testing.assert_allclose(step.rewards[0], (2.2, 2.0))
    assert not step.terminated.any()


@pytest.mark.parametrize(("wanted", "success"), [(0.8, True), (0.81, False)])
def test_success_is_to_serve_as_many_as_wanted(put, wanted, success):
    step = put("los", TOWER, DRONES, users=USERS, wanted=wanted).step(np.zeros((1, 2, 3)))
    assert step.info["success"][0].tolist() == [success, success]


def test_targets_are_observed_where_they_are_and_whether_they_are_seen(put):
    aviary = put("los", TOWER, DRONES, users=USERS)
    moved = np.array([(0.0, 0.15, 0), (0.15, 0, 0)])
    for observation, place in (
        (aviary.reset(seeds=0), DRONES),
        (aviary.step(np.array([moved / 1.5])).observations, None),
    ):
        place = DRONES + moved if place is None else place
        told = observation[0, :, -20:].reshape(2, 5, 4)
        np.testing.assert_allclose(told[..., :3], USERS - place[:, None], rtol=1e-6)
        np.testing.assert_array_equal(told[..., 3], SEEN)
    assert aviary.observer.labels[-1].name == "target 5 seen"


def test_who_has_left_sees_nothing_and_serves_nobody(put):
    aviary = put("los", TOWER, DRONES, users=USERS, weights={"served": 1.0}, wanted=0.8)
    while aviary.alive.all():
        step = aviary.step(np.array([[(0, 0, -1.0), STAY]]))  # the first one dives
    assert step.info["collision"][0].tolist() == [True, False]
    step = aviary.step(np.zeros((1, 2, 3)))
    assert step.info["reward/sight"][0].tolist() == [0, 0.4]
    assert step.info["reward/served"][0].tolist() == [0, 0.4]
    assert not step.info["success"].any()
    assert step.rewards[0].tolist() == pytest.approx([0, 0.8])


# coverage


def share_seen(drones, city):
    """Share of the 10 m squares that each drone sees (N,), and that any sees, by `blocked`."""
    middle = np.arange(-95.0, 100, 10)
    low, high = city.solids.boxes[0]
    cells = [
        (x, y, 1.5)
        for x in middle
        for y in middle
        if not (low[0] <= x <= high[0] and low[1] <= y <= high[1])
    ]
    seen = np.array([[not blocked(drone, cell, (low, high)) for cell in cells] for drone in drones])
    return seen.mean(axis=1), seen.any(axis=0).mean(), seen.shape[1]


def test_everything_is_covered_where_nothing_stands(put):
    step = put("coverage", city_of(), [(13.0, 7, 20)]).step(np.zeros((1, 1, 3)))
    assert step.info["reward/covered"][0, 0] == pytest.approx(1)
    assert step.info["success"].all()
    assert step.observations[0, 0, -1] == 1


def test_a_tower_hides_what_lies_behind_it(put):
    drones = [(-60.3, 3.1, 25.7), (-33.7, 62.2, 33.3)]
    own, all_of_them, squares = share_seen(drones, TOWER)
    assert squares == 400 - 4
    assert (own < 0.97).all()
    assert own.max() < all_of_them < 1
    aviary = put("coverage", TOWER, drones, wanted=all_of_them)
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(step.info["reward/covered"][0], all_of_them)
    np.testing.assert_allclose(step.observations[0, :, -1], own, rtol=1e-6)
    alone = put("coverage", TOWER, drones[:1]).step(np.zeros((1, 1, 3)))
    np.testing.assert_allclose(alone.info["reward/covered"][0], own[0])


def test_a_drone_that_left_covers_nothing(put):
    drones = [(-60.3, 3.1, 3.7), (61.7, 2.2, 33.3)]
    aviary = put("coverage", TOWER, drones)
    while aviary.alive.all():
        aviary.step(np.array([[(0, 0, -1.0), STAY]]))
    step = aviary.step(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(
        step.info["reward/covered"][0], (0, share_seen(drones[1:], TOWER)[1])
    )


def test_drones_that_are_near_each_other_all_pay_the_same(put):
    """Three, 42 to 60 m from each other, pay 5 for each of the other two.

    The fourth is 120 m away from all.
    """
    drones = [(-90, -50, 3), (-60, -20, 40), (-90, 10, 40), (70, -20, 40)]
    assert (pdist(drones[:3]) < 100).all()
    aviary = put("coverage", TOWER, drones)
    step = aviary.step(np.zeros((1, 4, 3)))
    assert step.info["reward/close"][0].tolist() == [-10, -10, -10, 0]
    while aviary.alive.all():
        aviary.step(np.array([[(0, 0, -1.0), STAY, STAY, STAY]]))
    step = aviary.step(np.zeros((1, 4, 3)))
    assert step.info["reward/close"][0].tolist() == [0, -5, -5, 0]


@pytest.fixture
def unequal(monkeypatch):
    """Two layouts, with 256 and 396 squares outdoors.

    The drones see the first square, which fills up the shorter list.
    """
    block = city_of(((-60, -60, 0), (60, 60, 30)))
    monkeypatch.setattr(city_layouts, "make_cities", lambda config: (block, TOWER))
    assert [len(ground_cells(city, 10.0)) for city in (block, TOWER)] == [256, 396]
    return [(-80.3, -3.1, 25.7)], (block, TOWER)


def test_layouts_of_unequal_size_count_their_own_squares(put, unequal):
    drones, cities = unequal
    aviary = put("coverage", None, drones)
    for layout in (0, 1):
        seed = next(
            k
            for k in range(20)
            if aviary.reset(seeds=k) is not None and aviary.scene.layout[0] == layout
        )
        aviary.reset(seeds=seed)
        step = aviary.step(np.zeros((1, 1, 3)))
        np.testing.assert_allclose(
            step.info["reward/covered"][0], share_seen(drones, cities[layout])[1]
        )


def test_the_share_that_a_drone_sees_is_that_of_the_squares_there_are(put, unequal):
    drones, cities = unequal
    aviary = put("coverage", None, drones)
    for seed in range(10):
        observation = aviary.reset(seeds=seed)
        own = share_seen(drones, cities[aviary.scene.layout[0]])[0]
        np.testing.assert_allclose(observation[0, :, -1], own, rtol=1e-6)


# Batteries


def hover_power(gravity=9.80665):
    """Of a hummingbird, W."""
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"), gravity)
    return wing.blade + wing.induced


def test_power_in_hover_is_that_of_the_formula(put):
    aviary = put("los", WALL, DRONES, users=USERS)
    assert (aviary.first_info()["power"] == 0).all()
    np.testing.assert_allclose(
        aviary.step(np.zeros((1, 2, 3))).info["power"], hover_power(), rtol=1e-12
    )


def test_wind_counts(put):
    """At rest in wind of 6 m/s from the side costs what flying at 6 m/s costs in calm air."""
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"))
    windy = (
        put("los", WALL, DRONES, users=USERS, wind=(0.0, 6.0, 0.0))
        .step(np.zeros((1, 2, 3)))
        .info["power"]
    )
    np.testing.assert_allclose(windy, sum(level_power(6.0, wing)), rtol=1e-12)
    with_it = put("los", WALL, DRONES, users=USERS, wind=(0.0, 6.0, 0.0))
    for _ in range(2):  # the mean of the speeds before and after counts
        power = with_it.step(np.full((1, 2, 3), (0.0, 6 / SPEED, 0.0))).info["power"]
    np.testing.assert_allclose(power, hover_power(), rtol=1e-9)


@pytest.mark.parametrize("horizon", [300, 5])
def test_an_empty_battery_ends_the_episode_then_and_only_then(put, horizon):
    """4.5 decisions of hover: the fifth empties it.

    The other drone flies at 7.5 m/s, which takes less, and goes on.
    """
    wing = airframe_wing(bulletuav.load_airframe("hummingbird"))
    flying = propulsion_power((7.5, 0.0, 0.0), wing)
    mean = propulsion_power((3.75, 0.0, 0.0), wing)  # of the first decision, from rest
    np.testing.assert_allclose((mean, flying), np.array((0.867, 0.635)) * hover_power(), rtol=1e-3)
    energy = 4.5 * PERIOD * hover_power()  # J
    aviary = put("los", WALL, DRONES, users=USERS, battery_capacity=energy / 3600, horizon=horizon)
    used, charge = np.zeros(2), [label.name for label in aviary.observer.labels].index("charge")
    for k in range(1, 6):
        step = aviary.step(np.array([(STAY, (0, -0.5, 0))]))
        np.testing.assert_allclose(
            step.info["power"][0], (hover_power(), mean if k == 1 else flying), rtol=1e-9
        )
        used += step.info["power"][0] * PERIOD
        np.testing.assert_allclose(
            step.info["charge"][0], np.maximum(1 - used / energy, 0), atol=1e-12
        )
        if aviary.alive.all():
            np.testing.assert_array_equal(
                step.observations[0, :, charge], step.info["charge"][0].astype(np.float32)
            )
        assert step.terminated[0].tolist() == [k == 5, False]
        assert step.truncated[0].tolist() == [False, horizon == k]
    assert not step.info["collision"].any()
    if horizon == 5:
        return
    for k in (6, 7):  # 0.87 + 0.63 (k - 1) times hover's comes to 4.04, then to 4.68
        step = aviary.step(np.array([(STAY, (0, -0.5, 0))]))
        assert step.terminated[0].tolist() == [False, k == 7]
    assert (aviary.reset(seeds=0)[0, :, charge] == 1).all()
    assert not aviary.step(np.zeros((1, 2, 3))).terminated.any()


def test_without_a_capacity_batteries_never_empty(put):
    aviary = put("los", WALL, DRONES, users=USERS, battery_capacity=None)
    assert (aviary.step(np.zeros((1, 2, 3))).info["charge"] == 1).all()


def test_what_flying_costs_is_drained_of_worlds_that_fly_alone(make):
    aviary = make("los", 2, battery_capacity=0.1, **EXACT)
    for _ in range(3):
        aviary.step(np.zeros((2, 3, 3)))
    aviary.reset(np.array([False, True]))
    charge = aviary.step(np.zeros((2, 3, 3))).info["charge"]
    spent = hover_power() * PERIOD / 360
    np.testing.assert_allclose(1 - charge, np.array([[4 * spent] * 3, [spent] * 3]))


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_power_of_the_rotors(make, dynamics):
    """In hover it is torque times speed, k_m w^3, of four rotors; the formula is of its order."""
    options = {
        "airframe": "hummingbird",
        "action": "hover_rpm",
        "effects": (),
        "battery_capacity": 1.0,
    }
    aviary = make(
        "hover", energy="actuator", dynamics=dynamics, observation=("battery",), **options
    )
    airframe = aviary.options.airframe[0]
    expected = 4 * airframe.thrust_coefficient * airframe.torque_ratio * airframe.hover_speed() ** 3
    for k in range(1, 4):
        step = aviary.step(np.zeros(aviary.action.low.shape)[None])
        assert step.info["power"][0, 0] == pytest.approx(expected, rel=1e-6)
        assert step.observations[0, 0, 0] == pytest.approx(1 - k * expected / 30 / 3600, rel=1e-6)
    assert 0.5 < expected / hover_power() < 2


@pytest.mark.parametrize("dynamics", ["point_mass", "double_integrator", "single_integrator"])
def test_dynamics_without_rotors_know_no_power_of_rotors(dynamics):
    with pytest.raises(
        ValueError,
        match=f"energy is 'actuator', and dynamics '{dynamics}' has no rotors: use 'zeng'",
    ):
        bulletuav.Aviary("los", city=WALL, dynamics=dynamics, energy="actuator")


@pytest.mark.parametrize("energy", ["zeng", "actuator"])
def test_power_without_gravity_is_that_of_the_rotors(make, energy):
    """Rotors at rest take nothing; at full speed, from one decision to the next, 4 k_m w^3."""
    aviary = make(
        "hover", gravity=0.0, action="rotor", effects=(), energy=energy, battery_capacity=1.0
    )
    step = aviary.step(np.full((1, 1, 4), -1.0))
    assert step.info["power"][0, 0] == 0
    assert step.info["charge"][0, 0] == 1
    aviary.step(np.ones((1, 1, 4)))
    airframe = aviary.options.airframe[0]
    expected = 4 * airframe.thrust_coefficient * airframe.torque_ratio * airframe.max_rotor_speed**3
    assert aviary.step(np.ones((1, 1, 4))).info["power"][0, 0] == pytest.approx(expected, rel=1e-6)


# Options of sensors and batteries


NAN = float("nan")
BAD = [
    *(
        ({"num_beams": value}, f"num_beams is {value!r}: a whole number, at least 1")
        for value in (0, -1, 2.5, NAN, "x", None)
    ),
    *(
        ({"max_range": value}, f"max_range is {value:g} m: it must be above 0")
        for value in (0, -1.0)
    ),
    *(
        ({"max_range": value}, f"max_range is {value!r}: a finite number")
        for value in (NAN, float("inf"), "x", None)
    ),
    ({"lidar_elevations": ()}, "lidar_elevations is empty: give at least one"),
    ({"lidar_elevations": 30.0}, "lidar_elevations is 30.0: a list or tuple"),
    ({"lidar_elevations": (0.0, 91.0)}, "lidar_elevations has 91 degrees: from -90"),
    ({"lidar_elevations": (-91.0,)}, "lidar_elevations has -91 degrees"),
    ({"lidar_elevations": (0.0, NAN)}, "lidar_elevations is nan"),
    ({"lidar_elevations": ("x",)}, "lidar_elevations is 'x'"),
    ({"lidar_frame": "yw"}, "unknown lidar_frame 'yw': did you mean 'yaw'"),
    ({"lidar_frame": "body"}, "unknown lidar_frame 'body': choose from world, yaw"),
    ({"lidar_frame": ""}, "unknown lidar_frame ''"),
    *(
        ({"battery_capacity": value}, f"battery_capacity is {value:g} W h: it must be above 0")
        for value in (0, -1.0)
    ),
    *(
        ({"battery_capacity": value}, f"battery_capacity is {value!r}: a finite number")
        for value in (NAN, "x")
    ),
    ({"energy": "zen"}, "unknown energy 'zen': did you mean 'zeng'"),
    ({"energy": ""}, "unknown energy ''"),
    ({"observation": ("lidr",)}, "did you mean 'lidar'"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=[str(options) for options, _ in BAD])
def test_options_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("lidar_navigation", 1, {"city": WALL, **options})


def test_beams_are_as_many_and_as_high_as_asked_for(put):
    """10 m up and 5 m before the wall: two beams at each of three elevations.

    The lower ones end on the ground.
    """
    options = {"num_beams": 2, "lidar_elevations": (0.0, 30.0, -30.0), "max_range": 25.0}
    aviary = put("lidar_navigation", WALL, [(5, 0, 10)], **options)
    ahead = 5 / np.cos(np.radians(30))
    expected = (5, 25, ahead, 25, ahead, 20)  # ahead, behind; 10 m down at 30 degrees are 20 m
    np.testing.assert_allclose(aviary.reset(seeds=0)[0, 0, 8:], expected, atol=1e-4)
    names = [
        "beam 0",
        "beam 180",
        "beam 0 up 30",
        "beam 180 up 30",
        "beam 0 up -30",
        "beam 180 up -30",
    ]
    assert [label.name for label in aviary.observer.labels[8:]] == names
    assert {label.high for label in aviary.observer.labels[8:]} == {25.0}


@pytest.mark.parametrize(("frame", "expected"), [("yaw", 60.0), ("world", 5.0)])
def test_beams_turn_with_the_nose_or_do_not(put, frame, expected):
    aviary = put(
        "lidar_navigation",
        WALL,
        [(5, 0, 10)],
        lidar_frame=frame,
        action="attitude",
        dynamics="rigid_body",
    )
    half = np.pi / 4  # of a turn to the north
    aviary.swarm.quaternion[0, 0] = (0, 0, np.sin(half), np.cos(half))
    ranges = aviary._measure(aviary.swarm, aviary.swarm, aviary.alive)["lidar"][0, 0]
    assert ranges[0] == pytest.approx(expected, abs=1e-4)
    # 270 degrees to the left.
    assert ranges[12 if frame == "yaw" else 0] == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize(
    ("task", "observation", "read"),
    [
        ("hover", None, set()),
        ("hover", ("lidar", "position"), {"lidar"}),
        ("hover", ("imu", "clearance"), {"imu", "clearance"}),
        ("hover", ("ray_depth",), {"ray_depth"}),
        ("default", None, {"lidar", "charge"}),
        ("lidar_navigation", ("goal",), {"lidar"}),  # whose reward needs it
        ("los", ("goal",), {"sight"}),
        ("navigation", ("goal", "battery"), {"charge"}),
    ],
)
def test_readings_hold_what_was_asked_for(make, task, observation, read):
    """Charge, power and sight are always there; sight is empty for tasks without targets."""
    aviary = make(task, **({} if observation is None else {"observation": observation}))
    for _ in range(2):
        readings = aviary._frame.readings
        always = {"charge", "power", "sight"}
        assert read - always == set(readings) - always
        assert read <= set(readings)
        assert readings["sight"].size == aviary.num_drones * aviary.task.num_targets
        aviary.step(np.zeros((1, aviary.num_drones, aviary.action.low.shape[-1])))


# Faces


def rolled(task, workers):
    """Everything that comes out of a rollout over two episodes of random flight."""
    options = {
        "area": 250.0,
        "num_layouts": 2,
        "dynamics": "rigid_body",
        "difficulty": "medium",
        "num_drones": 2,
    }
    options |= {"horizon": 5, "seed": 3} | ({"leg": 100.0} if task in FLIGHTS else {})
    env = bulletuav.batch_env(task, 3, workers=workers, **options)
    rng, rows = np.random.default_rng(0), [env.reset()]
    for _ in range(11):
        *arrays, infos = env.step(rng.uniform(-1, 1, (3, 2, 3)))
        rows.append(
            (np.concatenate([np.asarray(array, dtype=float).ravel() for array in arrays]), infos)
        )
    env.close()
    return rows


@pytest.mark.parametrize("task", ["lidar_navigation", "los"])
def test_the_number_of_processes_changes_no_bit(task):
    in_one, in_two = rolled(task, 1), rolled(task, 2)
    for (mine, my_infos), (theirs, their_infos) in zip(in_one, in_two, strict=True):
        np.testing.assert_array_equal(mine, theirs)
        assert set(my_infos) == set(their_infos)
        for name, info in my_infos.items():
            np.testing.assert_array_equal(info, their_infos[name])
    assert len({row[0].tobytes() for row in in_one}) == len(in_one)


def test_a_reset_of_one_world_leaves_what_others_sense_untouched(make):
    """Ranges are noisy: a second scan would differ."""
    options = {"difficulty": "medium", "num_layouts": 3, "num_drones": 3}
    env = bulletuav.batch_env(
        "lidar_navigation",
        3,
        autoreset_mode="Disabled",
        area=250.0,
        leg=100.0,
        dynamics="rigid_body",
        **options,
    )
    env.reset(seed=0)
    before = env.step(np.zeros((3, 3, 3)))[0]
    ranges = env.aviary._frame.readings["lidar"].copy()
    assert (ranges < 60).any(axis=(1, 2)).all()
    after = env.reset(options={"reset_mask": np.array([False, True, False])})[0]
    now = env.aviary._frame.readings["lidar"]
    for w, same in enumerate((True, False, True)):
        assert (ranges[w].tobytes() == now[w].tobytes()) == same
        assert (before[w].tobytes() == after[w].tobytes()) == same
    env.close()


# Who knows the city


@pytest.mark.parametrize("action", ["velocity", "velocity_increment"])
def test_the_planner_brings_everybody_to_the_goal(make, action):
    """Five worlds, and then other goals and cities in each of them, to which it plans again."""
    aviary = make("navigation", 5, num_drones=2, num_layouts=2, action=action)
    policy, layouts = find_policy("planner")(aviary), []
    for seed in (10, 20):
        observations = aviary.reset(seeds=seed)
        policy.reset(np.ones(5, dtype=bool))
        layouts.append(aviary.scene.layout.copy())
        reached, crashed = np.zeros((2, 5, 2), dtype=bool)
        straight = aviary.line_of_sight(
            aviary.scene.start[:, 0], aviary.scene.goal[:, 0], np.arange(5)
        )
        while aviary.alive.any():
            step = aviary.step(policy.act(observations, aviary.swarm))
            observations = step.observations
            reached |= step.info["success"]
            crashed |= step.info["collision"]
        assert not crashed.any()
        assert reached.all()
        assert not straight.all()  # there was something to fly around
    assert (layouts[0] != layouts[1]).any()


def test_everything_seen_is_all_of_it_exactly():
    """644 squares: 644 times 1 / 644 would be less than 1."""
    task = EnvSpec("coverage", 1, {"area": 300.0, "num_layouts": 1, "wanted": 1.0}).task
    everything = np.ones((1, task.num_targets), dtype=bool)
    nothing = np.zeros_like(everything)
    assert share_of(everything, everything).tolist() == [1.0]
    assert share_of(everything, nothing).tolist() == [0.0]


def test_an_empty_battery_ends_the_episode_for_the_task_too():
    """Shaping counts no potential after an end: it is then the whole way before."""
    options = {
        "weights": {"shaping": 1.0},
        "area": 250.0,
        "leg": 100.0,
        "dynamics": "point_mass",
        "num_layouts": 1,
    }
    aviary = bulletuav.Aviary("navigation", battery_capacity=1e-4, **options)
    aviary.reset(seeds=0)
    way = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
    step = aviary.step(np.zeros((1, 3, 3)))
    assert step.terminated.all()
    np.testing.assert_allclose(step.info["reward/shaping"], way, rtol=1e-9)
    aviary.close()


@pytest.mark.parametrize("task", ["los", "coverage"])
def test_infos_tell_what_is_served(task):
    options = {
        "num_drones": 2,
        "area": 250.0,
        "num_layouts": 1,
        "dynamics": "point_mass",
        "min_separation": 20.0,
    }
    aviary = bulletuav.Aviary(task, 2, **options)
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((2, 2, 3)))
    seen = aviary._frame.readings["sight"].any(axis=1)
    np.testing.assert_allclose(
        step.info["served"], np.repeat(seen.mean(axis=-1)[:, None], 2, axis=1)
    )
    assert 0 < step.info["served"].min() < 1
    aviary.close()
