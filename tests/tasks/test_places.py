"""Random places: the same as drawn one by one, and clear of all that they must keep off."""

import contextlib

import numpy as np
import pytest

from bulletuav import Aviary


def one_by_one(task, rng, obstacle, start):
    """Draw as the text says: each drone tries places until one is clear."""
    space = task.starts
    keep_off = task.field.radius + space.apart / 2
    places = []
    while len(places) < task.context.num_drones:
        place = rng.uniform(space.low, space.high)
        others = np.array(places).reshape(-1, 3)
        clear = (np.linalg.norm(others - place, axis=1) > space.apart).all()
        clear &= (np.linalg.norm(obstacle - place, axis=1) > keep_off).all()
        far = start is None or np.linalg.norm(start[len(places)] - place) >= space.leg
        if clear and far:
            places.append(place)
    return np.array(places)


@pytest.mark.parametrize("drones", [1, 8])
@pytest.mark.parametrize("crowd", [1, 40])
def test_places_and_generator_are_as_if_drawn_one_by_one(drones, crowd):
    options = {"num_obstacles": crowd, "num_moving": crowd // 2, "altitude_spread": 40.0}
    options["jitter"] = 0.15
    with contextlib.closing(Aviary("obstacles", num_drones=drones, **options)) as aviary:
        task = aviary.task
        for seed in range(20):
            one, two = np.random.default_rng(seed), np.random.default_rng(seed)
            # Half a number is kept back by 32-bit draws: it must still be there
            assert one.integers(9, dtype=np.uint32) == two.integers(9, dtype=np.uint32)
            spawn, config = task.spawn(one), task.config
            obstacle = two.uniform(task.starts.low, task.starts.high, (crowd, 3))
            fastest = config.obstacle_speed
            velocity = two.uniform(-fastest, fastest, (crowd, 3))
            velocity[config.num_moving :] = 0
            start = one_by_one(task, two, obstacle, None)
            goal = one_by_one(task, two, obstacle, start)
            start += two.uniform(-config.jitter, config.jitter, start.shape)
            speed = two.uniform(*config.start_speed, (drones, 1))
            drawn = (spawn.obstacle, spawn.obstacle_velocity, spawn.position, spawn.goal)
            for found, wanted in zip(drawn, (obstacle, velocity, start, goal), strict=True):
                np.testing.assert_array_equal(found, wanted)
            way = goal - start
            straight = speed * way / np.linalg.norm(way, axis=1, keepdims=True)
            np.testing.assert_allclose(spawn.velocity, straight, rtol=1e-14)
            assert one.bit_generator.state == two.bit_generator.state


def test_starts_that_are_shifted_keep_off_each_other_and_their_goals():
    """The worst shifts: towards each other along the diagonals of their cubes."""
    options = {"area": 200.0, "altitude": 80.0, "altitude_spread": 130.0, "leg": 40.0}
    with contextlib.closing(Aviary("free_flight", num_drones=2, jitter=9.0, **options)) as aviary:
        task, rng = aviary.task, np.random.default_rng(0)
        # No draw that keeps the rules comes closer than the rule less both whole shifts
        shift = np.sqrt(3) * task.config.jitter
        assert task.starts.apart - 2 * shift == pytest.approx(2 * task.config.d_safe)
        spawns = [task.spawn(rng) for _ in range(500)]
    way = [np.linalg.norm(spawn.goal - spawn.position, axis=1).min() for spawn in spawns]
    assert task.config.leg <= min(way) < task.config.leg + 15.0
