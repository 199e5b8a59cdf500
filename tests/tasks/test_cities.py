"""Cities of tasks: what can be one, and where drones start in it."""

import json
from pathlib import Path

import numpy as np
import pytest
from placing import city_of
from scipy.spatial.distance import pdist
from urban import FLIGHTS, RADIUS, TOWER, URBAN, WALL, town

from bulletuav.city.exports import write_obj
from bulletuav.city.generator import generate
from bulletuav.city.model import City
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.envs.resolve_options import resolve_options
from bulletuav.tasks import find_task


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
    low, high = (20, 45) if task in ("los", "coverage") else (5, 12)
    drawn = set()
    for seed in range(30):
        spawn = plan.task.spawn(np.random.default_rng(seed))
        city = plan.task.city_layouts.cities[spawn.layout]
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
        "los",
        1,
        {
            "num_drones": 6,
            "city": "urban",
            "area": 300.0,
            "num_layouts": 1,
            "height": (20.0, 60.0),
            "ceiling": 70.0,
            "min_separation": 10.0,
        },
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


def test_cities_of_one_kind_are_shared_and_nobody_writes_into_them():
    """What one environment did to them another would feel."""
    one, other = (town(area=200.0, leg=50.0, num_layouts=2) for _ in range(2))
    assert all(mine is yours for mine, yours in zip(one.cities, other.cities, strict=True))
    assert town(area=200.0, leg=50.0, irregularity=0.5).cities[0] is not one.cities[0]
    city = one.cities[0]
    streets = city.streets
    for array in (city.solids.boxes, city.building, streets.nodes, streets.edges, one._raster[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@pytest.mark.parametrize("task", ["lidar_navigation", "los"])
def test_the_same_seed_is_the_same_world_among_however_many(make_urban, task):
    many = make_urban(task, 4, num_layouts=3)
    observations = many.reset(seeds=5)
    one = make_urban(task, 1, num_layouts=3)
    for k in range(4):
        np.testing.assert_array_equal(one.reset(seeds=5 + k)[0], observations[k])
        assert one.scene.layout[0] == many.scene.layout[k]
        np.testing.assert_array_equal(one.scene.goal[0], many.scene.goal[k])
        np.testing.assert_array_equal(one.solids(0).boxes, many.solids(k).boxes)
    assert len(set(many.scene.layout.tolist())) > 1


def test_a_city_made_by_hand(make_urban):
    aviary = make_urban("default", city=WALL)
    assert aviary.task.city_layouts.cities == (WALL,)
    assert aviary.solids(0) is WALL.solids
    np.testing.assert_array_equal(aviary.task.arena_high, (100, 100, 15))
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


def test_a_city_of_footprints_in_degrees(make_urban, tmp_path):
    """At 60 degrees north a degree of longitude is 55,798 m long, one of latitude 111,412 m.

    Lengths of WGS-84, from the series that `tests/earth/test_geodesy.py` has.
    """
    features = []
    for west, south, height in (
        (10.0, 60.0, 12.0),
        (10.0036, 60.0018, 30.0),
    ):  # each 22.3 m x 22.3 m, in two corners
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
        aviary = make_urban("los", city=source)
        bounds = aviary.solids(0).bounds
        east, north = 0.004 * 55798.3 / 2, 0.002 * 111412.3 / 2
        np.testing.assert_allclose(aviary.task.arena_high, (east, east, 50), atol=1e-3)
        wide, deep = east / 5, north / 5
        np.testing.assert_allclose(
            bounds[:, 1] - bounds[:, 0], [(wide, deep, 12), (wide, deep, 30)], atol=1e-3
        )
        np.testing.assert_allclose(
            bounds[:, 0, :2], [(-east, -north), (east - wide, north - deep)], atol=1e-3
        )


@pytest.mark.parametrize("name", ["town.obj", "TOWN.OBJ"])
def test_a_city_of_an_obj_file(tmp_path, name):
    city = generate("urban", 200.0, np.random.default_rng(1))
    write_obj(city, tmp_path / name)
    for source in (tmp_path / name, str(tmp_path / name)):
        (read,) = town(city=source, leg=50.0).cities
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
    ({"city": city_of(side=3.0)}, "min_separation is 20 m: less than 15.59 m"),
    ({"city": city_of(((-100, -100, 0), (100, 100, 10)))}, "'hand' has no street"),
    ({"city": (0.97, 2000.0, 10.0)}, "no street"),
    ({"area": 0}, "area is 0 m: it must be above 0"),
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
    ({"height": (20.0, 120.0)}, r"height is \(20.0, 120.0\).*ceiling 15 m"),
    ({"height": (float("nan"), 20.0)}, "height is nan"),
    ({"height": 5.0}, "height is 5.0: a list or tuple of 2"),
    ({"ceiling": 2000.0}, "2000 m up"),
    # Starts that could overlap are refused at construction.
    ({"min_separation": 0.0}, "min_separation"),
    ({"min_separation": float("inf")}, "min_separation is inf"),
]


def with_area(options):
    """Add a smaller area, which complete cities do not take."""
    return options if isinstance(options.get("city"), City) else {"area": 250.0, **options}


@pytest.mark.parametrize(
    ("options", "message"), REFUSED, ids=[str(options) for options, _ in REFUSED]
)
def test_towns_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("default", 1, with_area(options))


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
        EnvSpec("navigation", 1, {"area": 250.0, "leg": 150.0, **options}).task.spawn(
            np.random.default_rng(0)
        )


def test_where_there_is_room_no_reset_fails_by_bad_luck():
    """In a square of 250 m nearly all starts have goals 150 m away, those in its middle hardly."""
    plan = EnvSpec("navigation", 1, {"area": 250.0, "num_layouts": 1, "leg": 150.0})
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
            "cell is 200 m: no such square .* smaller",
        ),
    ],
)
def test_options_of_the_tasks_that_cannot_be(task, options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec(task, 1, with_area(options))


DIFFICULTIES = {
    "easy": (3, "urban", 0),
    "medium": (5, "urban", 0.5),
    "hard": (8, "dense", 0.5),
    "extreme": (16, "high_rise", 1),
}
"""Number of drones, city and irregularity of flights"""
SERVICES = {
    "easy": (3, "dense", 0),
    "medium": (4, "dense", 0.5),
    "hard": (5, "dense", 0.5),
    "extreme": (6, "high_rise", 1),
}
"""The same of services, whose drones see much of a city from few places"""
RANGES = {"easy": (0, 0), "medium": (0.1, 0), "hard": (0.3, 0.01), "extreme": (0.5, 0.05)}
"""Noise of the lidar, m, and share of its beams that are lost"""


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("task", URBAN)
def test_difficulties_are_those_of_the_docstring(task, difficulty):
    options, config, _ = resolve_options(find_task(task), {"difficulty": difficulty})
    expected = (SERVICES if task in ("los", "coverage") else DIFFICULTIES)[difficulty]
    assert (options.num_drones, config.city, config.irregularity) == expected
    uncertain = options.randomization
    ranges = RANGES[difficulty] if task == "lidar_navigation" else (0, 0)
    given = uncertain.ranges
    assert (given.get("lidar_noise", 0), given.get("lidar_dropout", 0)) == ranges
    assert bool(uncertain.active) == (difficulty != "easy")
    assert bool(options.turbulence) == (difficulty == "extreme")
    if task == "coverage":
        assert config.min_separation == 100
