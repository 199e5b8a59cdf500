"""Sensors as parts of an environment: looking changes nothing of the flight."""

import numpy as np
import pytest

import bulletuav
from bulletuav.geometry.obstacle import Obstacle

TOWN = {"area": 200.0, "num_layouts": 1, "leg": 60.0, "num_drones": 3, "min_separation": 3.0}
LOOKING = (
    "position",
    "lidar",
    "imu",
    "clearance",
    "rgb",
    "depth",
    "ray_depth",
    "segmentation",
    "targets",
)


def flight(observation, dynamics, **options):
    """States over some decisions that end in contact with a building or the ground."""
    aviary = bulletuav.Aviary(
        "navigation",
        2,
        observation=observation,
        dynamics=dynamics,
        camera_size=(16, 12),
        **TOWN | options,
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


def test_the_task_itself_may_need_a_sensor():
    aviary = bulletuav.Aviary(
        "lidar_navigation", observation="velocity", dynamics="point_mass", **TOWN
    )
    aviary.reset(seeds=0)
    assert aviary.worlds.frame.readings["lidar"].shape == (1, 3, 16)
    aviary.close()


def test_sights_of_worlds_and_points_that_are_not_there_are_refused():
    aviary = bulletuav.Aviary("navigation", 2, dynamics="point_mass", **TOWN)
    aviary.reset(seeds=0)
    up = ((0, 0, 90.0), (9, 0, 90.0))
    assert aviary.line_of_sight(*up, 1).tolist() == [True]
    for world in (2, -1, 0.5, None, 10**9, [0, 2]):
        with pytest.raises(ValueError, match="world is .*: a whole number from 0 to 1"):
            aviary.line_of_sight(*up, world)
    with pytest.raises(ValueError, match="world is 5"):
        aviary.solids(5)
    for start in ((np.nan, 0, 0), (0, 0), "x"):
        with pytest.raises(ValueError, match="start is"):
            aviary.line_of_sight(start, up[1])
    aviary.close()


def test_long_rays_end_at_the_tile_of_their_world(make_bench):
    """A box of world 1, whose tile begins 4,096 m to the east, is not seen from world 0."""
    bench = make_bench("bullet", worlds=2, obstacles=(Obstacle("box", (100.0, 100.0, 100.0)),))
    place = np.array([[(0, 0, 500.0)], [(-1900.0, 0, 50)]])
    bench.engine.set_obstacles(place, np.tile((0, 0, 0, 1.0), (2, 1, 1)), np.ones(2, dtype=bool))
    start, end = np.array([(2000.0, 0, 50)]), np.array([(2400.0, 0, 50), (1600.0, 0, 50.0)])
    starts = np.repeat(start, 2, axis=0)
    assert bench.engine.cast_rays(starts, end, np.zeros(2, dtype=int)).tolist() == [1, 1]
    inside = bench.engine.cast_rays(
        np.array([(-1000.0, 0, 50)]), np.array([(-2900.0, 0, 50)]), np.ones(1, dtype=int)
    )
    np.testing.assert_allclose(inside, 850 / 1900, atol=1e-6)
