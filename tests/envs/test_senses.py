"""Sensors as parts of an environment: looking changes nothing, and nothing is looked at that nobody asked for."""

import numpy as np
import pytest

import bulletuav

TOWN = {"area": 200.0, "num_layouts": 1, "leg": 60.0, "num_drones": 3, "min_separation": 3.0}
LOOKING = ("position", "lidar", "imu", "clearance", "rgb", "depth", "ray_depth", "segmentation", "targets")


def flight(observation, dynamics, **options):
    """States over some decisions that end in contact with a building or the ground."""
    aviary = bulletuav.Aviary(
        "navigation", 2, observation=observation, dynamics=dynamics, camera_size=(16, 12), **TOWN | options
    )
    aviary.reset(seeds=3)
    rows, touched = [], False
    for k in range(40):
        step = aviary.step(np.full((2, 3, 3), (0.9, 0.3 * np.sin(k), -0.6)))
        touched |= step.info["collision"].any()
        rows.append(np.concatenate([array.ravel() for array in aviary.swarm]))
    aviary.close()
    assert touched
    return np.array(rows)


@pytest.mark.parametrize("dynamics", ["bullet", "rigid_body", "point_mass"])
def test_looking_leaves_the_flight_as_it_is(dynamics):
    np.testing.assert_array_equal(flight(LOOKING, dynamics), flight("position", dynamics))


def test_readings_are_those_that_were_asked_for():
    aviary = bulletuav.Aviary("navigation", observation=("position", "lidar"), dynamics="point_mass", **TOWN)
    aviary.reset(seeds=0)
    assert set(aviary._frame.readings) == {"charge", "sight", "lidar"}
    assert aviary._frame.readings["sight"].shape == (1, 3, 0)
    aviary.close()


def test_the_task_itself_may_need_a_sensor():
    aviary = bulletuav.Aviary("lidar_navigation", observation="velocity", dynamics="point_mass", **TOWN)
    aviary.reset(seeds=0)
    assert aviary._frame.readings["lidar"].shape == (1, 3, 16)
    aviary.close()


def test_a_partial_reset_leaves_readings_of_other_worlds():
    options = {"randomization": {"lidar_noise": 1.0, "accelerometer_noise": 1.0}, "dynamics": "point_mass", **TOWN}
    aviary = bulletuav.Aviary("navigation", 2, observation=("lidar", "imu"), **options)
    aviary.reset(seeds=0)
    before = aviary.step(np.zeros((2, 3, 3))).observations
    after = aviary.reset(np.array([False, True]))
    np.testing.assert_array_equal(after[0], before[0])
    assert (after[1] != before[1]).any()
    aviary.close()
