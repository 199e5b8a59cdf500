"""Starts and goals that users give, at construction and at a reset."""

import gymnasium
import numpy as np
import pytest
from placing import city_of

import bulletuav

POINTS = {"dynamics": "single_integrator"}
START = np.array([[10.0 * i, 0.0, 50.0] for i in range(4)])
GOAL = START + (0.0, 60.0, 0.0)
AIRSPACES = ["converge", "crossing", "free_flight", "obstacles"]


def made(task, worlds=1, **options):
    aviary = bulletuav.Aviary(task, worlds, **{**POINTS, "num_drones": 4, **options})
    aviary.reset(seeds=0)
    return aviary


@pytest.mark.parametrize("task", AIRSPACES)
def test_drones_fly_from_given_starts_towards_given_goals(task):
    aviary = made(task, 2, start=START, goal=GOAL.tolist(), heading=None)
    for w in range(2):
        np.testing.assert_array_equal(aviary.swarm.position[w], START)
        np.testing.assert_array_equal(aviary.scene.goal[w], GOAL)
    speed = np.linalg.norm(aviary.swarm.velocity, axis=-1)
    np.testing.assert_allclose(aviary.swarm.velocity[..., 1], speed, rtol=1e-15)
    # Without what is given, the same generator draws the same speeds.
    drawn = made(task, 2, heading=None)
    np.testing.assert_allclose(np.linalg.norm(drawn.swarm.velocity, axis=-1), speed, rtol=1e-12)


def test_a_reset_gives_places_for_its_episodes_alone():
    env = bulletuav.parallel_env("free_flight", num_drones=4, start=START, **POINTS)
    env.reset(seed=0, options={"start": START + 1.0, "goal": GOAL})
    np.testing.assert_array_equal(env.aviary.swarm.position[0], START + 1.0)
    np.testing.assert_array_equal(env.aviary.scene.goal[0], GOAL)
    env.reset(seed=0, options={})
    np.testing.assert_array_equal(env.aviary.swarm.position[0], START)
    assert (env.aviary.scene.goal[0] != GOAL).any()


def test_every_class_of_environment_takes_them():
    options = {"start": START}
    central = gymnasium.make("bulletuav/FreeFlight-v2", num_drones=4, **POINTS)
    central.reset(seed=0, options=options)
    np.testing.assert_array_equal(central.unwrapped.aviary.swarm.position[0], START)
    batch = bulletuav.batch_env("free_flight", 3, num_drones=4, **POINTS)
    batch.reset(seed=0)
    before = batch.aviary.swarm.position.copy()
    mask = np.array([False, True, False])
    batch.reset(options={"reset_mask": mask, **options})
    np.testing.assert_array_equal(batch.aviary.swarm.position[1], START)
    np.testing.assert_array_equal(batch.aviary.swarm.position[~mask], before[~mask])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"start": START[:3]}, "shape \\(4, 3\\) for all worlds"),
        ({"start": START * np.nan}, "4 finite positions"),
        ({"start": "here"}, "start is not numbers"),
        ({"goal": GOAL + 1000.0}, "goal of drone 0 .* inside the arena"),
        ({"start": START * (0.0, 1.0, 1.0)}, "overlap"),
        ({"strat": START}, "did you mean 'start'"),
        ("start", "a dict such as"),
    ],
)
def test_what_cannot_be_given_is_told_and_nothing_is_lost(given, said):
    env = bulletuav.parallel_env("converge", num_drones=4, **POINTS)
    env.reset(seed=0)
    before = env.aviary.swarm.position.copy()
    with pytest.raises(ValueError, match=said):
        env.reset(options=given)
    np.testing.assert_array_equal(env.aviary.swarm.position, before)
    env.step({agent: env.action_space(agent).low for agent in env.agents})


@pytest.mark.parametrize(
    ("task", "given"),
    [("pursuit", "goal"), ("formation", "goal"), ("los", "goal"), ("coverage", "goal")],
)
def test_tasks_refuse_places_that_they_do_not_have(task, given):
    with pytest.raises(ValueError, match=f"{given} cannot be given in task '{task}': start can"):
        bulletuav.Aviary(task, num_drones=4, **{given: START}, **POINTS)


def test_starts_in_buildings_are_refused():
    city = city_of(((-10, -10, 0), (10, 10, 30)))
    where = {"num_drones": 1, "city": city, "ceiling": 60.0, "height": (5.0, 25.0), **POINTS}
    for place in ((0.0, 0.0, 20.0), (10.1, 0.0, 20.0)):
        with pytest.raises(ValueError, match="start of drone 0 .* inside a building"):
            bulletuav.Aviary("default", start=[place], **where)
    for place in ((0.0, 0.0, 40.0), (15.0, 0.0, 20.0)):
        aviary = bulletuav.Aviary("default", start=[place], goal=[(50.0, 0.0, 10.0)], **where)
        aviary.reset(seeds=0)
        np.testing.assert_array_equal(aviary.swarm.position[0, 0], place)


def test_hover_takes_starts_and_targets():
    target = np.array([[0.0, 0.0, 3.0]])
    aviary = bulletuav.Aviary("hover", start=target - (0.0, 0.0, 1.0), goal=target)
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.scene.goal[0], target)
    np.testing.assert_array_equal(aviary.swarm.position[0], target - (0.0, 0.0, 1.0))


def test_drones_without_goals_have_none_elsewhere():
    start = [(-200.0, -200.0, 45.0), (0.0, 0.0, 45.0), (200.0, 200.0, 45.0)]
    aviary = bulletuav.Aviary("los", start=start, **POINTS)
    aviary.reset(seeds=0)
    np.testing.assert_array_equal(aviary.scene.goal[0], start)
