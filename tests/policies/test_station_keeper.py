"""Policy `station_keeper`, and policies that avoid `hover`, `follow` and `race`."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.tasks import find_task

OPTIONS = {"dynamics": "point_mass", "action": "velocity"}


def fly(task, name, decisions=10_000, see=None, **options):
    """Fly a policy; return the last infos, the final state and what `see` returned."""
    aviary = bulletuav.Aviary(task, 2, **{**OPTIONS, **options})
    policy = find_policy(name)(aviary)
    observations = aviary.reset(seeds=3)
    policy.reset(np.ones(2, dtype=bool))
    seen = []
    for _ in range(min(decisions, aviary.options.horizon)):
        if not aviary.alive.any():
            break
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
        if see:
            seen.append(see(aviary))
    aviary.close()
    return step.info, seen


def offset(aviary):
    return aviary.swarm.position - aviary.scene.goal


def test_the_keeper_follows_turning_targets_closer_than_straight_does():
    errors = {
        name: np.linalg.norm(fly("follow", name, see=offset, difficulty="extreme")[1], axis=-1)
        for name in ("station_keeper", "straight")
    }
    keeper, straight = (np.median(error[50:]) for error in errors.values())
    assert keeper < 0.5 * straight
    assert keeper < 1.0


def test_feed_forward_starts_with_the_second_decision():
    aviary = bulletuav.Aviary("follow", 1, start_offset=0.0, **OPTIONS)
    policy = find_policy("station_keeper")(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(1, dtype=bool))
    # At the station, without a previous velocity of the goal
    speed = policy.act(observations, aviary.swarm) * aviary.options.max_speed
    np.testing.assert_allclose(speed, aviary.scene.goal_velocity, atol=1e-9)
    # The goal accelerates by 3 m/s^2: its velocity in 0.35 s is commanded
    aviary.scene.goal_velocity[:] += (0.3, 0.0, 0.0)
    ahead = policy.act(observations, aviary.swarm) * aviary.options.max_speed - speed
    np.testing.assert_allclose(ahead[0, 0], (0.3 + 3.0 * 0.35, 0.0, 0.0), atol=1e-9)
    policy.reset(np.ones(1, dtype=bool))
    again = policy.act(observations, aviary.swarm) * aviary.options.max_speed
    np.testing.assert_allclose(again - speed, [[(0.3, 0.0, 0.0)]], atol=1e-9)
    aviary.close()


@pytest.mark.parametrize("task", ["hover", "follow"])
def test_policies_that_keep_away_do_not_succeed(task):
    for name in find_task(task).shirkers:
        info, _ = fly(task, name, difficulty="easy")
        assert not info["success"].any(), name


def test_displaced_policies_hold_their_offsets():
    _, beside = fly("hover", "hover_beside", 200, see=offset, difficulty="easy")
    np.testing.assert_allclose(beside[-1], [[(0.3, 0.0, 0.0)]] * 2, atol=0.05)
    _, above = fly("follow", "follow_above", 100, see=offset, turn=0.0)
    np.testing.assert_allclose(above[-1], [[(0.0, 0.0, 5.0)]] * 2, atol=0.3)
    _, behind = fly("follow", "follow_behind", 100, see=offset, turn=0.0)
    np.testing.assert_allclose(np.linalg.norm(behind[-1], axis=-1), 5.0, atol=0.3)
    _, passing = fly("hover", "hover_passing", 200, see=offset, difficulty="easy")
    assert np.ptp(np.array(passing)[100:, :, 0, 0], axis=0).min() > 0.4


def test_late_policies_arrive_at_the_end():
    for task in ("hover", "follow"):
        info, way = fly(task, f"{task}_late", see=offset, difficulty="easy")
        distance = np.linalg.norm(np.array(way), axis=-1)
        assert (distance[len(way) // 2] > 2 * find_task(task).Config.goal_radius).all()
        assert (distance[-1] <= find_task(task).Config.goal_radius).all()
        assert not info["success"].any()


def test_policies_that_avoid_the_race_do_what_they_say():
    options = {"difficulty": "easy", "horizon": 300}
    stop, _ = fly("race", "race_stop", **options)
    assert (stop["gates"] == 3).all()
    alone, _ = fly("race", "race_alone", **options)
    assert alone["gates"].tolist() == [[6, 0], [6, 0]]
    for name in ("race_beside", "race_waiting"):
        info, _ = fly("race", name, **options)
        assert not info["gates"].any()
        assert not info["collision"].any()


def test_conflicts_in_a_race_cost_as_much_as_a_collision():
    def see(aviary):
        return aviary.worlds.frame.conflict.onsets.copy(), aviary.rewards.copy()

    weights = {"weights": {name: 0.0 for name in find_task("race").reward if name != "conflict"}}
    _, seen = fly("race", "race_rush", see=see, difficulty="medium", **weights)
    onsets, rewards = (np.array(rows) for rows in zip(*seen, strict=True))
    assert onsets.any()
    np.testing.assert_allclose(rewards, -100.0 * onsets)
