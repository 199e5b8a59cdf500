"""Users on the ground: where they are, and how they walk."""

import numpy as np
import pytest
from placing import OPEN, SMALL, WALL, fly

import bulletuav
from bulletuav.envs.env_spec import EnvSpec
from bulletuav.network.mobility.gauss_markov import GaussMarkov
from bulletuav.network.mobility.waypoint import Waypoint
from bulletuav.registry import names

FASTEST = {"still": 0.0, "gauss_markov": 5.0, "manhattan": 3.0, "hotspot": 3.0, "waypoint": 3.0}
"""m/s, by the defaults: walks of 0.5 to 3 m/s, of Gauss-Markov 4 deviations of 0.5 m/s more"""
EAST, WEST, NORTH, SOUTH = (1.0, 0, 0), (-1.0, 0, 0), (0, 1.0, 0), (0, -1.0, 0)
UP, DOWN, STAY = (0, 0, 1.0), (0, 0, -1.0), (0.0, 0, 0)


@pytest.mark.parametrize("task", ["los", "mobile_users", "mec", "mec_advanced"])
@pytest.mark.parametrize("mobility", names("mobility"))
def test_users_start_outdoors(task, mobility):
    kind = {"city": "dense", "irregularity": 1.0, "area": 250.0, "num_layouts": 2, "num_users": 40}
    one, drawn = EnvSpec(task, 1, {**kind, "mobility": mobility}).task, set()
    for seed in range(10):
        spawn = one.spawn(np.random.default_rng(seed))
        users = spawn.memory["users"]
        drawn.add(spawn.layout)
        assert one.city_layouts.cities[spawn.layout].outdoors(users).all()
        assert users.shape == (40, 3)
        assert (np.abs(users[:, :2]) <= 125).all()
        assert (np.ptp(users[:, :2], axis=0) > 100).all()  # all over the place
        assert (users[:, 2] == 1.5).all()
    assert drawn == {0, 1}


@pytest.mark.parametrize("hz", [1, 5])
@pytest.mark.parametrize("mobility", names("mobility"))
def test_users_walk_whole_episodes_outdoors_and_no_faster_than_they_can(make, mobility, hz):
    aviary = make(
        "mobile_users",
        2,
        mobility=mobility,
        decision_hz=hz,
        horizon=100 * hz,
        num_users=30,
        num_drones=1,
    )
    city, places = aviary.task.city_layouts.cities[0], [aviary.scene.memory["users"].copy()]
    while aviary.alive.any():
        fly(aviary, STAY)
        places.append(aviary.scene.memory["users"].copy())
    users, way = np.array(places), np.linalg.norm(np.diff(places, axis=0), axis=-1)
    assert len(users) == 1 + 100 * hz
    assert city.outdoors(users).all()
    assert (np.abs(users[..., :2]) <= 125 + 1e-9).all()
    assert (users[..., 2] == 1.5).all()
    assert way.max() <= FASTEST[mobility] / hz + 1e-9
    assert (np.median(way.sum(axis=0)) > 40) == (mobility != "still")
    fly(aviary, STAY)  # all worlds are over: nobody walks on
    np.testing.assert_array_equal(aviary.scene.memory["users"], users[-1])


@pytest.mark.parametrize("mobility", names("mobility"))
def test_users_of_a_world_know_nothing_of_others(make, mobility):
    many, one = (
        make("mobile_users", worlds, mobility=mobility, num_layouts=2) for worlds in (4, 1)
    )
    rng = np.random.default_rng(0)
    for seed in (20, 40):
        many.reset(seeds=seed)
        one.reset(seeds=seed + 2)
        for k in range(12):
            actions = rng.uniform(-1, 1, (4, 3, 3))
            actions[0] = DOWN  # which ends soon
            if k == 6:
                many.reset(np.array([True, False, False, True]))
            mine, alone = many.step(actions), one.step(actions[2:3])
            np.testing.assert_array_equal(
                many.scene.memory["users"][2], one.scene.memory["users"][0]
            )
            np.testing.assert_array_equal(mine.rewards[2], alone.rewards[0])
            np.testing.assert_array_equal(mine.observations[2], alone.observations[0])
        others = many.scene.memory["users"]
        assert not (others[1] == others[2]).all()


@pytest.mark.parametrize("mobility", names("mobility"))
def test_the_same_seed_is_the_same_episode_after_others_too(make, mobility):
    aviary, episodes = make("mobile_users", mobility=mobility), []
    for seed in (3, 4, 3):
        rows, rng = [aviary.reset(seeds=seed)], np.random.default_rng(1)
        for _ in range(8):
            step = aviary.step(rng.uniform(-1, 1, (1, 3, 3)))
            rows += [step.observations, step.rewards, aviary.scene.memory["users"].copy()]
        episodes.append(b"".join(row.tobytes() for row in rows))
    assert episodes[0] == episodes[2] != episodes[1]


def test_ways_of_walking_by_name_by_dict_and_ready_made(make):
    def walked(mobility):
        aviary = make("mobile_users", mobility=mobility)
        for _ in range(5):
            fly(aviary, STAY)
        return aviary.scene.memory["users"].tobytes()

    assert walked("waypoint") == walked({"model": "waypoint"}) == walked(Waypoint())
    brisk = {"model": "waypoint", "pause": (0.0, 0.0), "speed": (3.0, 3.0)}
    assert (
        walked(brisk) == walked(Waypoint(pause=(0.0, 0.0), speed=(3.0, 3.0))) != walked("waypoint")
    )
    assert walked({"model": "gauss_markov", "deviation": 0.0}) == walked(GaussMarkov(deviation=0.0))


def test_evaluations_take_ways_of_walking_ready_made():
    options = {"horizon": 3, **SMALL}
    made = bulletuav.evaluate(
        "mobile_users", "random", 2, mobility=Waypoint(speed=(3.0, 3.0)), **options
    )
    told = bulletuav.evaluate(
        "mobile_users", "random", 2, mobility={"model": "waypoint", "speed": (3.0, 3.0)}, **options
    )
    assert made.rows == told.rows


def test_options_of_walking_count(make):
    """Users of 2 m/s on streets are 2 m further, or round a corner, after a second."""
    aviary = make(
        "mobile_users", mobility={"model": "manhattan", "speed": (2.0, 2.0)}, num_users=50
    )
    before = aviary.scene.memory["users"].copy()
    fly(aviary, STAY)
    way = np.linalg.norm(aviary.scene.memory["users"] - before, axis=-1)
    assert way.max() == pytest.approx(2.0)
    assert np.median(way) == pytest.approx(2.0)


BAD = [
    ({"mobility": "manhatan"}, "unknown mobility model 'manhatan': did you mean 'manhattan'"),
    (
        {"mobility": {"model": "waypont"}},
        "unknown mobility model 'waypont': did you mean 'waypoint'",
    ),
    (
        {"mobility": {"pause": (0, 5)}},
        "unknown mobility model None: choose from gauss_markov, hotspot, manhattan, still",
    ),
    ({"mobility": 5}, "unknown mobility model 5"),
    (
        {"mobility": {"model": "waypoint", "pauses": (0, 5)}},
        "unknown option of mobility model 'waypoint'.*did you mean 'pause'",
    ),
    (
        {"mobility": {"model": "waypoint", "pause": (5, 0)}},
        r"pause is \(5, 0\) s: from low to high",
    ),
    ({"mobility": {"model": "manhattan", "speed": (0, 1)}}, r"speed is \(0, 1\) m/s"),
    ({"num_users": 0}, "num_users is 0: a whole number, at least 1"),
    ({"num_users": 2.5}, "num_users is 2.5"),
    ({"wanted": 0.0}, "wanted is 0: a fraction above 0"),
    ({"boundary": "sof"}, "unknown boundary 'sof': did you mean 'soft'"),
    ({"contact_ends": "worlds"}, "unknown contact_ends 'worlds': did you mean 'world'"),
    ({"weights": {"dwel_time": 1.0}}, "unknown reward term 'dwel_time': did you mean 'dwell_time'"),
    (
        {"observation": ("server",)},
        "observation block 'server' shows what task 'mobile_users' does not have",
    ),
    (
        {"observation": ("link_rates",)},
        "observation block 'link_rates' shows what task 'mobile_users' does not have",
    ),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=[str(options) for options, _ in BAD])
def test_options_that_cannot_be(options, message):
    with pytest.raises(ValueError, match=message):
        EnvSpec("mobile_users", 1, {"city": OPEN, "mobility": "still", **options})


def test_tasks_without_users_have_no_dwell_time():
    with pytest.raises(
        ValueError,
        match="observation block 'dwell_time' shows what task 'hover' does not have: leave it out",
    ):
        EnvSpec("hover", 1, {"observation": ("position", "dwell_time")})


@pytest.mark.parametrize("task", ["mobile_users", "mec"])
def test_where_there_are_no_streets_nobody_can_walk_on_them(task):
    with pytest.raises(ValueError, match="city 'hand' has no streets"):
        bulletuav.Aviary(task, city=WALL, mobility="manhattan")
    for mobility in names("mobility"):
        if mobility != "manhattan":
            spawn = EnvSpec(task, 1, {"city": WALL, "mobility": mobility}).task.spawn(
                np.random.default_rng(0)
            )
            assert WALL.outdoors(spawn.memory["users"]).all()
