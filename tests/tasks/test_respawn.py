"""Flights whose goals are drawn anew when they are reached."""

import numpy as np
import pytest
from placing import OPEN, SMALL
from urban import WALL

import bulletuav
from bulletuav.policies import find_policy

FREE = {"dynamics": "single_integrator", "at_goal": "respawn", "battery_capacity": None}


def at_goals(aviary):
    """Move the goals to where the first drone is, and the others out of reach."""
    aviary.scene.goal[:, 0] = aviary.swarm.position[:, 0] + (0.5, 0, 0)


@pytest.fixture
def aviary():
    made = bulletuav.Aviary("navigation", 3, city=OPEN, num_drones=2, leg=80.0, **FREE)
    made.reset(seeds=0)
    yield made
    made.close()


def test_a_goal_that_is_reached_counts_and_gives_way_to_another(aviary):
    at_goals(aviary)
    old = aviary.scene.goal.copy()
    step = aviary.step(np.zeros((3, 2, 3)))
    np.testing.assert_array_equal(step.info["goals"], [[1, 0]] * 3)
    assert (step.info["reward/goal"][:, 0] == 300).all()
    assert (step.info["reward/goal"][:, 1] == 0).all()
    # What is paid and told is about the old goal, what is observed about the new.
    assert (step.info["goal_distance"][:, 0] < 1).all()
    way = np.linalg.norm(aviary.scene.goal - aviary.swarm.position, axis=-1)
    assert (way[:, 0] >= 80).all()
    np.testing.assert_array_equal(aviary.scene.goal[:, 1], old[:, 1])
    seen = aviary.observer.split(step.observations)["goal"]
    np.testing.assert_allclose(seen[..., 3], way, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(seen[..., :3], axis=-1), 1, rtol=1e-5)
    assert aviary.alive.all()
    np.testing.assert_array_equal(step.info["success"], [[True, False]] * 3)


def test_each_goal_counts_and_progress_is_towards_the_one_that_was_flown_to(aviary):
    for k in range(1, 4):
        at_goals(aviary)
        step = aviary.step(np.zeros((3, 2, 3)))
        assert (step.info["goals"][:, 0] == k).all()
        assert (step.info["reward/goal"][:, 0] == 300).all()
        assert np.abs(step.info["reward/progress"]).max() < 1e-9
    step = aviary.step(np.zeros((3, 2, 3)))
    assert (step.info["reward/goal"] == 0).all()
    assert step.info["success"][:, 0].all()


def test_goals_are_those_of_the_worlds_own_generator():
    drawn = []
    for worlds in (1, 2):
        made = bulletuav.Aviary("navigation", worlds, city=OPEN, num_drones=2, leg=80.0, **FREE)
        made.reset(seeds=5)
        at_goals(made)
        made.step(np.zeros((worlds, 2, 3)))
        drawn.append(made.scene.goal[0].copy())
        made.close()
    np.testing.assert_array_equal(*drawn)


def test_where_no_place_is_far_enough_the_farthest_is_taken():
    town = bulletuav.Aviary("navigation", city=OPEN, leg=80.0, **FREE).task.city_layouts
    goal = town.draw_goal(np.random.default_rng(0), 0, np.array((0.0, 0, 10)), 500.0)
    assert 100 < np.linalg.norm(goal[:2]) < 90 * 2**0.5


def test_a_crash_at_the_goal_is_no_goal(aviary):
    made = bulletuav.Aviary("navigation", city=WALL, num_drones=1, leg=80.0, **FREE)
    made.reset(seeds=0)
    made.swarm.position[:] = (9.5, 0, 20)
    made.scene.goal[:] = (10.0, 0, 20)
    step = made.step(np.full((1, 1, 3), (1.0, 0, 0)))
    assert step.info["collision"].all()
    assert (step.info["goals"] == 0).all()
    assert not step.info["success"].any()
    made.close()


def test_a_planner_flies_to_one_goal_after_the_other():
    made = bulletuav.Aviary(
        "lidar_navigation", 2, num_drones=1, leg=60.0, **FREE, **{**SMALL, "num_layouts": 1}
    )
    observations = made.reset(seeds=0)
    policy = find_policy("planner")(made)
    while made.alive.any():
        step = made.step(policy.act(observations, made.swarm))
        observations = step.observations
    assert (made.scene.memory["goals"] >= 2).all()
    made.close()


# Traffic in free space


def test_traffic_in_free_space_lasts_until_the_horizon_and_counts_goals():
    options = {"num_drones": 4, "difficulty": "easy", "horizon": 400, "dynamics": "point_mass"}
    made = bulletuav.Aviary("free_flight", 2, at_goal="respawn", **options)
    observations = made.reset(seeds=0)
    policy = find_policy("orca")(made)
    policy.reset(np.ones(2, dtype=bool))
    reached = np.zeros((2, 4))
    while made.alive.any():
        goals = made.scene.goal.copy()
        step = made.step(policy.act(observations, made.swarm))
        observations = step.observations
        at_goal = step.info["reward/goal"] > 0
        reached += at_goal
        # Further goals are as far as the first, in the box, and apart from each other
        way = np.linalg.norm(made.scene.goal - made.swarm.position, axis=-1)
        assert (way[at_goal] >= 25).all()
        np.testing.assert_array_equal((made.scene.goal != goals).any(axis=-1), at_goal)
    starts = made.task.starts
    assert ((made.scene.goal >= starts.low) & (made.scene.goal <= starts.high)).all()
    for w in range(2):
        gaps = np.linalg.norm(made.scene.goal[w][:, None] - made.scene.goal[w], axis=-1)
        assert gaps[~np.eye(4, dtype=bool)].min() > starts.apart
    np.testing.assert_array_equal(step.info["goals"], reached)
    assert (reached > 1).any()
    flown = made.steps[0] / 10
    assert flown == 40
    np.testing.assert_allclose(step.info["goals_per_hour"], reached * 3600 / flown)
    made.close()


def test_absent_drones_get_no_goals():
    options = {"difficulty": "easy", "dynamics": "single_integrator", "at_goal": "respawn"}
    made = bulletuav.Aviary("free_flight", 4, num_drones=(1, 4), **options)
    made.reset(seeds=0)
    made.scene.goal[:] = made.swarm.position
    step = made.step(np.zeros((4, 4, 3)))
    np.testing.assert_array_equal(step.info["goals"], made.members)
    made.close()


# Drones that crash, leave the arena or empty their batteries start again

START = {"difficulty": "easy", "num_drones": 4, "at_goal": "respawn"}
REST = np.zeros((2, 4, 3))


def traffic(**options):
    made = bulletuav.Aviary("free_flight", 2, **{"dynamics": "point_mass", **START, **options})
    made.reset(seeds=0)
    return made


def crash(aviary):
    """Let drones 0 and 1 of world 0 fly into each other."""
    aviary.swarm.position[0, 1] = aviary.swarm.position[0, 0] + (2.0, 0, 0)
    aviary.swarm.velocity[0, :2] = (15.0, 0, 0), (-15.0, 0, 0)
    action = REST.copy()
    action[0, :2] = (0.75, 0, 0), (-0.75, 0, 0)
    return aviary.step(action)


def test_drones_that_crash_start_again_in_the_next_decision():
    made = traffic()
    step = crash(made)
    crashed = np.zeros((2, 4), dtype=bool)
    crashed[0, :2] = True
    np.testing.assert_array_equal(step.info["collision"], crashed)
    np.testing.assert_array_equal(step.info["reward/collision"], -200.0 * crashed)
    np.testing.assert_array_equal(step.info["restarts"], crashed)
    # Not for the decisions that remain: their episode continues
    np.testing.assert_array_equal(step.info["reward/time"], np.full((2, 4), -0.5))
    assert not step.terminated.any()
    assert made.alive.all()
    here, goals = made.swarm.position.copy(), made.scene.goal.copy()
    step = made.step(REST)
    assert not step.info["collision"].any()
    np.testing.assert_array_equal(step.info["restarts"], crashed)
    np.testing.assert_array_equal((made.scene.goal != goals).any(axis=-1), crashed)
    moved = np.linalg.norm(made.swarm.position - here, axis=-1)
    assert (moved[~crashed] < 1).all()
    starts = made.task.starts
    for i in range(2):
        start, goal = made.scene.start[0, i], made.scene.goal[0, i]
        assert ((start >= starts.low) & (start <= starts.high)).all()
        assert np.linalg.norm(goal - start) >= 25
        # Up to 5 m/s at the start, of which 0.1 s are flown
        assert np.linalg.norm(made.swarm.position[0, i] - start) < 0.5
        away = np.linalg.norm(here[0, 2:] - start, axis=-1)
        assert away.min() > starts.apart
    # Progress is that of the flight from the new start
    before = np.linalg.norm(made.scene.goal[0, 0] - made.scene.start[0, 0])
    after = np.linalg.norm(made.scene.goal[0, 0] - made.swarm.position[0, 0])
    np.testing.assert_allclose(step.info["reward/progress"][0, 0], 5 * (before - after))
    # Safety is that of the episode
    made.scene.goal[0, 0] = made.swarm.position[0, 0]
    step = made.step(REST)
    assert step.info["goals"][0, 0] == 1
    assert not step.info["success"][0, 0]
    made.close()


def test_drones_outside_the_arena_start_again():
    made = traffic()
    made.swarm.position[1, 2] = made.task.arena_high + 1.0
    step = made.step(REST)
    assert step.info["reward/out_of_bounds"][1, 2] == -50
    assert step.info["restarts"].sum() == 1
    made.step(REST)
    assert (made.swarm.position[1, 2] < made.task.arena_high).all()
    assert made.alive.all()
    made.close()


def test_empty_batteries_are_full_again():
    made = traffic(battery_capacity=10.0)
    made.worlds.energy.readings()["charge"][0, 3] = 1e-9
    step = made.step(REST)
    assert step.info["charge"][0, 3] == 0
    assert step.info["restarts"][0, 3] == 1
    assert made.alive.all()
    step = made.step(REST)
    assert 0.99 < step.info["charge"][0, 3] < 1
    made.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "single_integrator"])
def test_flights_continue_from_snapshots_between_the_crash_and_the_start(dynamics):
    made = traffic(dynamics=dynamics)
    out = np.zeros((2, 4), dtype=bool)
    out[1, 2] = True
    made.swarm.position[out] = made.task.arena_high + 1.0
    made.worlds.dynamics.place(made.swarm, out)
    made.step(REST)
    saved = made.save_state()
    hashes = []
    for _ in range(2):
        made.load_state(saved)
        for _ in range(3):
            made.step(REST)
        hashes.append(made.state_hash())
    assert hashes[0] == hashes[1]
    assert made.scene.memory["restarts"][1, 2] == 1
    made.close()


def test_drones_that_take_off_start_again_on_the_ground():
    made = traffic(take_off=True, altitude=10.0, altitude_spread=4.0)
    made.swarm.position[1, 2] = made.task.arena_high + 1.0
    made.step(REST)
    step = made.step(REST)
    np.testing.assert_allclose(
        made.scene.start[1, 2, 2], made.task.context.standing_height[2], rtol=1e-12
    )
    assert not step.info["collision"].any()
    made.close()


def test_drones_with_sensors_start_again():
    made = traffic(difficulty="extreme", dynamics="rigid_body")
    made.swarm.position[1, 2] = made.task.arena_high + 1.0
    made.step(REST)
    step = made.step(REST)
    assert np.isfinite(step.observations).all()
    known = made.worlds.frame.known_position[1, 2]
    assert np.linalg.norm(known - made.swarm.position[1, 2]) < 20
    made.close()


@pytest.mark.parametrize("decisions", [1000, pytest.param(10_000, marks=pytest.mark.slow)])
def test_random_traffic_never_empties_the_airspace(decisions):
    made = traffic(horizon=decisions, dynamics="single_integrator", battery_capacity=0.01)
    rng = np.random.default_rng(0)
    for _ in range(decisions):
        step = made.step(rng.uniform(-1, 1, (2, 4, 3)))
        if made.steps[0] < decisions:
            assert made.alive.all()
    assert step.truncated.all()
    assert (step.info["restarts"] > 10).all()
    made.close()


def test_absent_drones_do_not_start_again():
    made = bulletuav.Aviary(
        "free_flight", 4, **{**START, "num_drones": (1, 4)}, dynamics="single_integrator"
    )
    made.reset(seeds=0)
    made.swarm.position[:] = made.task.arena_high + 1.0
    step = made.step(np.zeros((4, 4, 3)))
    np.testing.assert_array_equal(step.info["restarts"], made.members)
    made.step(np.zeros((4, 4, 3)))
    np.testing.assert_array_equal(made.alive, made.members)
    made.close()


def test_the_most_suitable_start_is_taken_where_none_is_clear():
    made = traffic()
    # Drones everywhere: the farthest corner of the box is the best
    starts = made.task.starts
    center = (starts.low + starts.high) / 2
    taken = (np.tile(center, (3, 1)), np.zeros((0, 3)), np.zeros((0, 3)))
    made.task.restarts._apart = 1000.0
    drawn = made.task.restarts._draw(taken, np.random.default_rng(0))
    reach = np.linalg.norm(starts.high - center)
    assert np.linalg.norm(drawn["position"] - center) > 0.9 * reach
    made.close()
