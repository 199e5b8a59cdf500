"""Policies of `interception`: the baseline, the oracle, and those that avoid the task."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.evaluation import evaluate
from bulletuav.policies import find_policy

OPTIONS = {"dynamics": "point_mass", "num_layouts": 1}


def fly(name, decisions, **options):
    aviary = bulletuav.Aviary("interception", 1, **{**OPTIONS, "difficulty": "easy", **options})
    policy = find_policy(name, "interception")(aviary)
    observations = aviary.reset(seeds=1)
    policy.reset(np.ones(1, dtype=bool))
    for _ in range(decisions):
        if not aviary.alive.any():
            break
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    return aviary


@pytest.mark.parametrize("policy", ["interceptor", "interception_oracle"])
def test_evaders_are_captured(policy):
    for difficulty in ("easy", "medium"):
        result = evaluate("interception", policy, 4, difficulty=difficulty, **OPTIONS)
        assert result.estimates()["success"].mean == 1


def test_without_detections_evaders_are_not_found():
    result = evaluate("interception", "intercept_blind", 4, difficulty="medium", **OPTIONS)
    assert result.estimates()["success"].mean == 0
    assert result.estimates()["collision"].mean == 0


def test_a_shadow_keeps_its_distance():
    aviary = fly("intercept_shadow", 500)
    assert aviary.alive.all()
    gap = np.linalg.norm(aviary.scene.goal - aviary.swarm.position)
    assert gap == pytest.approx(2.5, abs=1.2)


def test_ramming_the_terrain_ends_in_it():
    aviary = fly("intercept_ram", 300)
    assert not aviary.alive.any()
    assert aviary.scene.memory["captured_at"][0] == 0
    assert aviary.scene.memory["violations"][0, 0] == 1


def test_hits_of_the_evader_are_not_avoided():
    aviary = fly("interceptor", 1)
    policy = find_policy("interceptor", "interception")(aviary)
    traffic = policy.traffic(aviary.observations(), aviary.swarm)
    policy._age = np.zeros((1, 1))
    hit = traffic.goal + np.array([(0.0, 0.0, 1.0), (5.0, 0.0, 0.0)])
    ranges = np.linalg.norm(hit, axis=-1)[None].clip(max=50.0)
    np.testing.assert_array_equal(
        policy._is_terrain(traffic, ranges, hit[None])[0, 0], (False, True)
    )
    policy._age = np.full((1, 1), 5.0)
    assert policy._is_terrain(traffic, ranges, hit[None]).all()


def test_blocks_that_are_missing_are_an_error():
    aviary = bulletuav.Aviary(
        "interception", 1, difficulty="easy", observation=("position", "velocity"), **OPTIONS
    )
    with pytest.raises(ValueError, match="policy 'interceptor' needs the observation block"):
        find_policy("interceptor", "interception")(aviary)
