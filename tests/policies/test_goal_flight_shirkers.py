"""Policies that try to be paid for flights to goals without reaching them safely."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.evaluation import evaluate
from bulletuav.policies import find_policy
from bulletuav.policies.shirkers.goal_flight import NEAR, STANDOFF
from bulletuav.tasks import find_task

CALM = {"dynamics": "point_mass", "randomization": {}, "action": "velocity"}


def fly(policy, task="free_flight", decisions=500, **options):
    """Yield the aviary after each decision, and the mask of the drones that flew it."""
    aviary = bulletuav.Aviary(task, **CALM, **options)
    observations = aviary.reset(seeds=0)
    pilot = find_policy(policy)(aviary)
    pilot.reset(np.ones(1, bool))
    for _ in range(decisions):
        flown = aviary.alive.copy()
        step = aviary.step(pilot.act(observations, aviary.swarm))
        observations = step.observations
        yield aviary, step, flown
        if not aviary.alive.any():
            break
    aviary.close()


def test_drones_stop_just_before_the_goal():
    *_, (aviary, step, flown) = fly("stop_short", decisions=300)
    assert flown.all()
    distance = step.info["goal_distance"]
    edge = aviary.task.config.goal_radius
    np.testing.assert_allclose(distance, edge + STANDOFF, atol=0.2)
    assert np.linalg.norm(aviary.swarm.velocity, axis=-1).max() < 0.2


def test_drones_leave_the_arena_after_they_came_near_the_goal():
    nearest, outside = np.full(8, np.inf), np.zeros(8, bool)
    for aviary, step, flown in fly("leave_near_goal"):
        distance = np.where(flown, step.info["goal_distance"], np.inf)[0]
        nearest = np.minimum(nearest, distance)
        level = np.abs(aviary.swarm.position[0, :, :2])
        outside |= flown[0] & (level > aviary.task.arena_high[:2]).any(axis=-1)
    assert outside.sum() >= 6  # the others passed through their goals
    assert (nearest[outside] < NEAR).all()


def test_close_passes_are_conflicts_without_contact():
    nearest, contacts = np.inf, 0
    options = {"num_drones": 2, "jitter": 0.0, "altitude_spread": 0.0}
    for _, step, flown in fly("pass_closely", "crossing", **options):
        nearest = min(nearest, step.info["separation"][flown].min(initial=np.inf))
        contacts += step.info["collision"].sum()
    assert contacts == 0
    assert 2 * 0.2 < nearest < 5.0


def test_drones_fly_over_near_the_ceiling():
    heights = [aviary.swarm.position[0, :, 2].max() for aviary, *_ in fly("fly_over")]
    assert aviary_ceiling() - 5 < max(heights) < aviary_ceiling()


def aviary_ceiling():
    aviary = bulletuav.Aviary("free_flight", **CALM)
    ceiling = aviary.task.arena_high[2]
    aviary.close()
    return ceiling


def test_obstacles_are_hit_that_the_baseline_avoids():
    options = {"num_drones": 4, "num_obstacles": 35, "num_moving": 0}
    hits = {}
    for policy in ("ignore_obstacles", "orca"):
        flown = fly(policy, "obstacles", **options)
        hits[policy] = sum(step.info["collision"].sum() for _, step, _ in flown)
    assert hits["orca"] == 0
    assert hits["ignore_obstacles"] > 0


@pytest.mark.parametrize("policy", ["stop_short", "leave_near_goal"])
def test_memory_is_that_of_the_policy_that_is_modified(policy):
    aviary = bulletuav.Aviary("navigation", num_drones=1, **CALM)
    observations = aviary.reset(seeds=0)
    one, other = (find_policy(policy)(aviary) for _ in range(2))
    one.reset(np.ones(1, bool))
    one.act(observations, aviary.swarm)
    other.restore(one.memory())
    assert one.memory()["pilot"].keys() >= {"_path", "_count"}
    np.testing.assert_array_equal(
        one.act(observations, aviary.swarm), other.act(observations, aviary.swarm)
    )
    aviary.close()


@pytest.mark.parametrize(
    "task", ["free_flight", "crossing", "converge", "obstacles", "navigation", "default"]
)
def test_shirkers_earn_clearly_less_than_the_baseline(task):
    kind = find_task(task)
    assert len(kind.shirkers) >= 3

    def pay(policy):
        flown = evaluate(task, policy, 4, 0, **{**CALM, "difficulty": "easy"})
        return flown.estimates()["return"].mean

    baseline, hovering = pay(kind.baseline), pay("stay")
    for policy in kind.shirkers:
        assert baseline - pay(policy) > 0.1 * (baseline - hovering), policy
