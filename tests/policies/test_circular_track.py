"""Policies of pursuit: lanes of the oracle, and paths around the track."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.oracles.pursuit import lane_grid

EXACT = {"dynamics": "single_integrator", "randomization": {}, "jitter": 0.0}


def start(name, num_worlds=1, **options):
    aviary = bulletuav.Aviary("pursuit", num_worlds, **{**EXACT, **options})
    policy = find_policy(name)(aviary)
    aviary.reset(seeds=0)
    policy.reset(np.ones(num_worlds, dtype=bool))
    return aviary, policy


def test_lanes_are_a_triangular_grid():
    grid = lane_grid(2.0, 3.9)
    assert len(grid) == 13  # the centre, 6 neighbours at 2 m and 6 at 3.46 m
    np.testing.assert_array_equal(grid[0], 0)
    distance = np.linalg.norm(grid[:, None] - grid, axis=-1)
    assert distance[distance > 0].min() == pytest.approx(2)
    assert (np.diff(np.linalg.norm(grid, axis=1)) > -1e-12).all()
    assert len(lane_grid(2.0, -1.0)) == 1


def test_drones_in_one_lane_never_meet():
    aviary, policy = start("pursuit_oracle", 5, difficulty="hard")
    config = aviary.task.config
    speed = aviary.scene.memory["cruising_speed"]
    assert (np.linalg.norm(policy.lanes, axis=-1) <= config.slack).all()
    scale = 1 + policy.lanes[..., 0] / config.radius
    assert (speed * scale <= aviary.options.max_speed).all()
    shared = (policy.lanes[:, :, None] == policy.lanes[:, None]).all(axis=-1)
    shared &= ~np.eye(20, dtype=bool)
    assert shared.any()
    place = -config.spacing * np.arange(20)
    for time in np.linspace(0, 120 * np.pi / 18, 200):
        flown = place + speed * time
        ahead = flown[:, :, None] - flown[:, None]
        circle = 2 * np.pi * config.radius
        ahead -= circle * np.round(ahead / circle)
        distance = np.abs(ahead) * scale[:, :, None]
        assert distance[shared].min() > config.d_safe
    aviary.close()


@pytest.mark.parametrize(
    ("name", "speed"), [("pursuit_slow_convoy", "min"), ("pursuit_fast_convoy", "max")]
)
def test_convoys_fly_clockwise_at_one_speed(name, speed):
    aviary, policy = start(name)
    velocity = policy.velocities(aviary.swarm)[0]
    x, y, _ = aviary.swarm.position[0].T / 60
    direction = np.stack([y, -x, np.zeros(8)], axis=-1)
    expected = getattr(aviary.scene.memory["cruising_speed"], speed)()
    np.testing.assert_allclose(velocity, expected * direction, atol=1e-9)
    aviary.close()


def test_paths_lead_back_to_their_circle():
    aviary, policy = start("pursuit_shortcut", num_drones=1, speed=(10.0, 10.0))
    aviary.swarm.position[0, 0] = (60.0, 0.0, 42.0)
    velocity = policy.velocities(aviary.swarm)[0, 0]
    np.testing.assert_allclose(velocity, (-12.0, -10.0, -2.0), atol=1e-9)
    aviary.close()


def test_queues_keep_the_order_behind_the_slowest():
    aviary, policy = start("pursuit_queue", difficulty="hard")
    observations = np.zeros(0)
    overtakes = np.zeros(20)
    while aviary.alive.any():
        info = aviary.step(policy.act(observations, aviary.swarm)).info
        overtakes = np.maximum(overtakes, info["overtakes"][0])
    assert overtakes.sum() <= 2
    aviary.close()
