"""Mirror images of obstacles that are reflected, and the oracle that avoids them."""

import numpy as np
import pytest

import bulletuav
from bulletuav.policies import find_policy
from bulletuav.policies.oracles.obstacles import mirror_images

CALM = {"dynamics": "single_integrator", "randomization": {}}


def test_an_image_by_hand():
    """4 m from the upper bound at 2 m/s: from 2 s on it flies back, as if from 4 m beyond."""
    place, velocity = np.array([[[6.0, 5.0, 5.0]]]), np.array([[[2.0, 0.0, 0.0]]])
    low, high = np.zeros(3), np.full(3, 10.0)
    images, velocities = mirror_images(place, velocity, low, high, horizon=3.0)
    assert images.tolist() == [[[[14.0, 5.0, 5.0]] * 3]]
    assert velocities.tolist() == [[[[-2.0, 0.0, 0.0]] * 3]]
    # The bound is not reached within one second
    images, velocities = mirror_images(place, velocity, low, high, horizon=1.0)
    assert images.tolist() == [[[[6.0, 5.0, 5.0]] * 3]]
    assert velocities.tolist() == [[[[2.0, 0.0, 0.0]] * 3]]


def test_obstacles_follow_their_own_line_or_that_of_an_image():
    aviary = bulletuav.Aviary(
        "obstacles", 2, num_drones=1, num_moving=25, area=200.0, obstacle_speed=9.0, **CALM
    )
    aviary.reset(seeds=[0, 1])
    scene, (low, high) = aviary.scene, aviary.task.field.box()
    place, velocity = scene.obstacle.copy(), scene.obstacle_velocity.copy()
    horizon, reflected = 3.0, 0
    images, velocities = mirror_images(place, velocity, low, high, horizon)
    lines = np.concatenate([place[:, :, None], images], axis=2)
    speeds = np.concatenate([velocity[:, :, None], velocities], axis=2)
    for k in range(1, 31):
        aviary.task.move_scene(scene, np.zeros(2), np.ones(2, bool), ())
        predicted = lines + 0.1 * k * speeds
        # At any time, the one line between the bounds is the path of the obstacle
        is_inside = ((predicted > low - 1e-9) & (predicted < high + 1e-9)).all(axis=-1)
        error = np.linalg.norm(predicted - scene.obstacle[:, :, None], axis=-1)
        assert is_inside.any(axis=-1).all()
        assert np.where(is_inside, error, 0.0).max() < 1e-9
        reflected += (scene.obstacle_velocity != velocity).any(axis=-1).sum()
    assert reflected > 100
    aviary.close()


def test_oracle_evades_an_obstacle_before_it_is_reflected_into_the_path():
    """It flies north, away from the path, and is back in the middle of it after 2.75 s."""
    aviary = bulletuav.Aviary(
        "obstacles",
        num_drones=1,
        num_obstacles=1,
        num_moving=1,
        start_speed=(0.0, 0.0),
        start=[(-90.0, 0.0, 40.0)],
        goal=[(90.0, 0.0, 40.0)],
        obstacle_radius=10.0,
        action="velocity",
        **CALM,
    )
    observations = aviary.reset(seeds=0)
    aviary.scene.obstacle[:] = (-35.0, 70.0, 40.0)
    aviary.scene.obstacle_velocity[:] = (0.0, 40.0, 0.0)
    orca, oracle = (find_policy(name)(aviary) for name in ("orca", "reflecting_orca"))
    assert orca.act(observations, aviary.swarm)[0, 0, 0] > 0.99
    assert oracle.act(observations, aviary.swarm)[0, 0, 0] < 0.9
    nearest = np.inf
    while aviary.alive.any():
        step = aviary.step(oracle.act(observations, aviary.swarm))
        away = aviary.swarm.position[0, 0] - aviary.scene.obstacle[0, 0]
        nearest = min(nearest, np.linalg.norm(away))
    assert step.info["success"].all()
    assert nearest > 10.0 + aviary.task.context.collision_radius
    aviary.close()


@pytest.mark.parametrize("task", ["crossing", "hover"])
def test_oracle_flies_like_orca_without_moving_obstacles(task):
    aviary = bulletuav.Aviary(task, num_drones=2, action="velocity", **CALM)
    observations = aviary.reset(seeds=0)
    oracle, orca = (find_policy(name)(aviary) for name in ("reflecting_orca", "orca"))
    np.testing.assert_array_equal(
        oracle.act(observations, aviary.swarm), orca.act(observations, aviary.swarm)
    )
    aviary.close()
