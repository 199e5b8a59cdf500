"""Task `follow`, and the preset of `hover`."""

import numpy as np
import pytest

import bulletuav
from bulletuav.analysis.recording import fly_episode, outcomes
from bulletuav.policies import find_policy
from bulletuav.vehicle.swarm import FIRST_OBSTACLE


@pytest.mark.parametrize("target", ["vehicle", "drone"])
@pytest.mark.parametrize("dynamics", ["bullet", "point_mass"])
def test_a_policy_that_flies_to_its_station_keeps_it(target, dynamics):
    aviary = bulletuav.Aviary("follow", num_drones=3, target=target, dynamics=dynamics, horizon=150)
    recording = fly_episode(aviary, find_policy("straight")(aviary), seed=0)
    assert all(row.reached for row in outcomes(recording))
    assert not recording.collision.any()
    late = np.linalg.norm(recording.goal - recording.position, axis=-1)[50:]
    assert late.mean() < 1.5
    aviary.close()


def test_the_target_drives_at_its_speed_and_its_stations_with_it():
    aviary = bulletuav.Aviary(
        "follow", 2, num_drones=2, target_speed=4.0, dynamics="single_integrator"
    )
    aviary.reset(seeds=0)
    stations = aviary.scene.goal - aviary.scene.obstacle
    for _ in range(50):
        before = aviary.scene.obstacle.copy()
        aviary.step(aviary.action.encode(aviary.scene.goal_velocity))
        np.testing.assert_allclose(np.linalg.norm(aviary.scene.obstacle - before, axis=-1), 0.4)
        np.testing.assert_allclose(aviary.scene.goal - aviary.scene.obstacle, stations, atol=1e-12)
        np.testing.assert_allclose(
            aviary.scene.goal_velocity[:, 0], (aviary.scene.obstacle - before)[:, 0] / 0.1
        )
    assert (aviary.scene.obstacle[0] != aviary.scene.obstacle[1]).any()
    aviary.close()


def test_the_target_turns_home_at_the_edge():
    aviary = bulletuav.Aviary(
        "follow", arena=10.0, turn=0.0, horizon=2000, dynamics="single_integrator"
    )
    aviary.reset(seeds=0)
    reach, turned = 0.0, []
    for _ in range(300):
        before = aviary.scene.obstacle_velocity[0, 0].copy()
        aviary.step(
            aviary.action.encode(
                aviary.scene.goal - aviary.swarm.position + aviary.scene.goal_velocity
            )
        )
        reach = max(reach, float(np.linalg.norm(aviary.scene.obstacle[0, 0, :2])))
        after = aviary.scene.obstacle_velocity[0, 0]
        turned.append(np.arccos(np.clip(before @ after / 25.0, -1, 1)) * 5.0 / 0.1)
    # It turns as a car does: at 3 m/s^2, in half circles of 8.33 m radius.
    assert 10 < reach < 10 + 2 * 25 / 3
    assert max(turned) == pytest.approx(3.0, rel=1e-6)
    assert np.mean(np.array(turned) > 2.9) < 0.7
    aviary.close()


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body"])
def test_reward_by_hand_and_the_target_can_be_hit(dynamics):
    aviary = bulletuav.Aviary("follow", dynamics=dynamics, target_speed=0.0, start_offset=0.0)
    aviary.reset(seeds=0)
    step = aviary.step(np.zeros((1, 1, 3)))
    assert step.rewards[0, 0] == pytest.approx(3, abs=1e-3)  # alive, and in place
    dive = aviary.scene.obstacle[0, 0] - aviary.swarm.position[0, 0]
    while aviary.alive.any():
        step = aviary.step((dive / np.linalg.norm(dive))[None, None] * 0.5)
    assert step.terminated.all()
    assert step.info["collision"].all()
    assert (aviary.worlds.frame.contacts.other == FIRST_OBSTACLE).all()
    speed, distance = np.linalg.norm(aviary.swarm.velocity), step.info["goal_distance"][0, 0]
    left = aviary.options.horizon - int(aviary.steps[0])
    assert left > 200
    assert step.rewards[0, 0] == pytest.approx(1 - 0.1 * distance - 0.05 * speed - left)
    aviary.close()


@pytest.mark.parametrize("physics_hz", [10, 20, 240])
@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "single_integrator"])
def test_a_fast_target_does_not_jump_over_a_drone_in_its_way(dynamics, physics_hz):
    options = {
        "target": "drone",
        "target_speed": 14.0,
        "turn": 0.0,
        "effects": (),
        "gravity": 9.80665,
    }
    aviary = bulletuav.Aviary("follow", dynamics=dynamics, physics_hz=physics_hz, **options)
    aviary.reset(seeds=0)
    way = aviary.scene.goal_velocity[0, 0] / 14
    aviary.swarm.position[0, 0] = aviary.scene.obstacle[0, 0] + 2.1 * way
    aviary.worlds.dynamics.place(aviary.swarm, aviary.alive)
    hit = False
    for _ in range(3):
        hit |= bool(aviary.step(np.zeros((1, 1, 3))).info["collision"].any())
    assert hit
    aviary.close()


def test_the_targets_velocity_is_seen_from_the_start():
    aviary = bulletuav.Aviary("follow", turn=0.0)
    first = aviary.reset(seeds=0)[0, 0, 13:]
    assert np.linalg.norm(first) == pytest.approx(5, rel=1e-6)
    np.testing.assert_allclose(
        aviary.step(np.zeros((1, 1, 3))).observations[0, 0, 13:], first, rtol=1e-6
    )
    aviary.close()


def test_left_behind_is_the_end():
    aviary = bulletuav.Aviary("follow", dynamics="point_mass", max_distance=15.0)
    aviary.reset(seeds=0)
    while aviary.alive.any():
        step = aviary.step(np.zeros((1, 1, 3)))
    assert step.terminated.all()
    assert step.info["goal_distance"][0, 0] > 15
    aviary.close()


def test_preset_hover_aviary_is_that_of_gym_pybullet_drones():
    aviary = bulletuav.Aviary("hover", preset="hover_aviary")
    options = aviary.options
    assert (options.physics_hz, options.decision_hz, options.horizon, options.action) == (
        240,
        30,
        240,
        "hover_rpm",
    )
    assert options.airframe[0].name == "cf2x"
    assert bulletuav.Aviary("hover", preset="hover_aviary", horizon=10).options.horizon == 10
    aviary.reset(seeds=0)
    start = aviary.swarm.position.copy()
    aviary.step(np.zeros((1, 1, 4)))
    np.testing.assert_allclose(aviary.swarm.position, start, atol=1e-4)
    aviary.step(np.ones((1, 1, 4)))
    assert aviary.swarm.velocity[0, 0, 2] > 0
    aviary.close()
