"""Policy `formation_pilot` reaches its places; policies that avoid `formation` do not."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.oracles.formation import find_blocked
from bulletuav.tasks import find_task


def blocked(position, goal, holds):
    """Which of the drones in one world are blocked at a separation of 6 m."""
    position, goal = (np.array([points], dtype=float) for points in (position, goal))
    return find_blocked(position, goal - position, np.array([holds]), 6.0)[0].tolist()


@pytest.mark.parametrize(("aside", "is_blocked"), [(5.9, True), (6.1, False)])
def test_drones_that_hold_their_places_block_paths_within_the_separation(aside, is_blocked):
    position = [(0, 0, 40), (25, aside, 47)]
    goal = [(50, 0, 40), (25, aside, 40)]
    assert blocked(position, goal, [False, True]) == [is_blocked, False]
    # Drones on their way block none
    assert blocked(position, goal, [False, False]) == [False, False]


@pytest.mark.parametrize("behind", [-6.1, 56.1])
def test_drones_before_the_start_or_beyond_the_goal_block_none(behind):
    position = [(0, 0, 40), (behind, 0, 40)]
    assert blocked(position, [(50, 0, 40), (behind, 0, 40)], [False, True]) == [False, False]


def test_no_drone_blocks_itself_at_its_place():
    places = [(0, 0, 40), (12, 0, 40)]
    assert blocked(places, places, [True, True]) == [False, False]


def fly(name, level, decisions=None, **options):
    aviary = bulletuav.Aviary(
        "formation", 2, dynamics="point_mass", action="velocity", difficulty=level, **options
    )
    policy = find_policy(name)(aviary)
    observations = aviary.reset(seeds=5)
    policy.reset(np.ones(2, dtype=bool))
    for _ in range(decisions or aviary.options.horizon):
        step = aviary.step(policy.act(observations, aviary.swarm))
        observations = step.observations
    violations = aviary.scene.memory["violations"].copy()
    aviary.close()
    return step.info, violations


@pytest.mark.parametrize("level", ["easy", "medium"])
def test_the_pilot_succeeds_without_conflict(level):
    info, violations = fly("formation_pilot", level)
    assert info["success"].all()
    assert not violations.any()
    assert (info["goal_distance"] < 1.0).all()


@pytest.mark.parametrize("name", find_task("formation").shirkers)
def test_policies_that_avoid_the_task_do_not_succeed(name):
    info, _violations = fly(name, "medium")
    assert not info["success"].any()


def test_the_unchanged_formation_is_in_place_until_the_change_only():
    before, _ = fly("formation_unchanged", "medium", 240)
    after, _ = fly("formation_unchanged", "medium", 450)
    assert before["goal_distance"].max() < 2.0
    assert after["goal_distance"].max() > 20.0


def test_a_shifted_formation_has_the_shape_beside_its_leader():
    info, _ = fly("formation_shifted", "medium", 240)
    assert info["shape_error"].max() < 2.0
    np.testing.assert_allclose(info["goal_distance"], 15.0, atol=2.0)


@pytest.mark.parametrize("name", ["formation_pilot", "formation_late"])
def test_other_tasks_raise(name):
    aviary = bulletuav.Aviary("converge", dynamics="point_mass")
    with pytest.raises(ValueError, match=f"{name!r} supports task 'formation', not 'converge'"):
        find_policy(name)(aviary)
    aviary.close()
