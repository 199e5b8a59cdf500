"""Scripted policies do what their names say."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy

POINTS = {"dynamics": "single_integrator", "randomization": {}, "num_drones": 4}


def flown(name, task="converge", decisions=20, **options):
    aviary = bulletuav.Aviary(task, 2, **{**POINTS, **options})
    policy = find_policy(name)(aviary)
    observations = aviary.reset(seeds=0)
    policy.reset(np.ones(2, dtype=bool))
    start = aviary.swarm.position.copy()
    for _ in range(decisions):
        observations = aviary.step(policy.act(observations, aviary.swarm)).observations
    return aviary, aviary.swarm.position - start


@pytest.mark.parametrize(
    ("name", "way"), [("stay", (0, 0, 0)), ("climb", (0, 0, 1)), ("dive", (0, 0, -1))]
)
def test_ways_straight_up_down_and_none(name, way):
    _aviary, moved = flown(name, decisions=10)
    flat = np.abs(moved[..., :2]).max()
    assert flat < 20.0
    np.testing.assert_array_equal(np.sign(np.round(moved[..., 2])), np.full((2, 4), way[2]))


def test_leave_takes_the_nearest_wall():
    aviary, moved = flown("leave", decisions=60)
    assert not aviary.alive.any()
    radial = np.abs(moved[..., :2]).max(axis=-1)
    assert (radial >= 20.0).all()


def test_crash_meets_the_nearest_body():
    high, _ = flown("crash", decisions=80, altitude=200.0)
    low, _ = flown("crash", decisions=80, altitude=20.0)
    assert not high.alive.any()
    assert not low.alive.any()
    # From high up the others are nearer than the ground, which nobody came to.
    assert high.swarm.position[..., 2].min() > 100.0
    assert low.swarm.position[..., 2].max() < 1.0


def test_circle_stays_off_the_goal():
    aviary, _ = flown("circle", decisions=400, num_drones=1)
    assert aviary.alive.all()
    away = aviary.scene.goal - aviary.swarm.position
    np.testing.assert_allclose(np.linalg.norm(away, axis=-1), 5.0, atol=1.5)


def test_clump_hovers_over_one_place():
    aviary, _ = flown("clump", "los", decisions=250, num_drones=3, area=250.0, num_layouts=1)
    for position in aviary.swarm.position:
        spread = np.ptp(position[:, :2], axis=0)
        assert spread.max() < 15.0


def test_spread_flies_to_the_centres_of_equal_parts_of_the_arena():
    aviary, _ = flown("spread", "converge", decisions=300, num_drones=5, horizon=400)
    task = aviary.task
    size = task.arena_high[:2] - task.arena_low[:2]
    shares = [(1 / 6, 0.25), (0.5, 0.25), (5 / 6, 0.25), (0.25, 0.75), (0.75, 0.75)]
    places = task.arena_low[:2] + np.array(shares) * size
    for position in aviary.swarm.position[:, :, :2]:
        far = np.linalg.norm(position[:, None] - places, axis=-1)
        assert sorted(far.argmin(axis=1)) == [0, 1, 2, 3, 4]
        assert far.min(axis=1).max() < 1.0
