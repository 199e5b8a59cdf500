"""Flights through cities: rewards and ends of `navigation`, `lidar_navigation` and `default`."""

import numpy as np
import pytest
from urban import EAST, EXACT, FLIGHTS, STAY, UP, URBAN, WALL, WEST

import bulletuav
from bulletuav.policies import find_policy


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
@pytest.mark.parametrize(
    ("task", "weight"), list(zip(URBAN, (-200, -200, -10, -10, -10), strict=True))
)
def test_a_wall_ends_the_episode_of_who_flies_into_it(put_urban, task, weight, dynamics):
    aviary = put_urban(task, WALL, [(0, 0, 10), (-50, -20, 12)], dynamics=dynamics)
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
def test_leaving_the_city_ends_the_episode(put_urban, task, weight, way):
    """2 m below the ceiling, and as far from the edge: the second decision of 1.5 m is out."""
    options = {"ceiling": 40.0, "height": (5.0, 25.0)}
    aviary = put_urban(task, WALL, [(-98, 0, 38), (-50, -20, 30)], **options)
    step = aviary.step(np.array([(way, STAY)]))
    assert not step.terminated.any()
    step = aviary.step(np.array([(way, STAY)]))
    assert step.terminated[0].tolist() == [True, False]
    assert not step.info["collision"].any()
    if weight is not None:
        assert step.info["reward/out_of_bounds"][0].tolist() == [weight, 0]


@pytest.mark.parametrize("task", FLIGHTS)
def test_flights_reward_progress_and_end_at_the_goal(put_urban, task):
    """From 4.9 m off, 1.5 m a decision: at 1.9 m it is there."""
    aviary = put_urban(task, WALL, [(-30, 0, 10)], goal=[(-25.1, 0, 10)])
    for way, progress in ((EAST, 7.5), (WEST, -7.5), (EAST, 7.5)):
        step = aviary.step(np.array([[way]]))
        assert step.info["reward/progress"][0, 0] == pytest.approx(progress)
        assert step.info["reward/goal"][0, 0] == 0
        assert not step.terminated.any()
    step = aviary.step(np.array([[EAST]]))
    assert step.info["goal_distance"][0, 0] == pytest.approx(1.9)
    assert step.info["reward/goal"][0, 0] == 300
    assert step.info["success"].all()
    assert step.terminated.all()
    assert not step.info["collision"].any()


def test_default_rewards_by_hand(put_urban):
    """Of 30 m to go 1.5 m nearer, all that max_speed makes good: 1 - 0.1 for time.

    Away from the goal it is -1 - 0.1; at the goal time is free.
    """
    aviary = put_urban("default", WALL, [(-50, 0, 10)], goal=[(-20, 0, 10)])
    for way, reward in ((EAST, 0.9), (WEST, -1.1), (EAST, 0.9), (STAY, -0.1)):
        step = aviary.step(np.array([[way]]))
        assert step.rewards[0, 0] == pytest.approx(reward)
        assert not step.terminated.any()
    for _ in range(15):  # 28.5 - 15 * 1.5 = 6
        step = aviary.step(np.array([[EAST]]))
        assert not step.terminated.any()
    step = aviary.step(np.array([[EAST]]))  # 4.5 m off: within 5
    assert step.rewards[0, 0] == pytest.approx(10 + 1)
    assert step.terminated.all()
    assert step.info["success"].all()


def test_default_is_cut_at_the_horizon(make_urban):
    aviary = make_urban("default", horizon=3, **EXACT)
    for k in range(3):
        step = aviary.step(np.zeros((1, 3, 3)))
        assert step.truncated.all() == (k == 2)
    assert not step.terminated.any()


@pytest.mark.parametrize(("distance", "nearness"), [(4.0, 0.2), (1.0, 0.8), (5.5, 0.0)])
def test_proximity_by_hand(put_urban, distance, nearness):
    aviary = put_urban("lidar_navigation", WALL, [(10 - distance, 0, 10)])
    step = aviary.step(np.array([[STAY]]))
    assert step.info["reward/proximity"][0, 0] == pytest.approx(-nearness, abs=1e-5)
    assert step.rewards[0, 0] == pytest.approx(-nearness - 0.5, abs=1e-5)


def test_proximity_follows_its_option_and_weight(put_urban):
    aviary = put_urban(
        "lidar_navigation", WALL, [(0, 0, 10)], proximity_range=20.0, weights={"proximity": -3.0}
    )
    assert aviary.step(np.array([[STAY]])).info["reward/proximity"][0, 0] == pytest.approx(
        -1.5, abs=1e-5
    )


def test_ranges_stand_at_their_place_in_the_observation(put_urban):
    """4 m west of a wall: 4 m ahead, 4 / cos(angle) aside, nothing along it and behind."""
    aviary = put_urban("lidar_navigation", WALL, [(6, 0, 10)])
    observation = aviary.reset(seeds=0)[0, 0]
    assert [label.name for label in aviary.observer.labels][7:10] == [
        "charge",
        "room east",
        "room north",
    ]
    assert [label.name for label in aviary.observer.labels][14:16] == ["beam 0", "beam 22.5"]
    ahead = 4 / np.cos(np.radians(22.5 * np.arange(4)))  # 0, 22.5, 45, 67.5 degrees
    ranges = [*ahead, *[60.0] * 9, *ahead[:0:-1]]
    np.testing.assert_allclose(observation[14:], ranges, atol=1e-4)
    for _ in range(3):
        step = aviary.step(np.array([[(0.2, 0.3, 0.1)]]))
        readings = aviary.worlds.frame.readings["lidar"][0, 0]
        np.testing.assert_array_equal(step.observations[0, 0, 14:], readings.astype(np.float32))
    assert readings[0] == pytest.approx(4 - 3 * 0.3, abs=1e-4)


def test_goals_lie_far_away_behind_buildings(make_urban):
    aviary = make_urban("navigation", area=500.0, num_layouts=4, leg=150.0, **EXACT)
    way, hidden = [], []
    for seed in range(100):
        aviary.reset(seeds=seed)
        way += list(aviary.first_info()["goal_distance"][0])
        hidden += list(~aviary.line_of_sight(aviary.scene.start[0], aviary.scene.goal[0]))
    assert min(way) >= 150
    assert np.mean(way) > 200
    assert np.mean(hidden) >= 0.5


@pytest.mark.parametrize("action", ["velocity", "velocity_increment"])
def test_the_planner_brings_everybody_to_the_goal(make_urban, action):
    """Five worlds, and then other goals and cities in each of them, to which it plans again."""
    aviary = make_urban("navigation", 5, num_drones=2, num_layouts=2, action=action)
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


@pytest.mark.parametrize("task", ["navigation", "lidar_navigation", "default"])
def test_room_by_hand(put_urban, task):
    """At (-80, 60, 10) in a square of 200 m below 15 m: to the east it is 180 m, shown as 60."""
    aviary = put_urban(task, WALL, [(-80, 60, 10)])
    told = aviary.observer.split(aviary.reset(seeds=0)[0, 0])
    np.testing.assert_allclose(told["room"], (60, 40, 5, 20, 60, 10), atol=1e-5)
    # Up by 1.5 m, and not above the ceiling that the user asks for.
    aviary = put_urban(task, WALL, [(-80, 60, 10)], ceiling=40.0)
    step = aviary.step(np.array([[UP]]))
    told = aviary.observer.split(step.observations[0, 0])
    np.testing.assert_allclose(told["room"], (60, 40, 28.5, 20, 60, 11.5), atol=1e-5)


@pytest.mark.parametrize("task", ["navigation", "lidar_navigation", "default"])
def test_a_crash_pays_for_all_decisions_that_are_left(put_urban, task):
    """Who dives into the ground pays as many decisions as who stays to the end."""
    aviary = put_urban(task, WALL, [(-50, 0, 10)], horizon=50)
    paid = 0.0
    while aviary.alive.any():
        step = aviary.step(np.array([[(0, 0, -1.0)]]))
        paid += step.info["reward/time"][0, 0]
    assert step.info["collision"].all()
    assert paid == pytest.approx(50 * aviary.task.weights["time"])
