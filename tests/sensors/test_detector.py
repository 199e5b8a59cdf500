"""Sensor `detector`: range, field of view, line of sight, noise and dropouts."""

import numpy as np
import pytest

import bulletuav
from bulletuav.sensors.sight import sights

OPTIONS = {
    "dynamics": "single_integrator",
    "num_layouts": 1,
    "difficulty": "easy",
    "evader_speed": 0.01,
    "observation": ("position", "detection"),
}


def make(worlds=1, **randomization):
    aviary = bulletuav.Aviary("interception", worlds, randomization=randomization, **OPTIONS)
    aviary.reset(seeds=0)
    return aviary


def detect(aviary, offset, turn=0.0):
    """Detections (D, 4) of drones at an offset from the evader, with noses turned to the left."""
    aviary.swarm.position[:, 0] = aviary.scene.obstacle[:, 0] + offset
    aviary.swarm.quaternion[:, 0] = (0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2))
    aviary.worlds.dynamics.place(aviary.swarm, aviary.alive)
    aviary.step(np.zeros((aviary.num_worlds, 1, 3)))
    return aviary.worlds.frame.readings["detection"][:, 0]


def test_a_detection_is_the_offset_from_the_drone():
    aviary = make(detector_noise=0.0)
    for offset in ((-20.0, 0, 0), (3, 4, 12), (0, 0, -2)):
        reading = detect(aviary, offset)[0]
        true = aviary.scene.obstacle[0, 0] - aviary.swarm.position[0, 0]
        np.testing.assert_allclose(reading, (1, *true), atol=1e-12)


def test_out_of_range_nothing_is_detected():
    aviary = make(detector_noise=0.0, detector_range=30.0)
    assert detect(aviary, (0.0, 0.0, 29.9))[0, 0] == 1
    np.testing.assert_array_equal(detect(aviary, (0.0, 0.0, 30.1))[0], 0.0)


@pytest.mark.parametrize(("angle", "expected"), [(44.0, 1), (46.0, 0), (-44.0, 1), (180.0, 0)])
def test_the_field_of_view_is_around_the_nose(angle, expected):
    aviary = make(detector_fov=90.0)
    side = np.radians(angle)
    offset = -10 * np.array([np.cos(side), np.sin(side), 0.0])
    assert detect(aviary, offset)[0, 0] == expected
    assert detect(make(), offset)[0, 0] == 1


def test_terrain_hides_targets_and_their_own_bodies_do_not():
    aviary = make()
    assert detect(aviary, (0.0, 0.0, -1.0))[0, 0] == 1
    place = aviary.scene.obstacle[0, 0]
    ground = aviary.task.city_layouts.cities[0].surface(place)
    engine = aviary.worlds.engine
    mask = np.ones((1, 1), dtype=bool)
    target = place[None, None]
    underground = np.array([[(*place[:2], ground - 2.0)]])
    assert not sights(engine, underground, target, mask, 0.3)[0, 0, 0]
    above = place[None, None] + (0.0, 0.0, 5.0)
    assert sights(engine, above, target, mask, 0.3)[0, 0, 0]
    assert not sights(engine, above, target, mask)[0, 0, 0]


def test_noise_grows_with_the_distance():
    aviary = make(800, detector_noise=0.02)
    for distance in (5.0, 20.0):
        reading = detect(aviary, (0.0, 0.0, distance))
        true = aviary.scene.obstacle[:, 0] - aviary.swarm.position[:, 0]
        error = reading[:, 1:] - true
        assert error.std() == pytest.approx(0.02 * distance, rel=0.06)
        assert abs(error.mean()) < 0.002 * distance


def test_detections_fail_with_the_probability_of_dropouts():
    aviary = make(800, detector_dropout=0.3)
    reading = detect(aviary, (0.0, 0.0, 10.0))
    assert reading[:, 0].mean() == pytest.approx(0.7, abs=0.05)
    np.testing.assert_array_equal(reading[reading[:, 0] == 0], 0.0)
